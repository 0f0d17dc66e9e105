"""The subcommands of `appli`: signatures and help texts; what they do is imported when they are called."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from scenarios.bags.options import BagOptions
from scenarios.errors import UserError
from scenarios.policy_options import PolicyOptions
from scenarios.switches import Switches

Protocol = Literal["appli", "2020", "icra22"]
WorldName = Annotated[str, arg(metavar="WORLD")]


def run(
    world: Positional[WorldName],
    /,
    driver: str = "dwa",
    protocol: Protocol = "appli",
    seed: int = 0,
    params: Path | None = None,
    start: str | None = None,
    goal: str | None = None,
    record: Path | None = None,
    record_bag: Path | None = None,
    view: bool = False,
    web: bool = False,
    json: bool = False,
    switches: Annotated[Switches, OmitArgPrefixes] = Switches(),  # noqa: B008 (tyro reads the default; it is frozen)
) -> int:
    """Drive one world headless. Exit code 0 = arrived, 1 = did not, 2 = bad input.

    Args:
        world: Built-in name (see `appli worlds`), barn-like/K, or a file: *.world, *.npz#K, *.npy, *.toml, map.yaml,
            *.obj|stl|ply|glb.
        driver: Who drives: dwa (move_base with one parameter set), theta:NAME (a row of the paper's Table I, all the
            time), or a policy (.safetensors).
        protocol: Start, goal, tolerance and time limit of BARN worlds.
        seed: Root of all noise; equal seeds give equal runs.
        params: YAML file with some of the eight planner parameters, e.g. "max_vel_x: 0.8".
        start: "x,y" or "x,y,yaw" in metres and radians, instead of the world's; maps and meshes need one.
        goal: "x,y" in metres, instead of the world's; maps and meshes need one.
        record: Write a Rerun recording (.rrd) here.
        record_bag: Write the drive as a ROS 2 bag (.mcap) here (docs/real_robot.md).
        view: Watch while it runs, in Rerun's viewer.
        web: With --view: as a page that only this machine can open, instead of a window; it stays until Ctrl-C.
        json: Print one JSON object on stdout and nothing else.
        switches: Planner switches.
    """
    from scenarios.run import run_command

    return run_command(
        world, driver, protocol, seed, params, start, goal, record, record_bag, view, web, json, switches
    )


def collect(
    world: Positional[Annotated[str | None, arg(metavar="[WORLD]")]] = None,
    /,
    *,
    out: Path,
    protocol: Protocol = "appli",
    seed: int = 0,
    sessions: int = 4,
    rewind: bool = True,
    record: bool = False,
    bag: Annotated[BagOptions, OmitArgPrefixes] = BagOptions(),  # noqa: B008 (tyro reads the default; it is frozen)
) -> int:
    """Watch the default planner, intervene like a person, and write the interventions (types A, B and D).

    With --bag: take them out of a recorded drive instead (docs/real_robot.md).

    Args:
        world: As for `appli run`; with --bag only the name that the interventions get.
        out: Folder for the interventions, one .npz each.
        protocol: Start, goal, tolerance and time limit of BARN worlds.
        seed: Root of all noise, of the first session.
        sessions: Drives that are watched, with seeds from `seed` on. Each shows every place once; the context
            classifier needs several.
        rewind: --no-rewind takes over where the robot failed and brings it to a good state first; only what follows
            is learnt from, and type D is left out.
        record: Write a recording of each beside it: the default's drive, the rewind, the demonstration.
        bag: Recorded drives.
    """
    if bag.bag is not None:
        from scenarios.bags.importing import collect_bag_command

        return collect_bag_command(bag, world, out, seed, rewind, record)
    bag.refuse_without_bag()
    if world is None:
        raise UserError(f"collect needs a WORLD or --bag FILE; try: appli collect training --out {out}")
    from scenarios.collect import collect_command

    return collect_command(world, out, protocol, seed, sessions, rewind, record)


def teleop(
    world: Positional[WorldName],
    /,
    out: Path,
    surface: Literal["web", "window", "terminal"] = "web",
    driver: str = "dwa",
    protocol: Protocol = "appli",
    seed: int = 0,
    keys: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
) -> int:
    """Drive along and intervene by keyboard: 1, 2, 3 take over (type A, B, D), R rewinds, Enter hands back, Q quits.

    Args:
        world: As for `appli run`.
        out: Folder for the interventions, one .npz each.
        surface: A browser page, a native window, or a terminal (for SSH).
        driver: Who drives until the person takes over.
        protocol: Start, goal, tolerance and time limit of BARN worlds.
        seed: Root of all noise.
        keys: Replay timed key presses from this file, headless (docs/driving.md).
        host: Address the web page listens on; anything but loopback lets strangers drive.
        port: Port of the web page; 0 takes a free one.
    """
    from scenarios.teleop import teleop_command

    return teleop_command(world, out, surface, driver, protocol, seed, keys, host, port)


def train(
    interventions: Positional[Path],
    /,
    out: Path,
    types: str = "A,B",
    seed: int = 0,
    all_methods: bool = False,
    policy: Annotated[PolicyOptions, OmitArgPrefixes] = PolicyOptions(),  # noqa: B008 (tyro reads the default; it is frozen)
) -> int:
    """Learn a policy from a folder of interventions: parameters by CMA-ES (Eq. 1), and the context classifier.

    Args:
        interventions: Folder written by `appli collect` or `appli teleop`.
        out: The policy, one .safetensors file; with --all-methods a folder.
        types: Which interventions to use.
        seed: Of the search and of the training.
        all_methods: Make the policies of all the paper's methods: A, A+c, A+B, A+B+c, A+B+D, A+B+D+c.
        policy: How the policy is made and used.
    """
    from scenarios.training import train_command

    return train_command(interventions, out, types, seed, all_methods, policy)


def view(recordings: Positional[tuple[Path, ...]], /, compare: bool = False, web: bool = False, port: int = 0) -> int:
    """Open a recording in Rerun's viewer, or two side by side.

    Args:
        recordings: Files that `appli run --record` or `appli collect --record` wrote (.rrd).
        compare: Show two recordings of one world side by side.
        web: As a page that only this machine can open, until Ctrl-C, instead of a window.
        port: Port of the page; 0 takes a free one.
    """
    from scenarios.view import view_command

    return view_command(recordings, compare, web, port)


def export(policy: Positional[Path], /, out: Path, format: Literal["move_base", "nav2"] = "move_base") -> int:
    """Write a policy as YAML parameters for a real robot, one set per context (docs/real_robot.md).

    Args:
        policy: File written by `appli train`.
        out: New folder for the files.
        format: move_base = ROS 1 (melodic, noetic), the planner that theta was learned for; nav2 = ROS 2's
            DWB, a relative: values to start from.
    """
    from scenarios.export import export_command

    return export_command(policy, format, out)


def sweep(
    out: Path,
    worlds: str,
    methods: str,
    runs: int,
    policies: Path | None = None,
    seed: int = 0,
    protocol: Protocol = "appli",
    workers: int | None = None,
    scheduler: str | None = None,
) -> int:
    """Run worlds x methods x runs on all cores or on a cluster; the same command goes on where it was stopped.

    Args:
        out: The results, one SQLite file with a row per trial.
        worlds: Names with commas between, as for `appli run`; also barn-like (all 300), barn-like/0-99, FILE.npz
            (all in it) or FILE.npz#0-99, and a folder of *.world files.
        methods: Names with commas between: dwa, and the names of policies such as A+B+c.
        runs: Trials per world and method.
        policies: Folder with a policy NAME.safetensors per method (see appli train --all-methods).
        seed: Root of all noise; all methods meet the same.
        protocol: Start, goal, tolerance and time limit of BARN worlds.
        workers: Local processes; by default one per core.
        scheduler: Address of a dask scheduler, as in tcp://host:8786, instead of local processes.
    """
    from scenarios.sweep import sweep_command

    return sweep_command(out, worlds, methods, policies, runs, seed, protocol, workers, scheduler)


def report(
    results: Positional[str],
    /,
    out: Path | None = None,
    policies: Path | None = None,
    worlds: str | None = None,
    pick: str = "",
    check: Path | None = None,
    update: Path | None = None,
) -> int:
    """Tables, figures and one page from the results of sweeps, next to the paper's (docs/experiments.md).

    Exit code 1 = with --check, the README's tables differ from the results.

    Args:
        results: Files written by `appli sweep`, with commas between.
        out: Folder for report.html, report.md, tables/*.csv and figures/*.svg.
        policies: Folder of the policies that were driven: adds Table I, maps of the contexts and learning curves.
        worlds: Files of the BARN worlds that were driven, as for `appli sweep`: adds their difficulty metrics.
        pick: Which version, when the results hold several: newest, or the beginning of a code digest.
        check: A README whose tables, between <!-- table: NAME --> and <!-- end -->, must agree with the results.
        update: A README whose tables are rewritten.
    """
    from scenarios.report.command import report_command

    return report_command(results, out, policies, worlds, pick, check, update)


def worlds(json: bool = False) -> int:
    """List the built-in worlds.

    Args:
        json: Print one JSON array on stdout and nothing else.
    """
    from scenarios.run import worlds_command

    return worlds_command(json)


def demo(out: Path = Path("out/demo"), seed: int = 0, sessions: int = 4) -> int:
    """The paper in miniature: collect interventions, learn from them, drive with and without, record it all.

    Takes some minutes. What an earlier demo left in the folder is used again.

    Args:
        out: Folder for interventions, policy and recordings.
        seed: Root of all noise.
        sessions: How many drives the intervener watches.
    """
    from scenarios.demo import demo_command

    return demo_command(out, seed, sessions)


def bench(json: bool = False, repeats: int = 2) -> int:
    """Measure the speed of the twin and of the planner on this machine, as ratios to the floor.

    Args:
        json: Print one JSON object on stdout and nothing else.
        repeats: How often every drive is timed.
    """
    if repeats < 1:
        raise UserError(f"--repeats must be 1 or more, not {repeats}")
    from scenarios.bench import bench_command

    return bench_command(json, repeats)


COMMANDS: dict[str, Callable[..., int]] = {
    "run": run,
    "collect": collect,
    "teleop": teleop,
    "train": train,
    "sweep": sweep,
    "report": report,
    "view": view,
    "export": export,
    "worlds": worlds,
    "bench": bench,
    "demo": demo,
}
