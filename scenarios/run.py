"""`appli run` and `appli worlds`."""

from __future__ import annotations

import json as json_module
import math
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import yaml

from scenarios.errors import UserError, blame
from scenarios.folders import make_folder
from scenarios.switches import Switches
from scenarios.trials import TrialResult, TrialSpec, make_driver, result_as_dict, run_trial
from scenarios.worlds import check_protocol, list_worlds, load_world
from twin.planner.params import PlannerParams
from twin.records import Decision, Observation, Outcome, Tick
from twin.rollout import Driver
from twin.simulation import TICK
from twin.world import World

PARAMS_LIMIT = 64 * 1024  # bytes; a parameter file has eight lines


def run_command(
    world_name: str,
    driver: str,
    protocol: str,
    seed: int,
    params: Path | None,
    start: str | None,
    goal: str | None,
    record: Path | None,
    record_bag: Path | None,
    view: bool,
    web: bool,
    json: bool,
    switches: Switches,
) -> int:
    """Run one trial and report it; see `appli run --help`."""
    if seed < 0:
        raise UserError(f"--seed must be 0 or more, not {seed}")
    check_recording_path(record)
    if record_bag is not None and record_bag.suffix != ".mcap":
        raise UserError(f"--record-bag takes a file that ends in .mcap, not {record_bag}")
    if web and not view:
        raise UserError("--web goes with --view")
    _refuse_what_the_driver_ignores(driver, params, switches)
    with blame():
        theta = PlannerParams() if params is None else read_params(params)
        world = load_world(world_name, protocol, start=start, goal=goal)
        spec = TrialSpec(world_name, protocol, driver, seed, 0, theta, switches)
        check_protocol(world, protocol)
        make_driver(spec)  # a wrong name or file is told before anything is compiled
    for path in (record, record_bag):
        if path is not None:
            make_folder(path.parent)
    compile_kernels()
    with ExitStack() as stack:
        viewer = None
        if view:
            from scenarios.view import open_viewer, stay

            viewer = stack.enter_context(open_viewer(web))
        began = time.perf_counter()
        watching = None if viewer is None else viewer.url
        quiet = json or not sys.stderr.isatty()
        try:
            result, faults = _run_watched(spec, world, record, record_bag, watching, quiet)
        except KeyboardInterrupt:
            if kept := [str(path) for path in (record, record_bag) if path is not None and path.exists()]:
                print(f"appli run: {' and '.join(kept)}: the drive so far", file=sys.stderr)
            raise
        wall = time.perf_counter() - began
        report = {
            "world": world.name,
            "protocol": world.rules.protocol,
            "driver": driver,
            "seed": seed,
            **result_as_dict(result),
            "faults": faults,
            "wall_time": round(wall, 3),
            "real_time_factor": round(result.ticks * TICK / wall, 2),
            "recording": None if record is None else str(record),
            "bag": None if record_bag is None else str(record_bag),
        }
        if json:
            print(json_module.dumps(report))
        else:
            print(summary(world, result, report["real_time_factor"], faults, record, record_bag))
        if viewer is not None:
            stay(viewer)
    return 0 if result.outcome is Outcome.REACHED else 1


def _refuse_what_the_driver_ignores(driver: str, params: Path | None, switches: Switches) -> None:
    """Raises UserError."""
    if params is not None and driver != "dwa":
        raise UserError(f"--params is for the driver dwa; {driver} has its own")
    if not driver.endswith(".safetensors"):
        return
    for name, option in (("inflation", "--inflation"), ("couple_min_vel_theta", "--couple-min-vel-theta")):
        if getattr(switches, name) != getattr(Switches(), name):
            raise UserError(
                f"{option} does not go with a policy, which drives as it was trained: see appli train --help"
            )


def summary(
    world: World,
    result: TrialResult,
    real_time_factor: float,
    faults: int = 0,
    record: Path | None = None,
    bag: Path | None = None,
) -> str:
    """The few lines a person wants after a run."""
    lines = [
        f"{world.name}: {result.outcome.value} after {result.time:.2f} s, {result.distance:.1f} m driven, "
        f"{result.recoveries} recoveries, {_closest(result.min_clearance)} ({real_time_factor:.0f} x real time)"
    ]
    if result.outcome is Outcome.ABORTED:
        lines.append("  move_base gave up: its recoveries did not help")
    if result.contact is not None:
        hit = result.contact
        lines.append(f"  touched {hit.obstacle} at ({hit.x:.2f}, {hit.y:.2f}) after {hit.time:.2f} s")
    if faults:
        lines.append(f"  {faults} scans could not be judged: they counted as the default context")
    if record is not None:
        lines.append(f"  recording: {record}   open it with: appli view {record}")
    if bag is not None:
        lines.append(f"  bag: {bag}")
    return "\n".join(lines)


def _closest(clearance: float) -> str:
    return f"closest {clearance:.2f} m" if math.isfinite(clearance) else "nothing near"


def _run_watched(
    spec: TrialSpec, world: World, record: Path | None, record_bag: Path | None, viewer: str | None, quiet: bool
) -> tuple[TrialResult, int]:
    """Run with recorders and a progress line attached as asked; Ctrl-C closes the files first.

    Also returns how many scans the driver could not judge.
    """
    watchers: list[Callable[[Tick], Any]] = [] if quiet else [_progress]
    recorded = record is not None or viewer is not None
    with blame(), ExitStack() as stack:  # closing a file can fail, too
        driver = make_driver(spec, explain=recorded)
        if recorded:
            from scenarios.recorded import open_recorder

            with blame():
                watchers.append(stack.enter_context(open_recorder(spec, world, driver, record, viewer)).add)
        if record_bag is not None:
            from scenarios.bags.recording import BagRecorder

            with blame():
                bag = stack.enter_context(BagRecorder(record_bag))
            watchers.append(bag.add)
        if not quiet:
            stack.callback(lambda: print(file=sys.stderr))
        counting = _CountingFaults(driver)
        with blame():
            result = run_trial(spec, world, lambda tick: [watch(tick) for watch in watchers], driver=counting)
        return result, counting.faults


class _CountingFaults:
    """The same driver; remembers how many scans it could not judge."""

    def __init__(self, driver: Driver) -> None:
        self._driver, self.faults = driver, 0

    def start(self) -> object:
        return self._driver.start()

    def decide(self, observation: Observation, memory: object) -> tuple[Decision, object]:
        decision, memory = self._driver.decide(observation, memory)
        self.faults = getattr(memory, "faults", 0)
        return decision, memory


def _progress(tick: Tick) -> None:
    """A line that rewrites itself twice a simulated second."""
    if tick.index % 10 == 0 or tick.outcome is not None:
        pose, twist = tick.true_pose, tick.observation.twist
        text = f"  {tick.elapsed:6.1f} s  ({pose.x:6.2f}, {pose.y:6.2f})  {twist.v:5.2f} m/s  {tick.decision.state}"
        print(f"\r{text:<70}", end="", file=sys.stderr, flush=True)


def read_params(path: Path) -> PlannerParams:
    """Planner parameters from a YAML mapping. Raises ValueError or OSError."""
    if path.stat().st_size > PARAMS_LIMIT:
        raise ValueError(f"{path}: too large for a parameter file")
    try:
        text = path.read_text(encoding="utf-8")
        values = yaml.safe_load(text)
        written: Any = yaml.compose(text)
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a text file; expected lines such as 'max_vel_x: 0.8'") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        raise ValueError(f"{path}{line}: not YAML; expected lines such as 'max_vel_x: 0.8'") from error
    if not isinstance(values, dict):
        raise ValueError(f"{path}: expected lines such as 'max_vel_x: 0.8'")
    names = Counter(key.value for key, _ in written.value)
    if twice := [name for name, count in names.items() if count > 1]:
        raise ValueError(f"{path}: {twice[0]} is given twice")
    try:
        return PlannerParams.from_mapping({str(k): _number(v) for k, v in values.items()})
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _number(value: object) -> object:
    """YAML 1.1 takes 5e-1 for a text; a person means a number."""
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value


def compile_kernels() -> None:
    """Load the numba kernels; says so when they have to be compiled (once per machine and version)."""
    from scenarios.warm_up import warm_up
    from twin.compiled import FIRST_TIME

    if FIRST_TIME:
        print("appli: compiling the planner for this machine (once, about a minute) ...", file=sys.stderr, flush=True)
    warm_up()


def check_recording_path(record: Path | None) -> None:
    """A recording ends in .rrd: so a slip of the hand never overwrites a course or a parameter file."""
    if record is not None and record.suffix != ".rrd":
        raise UserError(f"--record takes a file that ends in .rrd, not {record}")


def worlds_command(json: bool) -> int:
    """Print the built-in worlds."""
    entries = list_worlds()
    if json:
        print(json_module.dumps([entry.as_dict() for entry in entries]))
        return 0
    from scenarios.tables import plain_table, print_table

    table = plain_table("world", "size", "start\nto goal", "what it is")  # names tell the kinds apart: 60 columns do
    for entry in entries:
        table.add_row(entry.name, entry.size, f"{entry.distance:.1f} m", entry.note)
    print_table(table)
    return 0
