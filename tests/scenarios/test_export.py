"""`appli export`: every number of theta arrives under the right name, and a mistake leaves nothing behind.

Names and values of the robot are typed here a second time on purpose, from the Jackal's yaml files (spec, section 12)
and from the sources of ROS and Nav2: a test that takes them from the code could not fail.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.policy import Context, Policy, PolicySwitches, Provenance
from learning.policy_file import policy_bytes, save_policy
from scenarios.cli import main
from scenarios.export_files import write_folder
from scenarios.export_move_base import move_base_export
from scenarios.export_nav2 import nav2_export
from tests.learning.classifiers import random_classifier
from twin.planner.params import INTEGERS, RECONFIGURE_RANGE, PlannerParams
from twin.planner.trajectory_state import LocalPlannerSettings, from_ros_values

# Three parameter sets without a number in common, so that no mix-up goes unseen.
A1 = PlannerParams(0.26, 1.11, 13, 44, 0.57, 0.76, 0.94, 0.02)
B1 = PlannerParams(1.9, 2.01, 19, 59, 0.31, 0.123456789012345, 1.0 / 3.0, 0.23)
START = PlannerParams(0.5, 1.57, 6, 20, 0.1, 0.75, 1.0, 0.3)
THETAS = {"default": START, "A1": A1, "B1": B1}
POLICY = Policy(
    (Context("A1", A1), Context("B1", B1)),
    replace(random_classifier(contexts=2), labels=("A1", "B1")),
    eps_u=0.7,
    window=12,
    provenance=Provenance(
        {"0a1b": "B1", "2c3d": "A1"},
        {"B1": (12.5, 0.25)},
        figures={"accuracy": 0.9},
        versions={"cma": "3"},
        types="A,B",
        seed=7,
    ),
)
ALL_SWITCHES = [PolicySwitches(False, i, c) for i in ("both", "local") for c in (False, True)]  # type: ignore[arg-type]

# jackal_navigation/params/base_local_planner_params.yaml, under the names of melodic and noetic
JACKAL_PLANNER = {
    "acc_lim_x": 10.0, "acc_lim_theta": 20.0, "max_vel_x": 0.5, "min_vel_x": 0.1, "max_vel_theta": 1.57,
    "min_vel_theta": -1.57, "min_in_place_vel_theta": 0.314, "holonomic_robot": False, "escape_vel": -0.5,
    "yaw_goal_tolerance": 0.157, "xy_goal_tolerance": 0.25, "latch_xy_goal_tolerance": False, "sim_time": 2.0,
    "sim_granularity": 0.02, "angular_sim_granularity": 0.02, "vx_samples": 6, "vtheta_samples": 20,
    "controller_frequency": 20.0, "occdist_scale": 0.1, "path_distance_bias": 0.75, "goal_distance_bias": 1.0,
    "heading_lookahead": 0.325, "heading_scoring": False, "heading_scoring_timestep": 0.8, "dwa": True,
    "simple_attractor": False, "oscillation_reset_dist": 0.05, "escape_reset_dist": 0.1, "escape_reset_theta": 0.1,
    # what the yaml is silent about: ROS's defaults, and the twin's reading of meter_scoring
    "acc_lim_y": 2.5, "max_rotational_vel": 1.0, "prune_plan": True, "meter_scoring": False,
}  # fmt: skip


def export(tmp_path: Path, policy: Policy, format: str) -> Path:
    """The folder that the command makes of a policy."""
    path, out = tmp_path / "policy.safetensors", tmp_path / format
    save_policy(policy, path)
    assert run("export", str(path), "--format", format, "--out", str(out)) == 0
    return out


def run(*arguments: str) -> int:
    """Exit code of the command, in this process."""
    with pytest.raises(SystemExit) as stop:
        main(list(arguments))
    return int(stop.value.code or 0)


def read(path: Path) -> Any:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def merged(*documents: dict[str, Any]) -> dict[str, Any]:
    """What is in force after loading one after the other: `rosparam load` and --params-file both merge."""
    result: dict[str, Any] = {}
    for document in documents:
        for key, value in document.items():
            old = result.get(key)
            result[key] = merged(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return result


def loaded(out: Path, label: str) -> dict[str, Any]:
    """The parameters on the robot after start-up and the files of one context."""
    manifest = read(out / "contexts.yaml")
    (context,) = [c for c in manifest["contexts"] if c["label"] == label]
    shared = [name for role, name in manifest["files"].items() if role != "all_contexts"]
    return merged(*(read(out / name) for name in [*shared, *context["files"].values()]))


def theta_of(robot: dict[str, Any]) -> PlannerParams:
    """theta as a robot with these move_base parameters has it."""
    planner = robot["TrajectoryPlannerROS"]
    return PlannerParams(
        max_vel_x=planner["max_vel_x"],
        max_vel_theta=planner["max_vel_theta"],
        vx_samples=planner["vx_samples"],
        vtheta_samples=planner["vtheta_samples"],
        occdist_scale=planner["occdist_scale"],
        pdist_scale=planner["path_distance_bias"],
        gdist_scale=planner["goal_distance_bias"],
        inflation_radius=robot["local_costmap"]["inflater_layer"]["inflation_radius"],
    )


# --- move_base -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("label", THETAS)
def test_move_base_files_read_back_as_theta(tmp_path: Path, label: str) -> None:
    assert theta_of(loaded(export(tmp_path, POLICY, "move_base"), label)) == THETAS[label]


def test_move_base_with_the_default_context_is_the_jackal(tmp_path: Path) -> None:
    assert loaded(export(tmp_path, POLICY, "move_base"), "default")["TrajectoryPlannerROS"] == JACKAL_PLANNER


def test_start_up_files_hold_nothing_of_theta(tmp_path: Path) -> None:
    out = export(tmp_path, POLICY, "move_base")
    theta = read(out / "context1_A1" / "base_local_planner.yaml")["TrajectoryPlannerROS"]
    assert not theta.keys() & read(out / "base_local_planner.yaml")["TrajectoryPlannerROS"].keys()
    assert "inflation_radius" not in (out / "costmaps.yaml").read_text().split("\n\n", 1)[1]


def test_move_base_costmaps_are_the_jackals(tmp_path: Path) -> None:
    robot = loaded(export(tmp_path, POLICY, "move_base"), "A1")
    local, global_ = robot["local_costmap"], robot["global_costmap"]
    assert (local["width"], local["height"], local["resolution"], local["rolling_window"]) == (10.0, 10.0, 0.05, True)
    assert (global_["width"], global_["origin_x"], global_["origin_y"], global_["rolling_window"]) == (
        40,
        -20,
        -20,
        False,
    )
    for costmap in (local, global_):
        assert costmap["footprint"] == [[-0.21, -0.165], [-0.21, 0.165], [0.21, 0.165], [0.21, -0.165]]
        assert costmap["footprint_padding"] == 0.1
        assert [layer["name"] for layer in costmap["plugins"]] == ["obstacles_layer", "inflater_layer"]
        scan = costmap["obstacles_layer"]["scan"]
        assert (scan["obstacle_range"], scan["raytrace_range"], scan["inf_is_valid"]) == (2.5, 3.0, False)
        assert costmap["inflater_layer"]["cost_scaling_factor"] == 10.0
    assert (robot["controller_patience"], robot["planner_patience"], robot["oscillation_timeout"]) == (15.0, 5.0, 0.0)


@pytest.mark.parametrize("switches", ALL_SWITCHES)
@pytest.mark.parametrize("format", ["move_base", "nav2"])
def test_switches_reach_the_robot(tmp_path: Path, format: str, switches: PolicySwitches) -> None:
    out = export(tmp_path, replace(POLICY, switches=switches), format)
    for label, theta in THETAS.items():
        robot = loaded(out, label)
        radii = [robot[name] for name in ("local_costmap", "global_costmap")]
        if format == "nav2":
            radii = [
                node[name]["ros__parameters"]
                for name, node in zip(("local_costmap", "global_costmap"), radii, strict=True)
            ]
        layer = "inflater_layer" if format == "move_base" else "inflation_layer"
        expected = theta.inflation_radius if switches.inflation == "both" else 0.3
        assert [costmap[layer]["inflation_radius"] for costmap in radii] == [theta.inflation_radius, expected]
        if format == "move_base":
            lowest = -theta.max_vel_theta if switches.couple_min_vel_theta else -1.57
            assert robot["TrajectoryPlannerROS"]["min_vel_theta"] == lowest


@pytest.mark.parametrize("couple", [False, True])
def test_a_context_holds_just_what_dynamic_reconfigure_takes_at_run_time(tmp_path: Path, couple: bool) -> None:
    out = export(tmp_path, replace(POLICY, switches=PolicySwitches(couple_min_vel_theta=couple)), "move_base")
    values = read(out / "context2_B1" / "base_local_planner.yaml")["TrajectoryPlannerROS"]
    known = {"max_vel_x", "max_vel_theta", "vx_samples", "vtheta_samples", "occdist_scale"}  # BaseLocalPlanner.cfg
    known |= {"path_distance_bias", "goal_distance_bias"} | ({"min_vel_theta"} if couple else set())
    assert set(values) == known


def any_theta() -> st.SearchStrategy[PlannerParams]:
    """All that ROS accepts."""
    return st.builds(
        PlannerParams,
        **{
            name: st.integers(int(low), int(high)) if name in INTEGERS else st.floats(low, high)
            for name, (low, high) in RECONFIGURE_RANGE.items()
        },
    )


@given(theta=any_theta())
@settings(max_examples=100, deadline=None)
def test_every_theta_survives_the_text_of_the_files(theta: PlannerParams) -> None:
    exported = move_base_export(Policy((), default=theta))
    files = [*exported.shared.values(), *exported.contexts["default"].values()]
    robot = merged(*(yaml.safe_load(file.text) for file in files))
    assert theta_of(robot) == theta
    planner = robot["TrajectoryPlannerROS"] | {"inflation_radius": theta.inflation_radius}
    renamed = {"path_distance_bias": "path_bias", "goal_distance_bias": "goal_bias"}
    of_wrapper = {
        "yaw_goal_tolerance",
        "xy_goal_tolerance",
        "latch_xy_goal_tolerance",
        "max_rotational_vel",
        "prune_plan",
    }
    switched = {"meter_scoring", "heading_scoring", "heading_scoring_timestep", "dwa", "simple_attractor"}
    frequency = planner.pop("controller_frequency")
    values = {renamed.get(k, k): v for k, v in planner.items() if k not in of_wrapper | switched}
    values["sim_period"] = 1.0 / frequency
    assert from_ros_values(values) == (theta, LocalPlannerSettings())


# --- nav2 ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("label", THETAS)
def test_nav2_weighs_cells_and_cost_bytes_as_the_twin(tmp_path: Path, label: str) -> None:
    theta = THETAS[label]
    server = loaded(export(tmp_path, POLICY, "nav2"), label)["controller_server"]["ros__parameters"]
    assert server["controller_plugins"] == ["FollowPath"]
    dwb = server["FollowPath"]
    assert dwb["plugin"] == "dwb_core::DWBLocalPlanner"
    # what getScale() of map_grid.hpp and obstacle_footprint.hpp makes of the scales on a grid of 0.05 m
    assert dwb["PathDist"]["scale"] * 0.05 * 0.5 == pytest.approx(theta.pdist_scale, rel=1e-12)
    assert dwb["GoalDist"]["scale"] * 0.05 * 0.5 == pytest.approx(theta.gdist_scale, rel=1e-12)
    assert dwb["ObstacleFootprint"]["scale"] * 0.05 == pytest.approx(theta.occdist_scale, rel=1e-12)
    assert {"PathDist", "GoalDist", "ObstacleFootprint"} <= set(dwb["critics"])
    assert (dwb["max_vel_x"], dwb["max_speed_xy"]) == (theta.max_vel_x, theta.max_vel_x)
    assert dwb["max_vel_theta"] == theta.max_vel_theta
    assert (dwb["vx_samples"], dwb["vtheta_samples"]) == (theta.vx_samples, theta.vtheta_samples)
    assert (dwb["acc_lim_x"], dwb["acc_lim_theta"], dwb["decel_lim_theta"]) == (10.0, 20.0, -20.0)
    assert (dwb["sim_time"], dwb["min_vel_x"], dwb["min_speed_xy"]) == (2.0, 0.0, 0.1)
    assert (server["controller_frequency"], server["failure_tolerance"]) == (20.0, 15.0)
    assert server["goal_checker"]["yaw_goal_tolerance"] == 0.157


WHOLE = {"vx_samples", "vy_samples", "vtheta_samples", "width", "height", "combination_method"}


@given(theta=any_theta())
@settings(max_examples=30, deadline=None)
def test_nav2_numbers_have_the_types_that_ros_2_insists_on(theta: PlannerParams) -> None:
    whole = replace(theta, max_vel_x=1, inflation_radius=0, vx_samples=float(theta.vx_samples))  # type: ignore[arg-type]

    def check(name: str, value: object) -> None:
        if isinstance(value, dict):
            for key, inner in value.items():
                check(key, inner)
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            assert isinstance(value, int) == (name in WHOLE), name

    for file in nav2_export(Policy((), default=whole)).files:
        check(file.path, yaml.safe_load(file.text))


def test_nav2_has_all_contexts_side_by_side(tmp_path: Path) -> None:
    out = export(tmp_path, POLICY, "nav2")
    together = read(out / "all_contexts.yaml")["controller_server"]["ros__parameters"]
    assert together.pop("controller_plugins") == ["context0_default", "context1_A1", "context2_B1"] == list(together)
    for name, values in together.items():
        assert values == read(out / f"{name}.yaml")["controller_server"]["ros__parameters"]["FollowPath"]


def test_nav2_files_begin_with_what_is_lost(tmp_path: Path) -> None:
    out = export(tmp_path, POLICY, "nav2")
    for path in out.glob("*.yaml"):
        assert ("NOT THE PLANNER THAT THETA WAS LEARNED FOR" in path.read_text()) == (path.name != "contexts.yaml")
    text = (out / "base.yaml").read_text()
    for word in ("Path and goal distance", "min_vel_theta", "-1.57 rad/s", "vx_samples", "escape", "Inflation"):
        assert word in text


# --- the folder ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("format", ["move_base", "nav2"])
def test_the_manifest_says_it_all(tmp_path: Path, format: str) -> None:
    switches = PolicySwitches(path_gate=True, inflation="local", couple_min_vel_theta=True)
    policy = replace(POLICY, switches=switches, use_confidence=False)
    out = export(tmp_path, policy, format)
    manifest = read(out / "contexts.yaml")
    assert manifest["format"] == format
    assert (manifest["eps_u"], manifest["window"], manifest["use_confidence"]) == (0.7, 12, False)
    assert manifest["switches"] == {"path_gate": True, "inflation": "local", "couple_min_vel_theta": True}
    assert manifest["policy"]["sha256"] == hashlib.sha256(policy_bytes(policy)).hexdigest()
    assert {c["label"]: PlannerParams(**c["theta"]) for c in manifest["contexts"]} == THETAS
    assert [c["interventions"] for c in manifest["contexts"]] == [[], ["2c3d"], ["0a1b"]]
    assert manifest["contexts"][2]["loss"] == {"default": 12.5, "theta": 0.25}
    assert manifest["provenance"]["interventions"] == {"0a1b": "B1", "2c3d": "A1"}
    assert (manifest["provenance"]["seed"], manifest["provenance"]["types"]) == (7, "A,B")
    listed = {"contexts.yaml", *manifest["files"].values()}
    listed |= {name for c in manifest["contexts"] for name in c["files"].values()}
    assert listed == {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()}


def test_no_label_leaves_the_folder_or_hides_another(tmp_path: Path) -> None:
    labels = ("../../x", "A/1", "A_1", "A 1", "ä: 'ö' # {}", "...", "yes")
    classifier = replace(random_classifier(contexts=len(labels)), labels=labels)
    thetas = {label: replace(A1, max_vel_x=1.0 + k / 8) for k, label in enumerate(labels)}
    policy = Policy(tuple(Context(label, theta) for label, theta in thetas.items()), classifier)
    for format in ("move_base", "nav2"):
        out = export(tmp_path, policy, format)
        read_back = {c["label"]: c["theta"]["max_vel_x"] for c in read(out / "contexts.yaml")["contexts"][1:]}
        assert read_back == {label: theta.max_vel_x for label, theta in thetas.items()}
    out = tmp_path / "move_base"
    assert {label: theta_of(loaded(out, label)) for label in labels} == thetas
    assert sorted(p.name for p in tmp_path.iterdir()) == ["move_base", "nav2", "policy.safetensors"]
    for path in [*(tmp_path / "move_base").iterdir(), *(tmp_path / "nav2").iterdir()]:
        assert re.fullmatch(r"\w+(\.yaml)?", path.name, re.ASCII), path


def test_equal_policies_give_equal_files(tmp_path: Path) -> None:
    (tmp_path / "again").mkdir()
    one, two = export(tmp_path, POLICY, "nav2"), export(tmp_path / "again", POLICY, "nav2")
    assert {p.name: p.read_bytes() for p in one.iterdir()} == {p.name: p.read_bytes() for p in two.iterdir()}


def test_the_folder_is_an_ordinary_one(tmp_path: Path) -> None:
    (tmp_path / "plain").mkdir()
    (tmp_path / "move_base").mkdir()  # an empty folder is as good as none
    out = export(tmp_path, POLICY, "move_base")
    assert out.stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_link_to_an_empty_folder_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "move_base").symlink_to("elsewhere")
    out = export(tmp_path, POLICY, "move_base")
    assert out.is_symlink()
    assert (tmp_path / "elsewhere" / "contexts.yaml").exists()


# --- mistakes --------------------------------------------------------------------------------------------------------


def complaint(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line on stderr of a refused export."""
    capsys.readouterr()
    assert run("export", *arguments) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("appli: ")
    assert said.err.count("\n") == 1
    return said.err


@pytest.fixture
def policy_path(tmp_path: Path) -> Path:
    save_policy(POLICY, tmp_path / "policy.safetensors")
    return tmp_path / "policy.safetensors"


def test_a_bad_policy_is_refused(tmp_path: Path, policy_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, cut = str(tmp_path / "new" / "out"), tmp_path / "cut.safetensors"
    data = policy_path.read_bytes()
    for kept in (0, 7, 100, len(data) // 2, len(data) - 1):
        cut.write_bytes(data[:kept])
        assert "cut.safetensors: not a policy, or a truncated one" in complaint(capsys, str(cut), "--out", out)
    assert "missing: No such file" in complaint(capsys, str(tmp_path / "missing"), "--out", out)
    assert not (tmp_path / "new").exists()


def test_an_unknown_format_is_refused(tmp_path: Path, policy_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = complaint(capsys, str(policy_path), "--format", "nav3", "--out", str(tmp_path / "out"))
    assert all(word in said for word in ("nav3", "move_base", "nav2"))
    assert not (tmp_path / "out").exists()


def test_an_occupied_folder_is_left_alone(
    tmp_path: Path, policy_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.yaml").write_text("precious")
    said = complaint(capsys, str(policy_path), "--out", str(out))
    assert "not empty" in said
    assert f"rm -r {out}" in said
    assert {p.name: p.read_text() for p in out.iterdir()} == {"mine.yaml": "precious"}
    assert "is a file" in complaint(capsys, str(policy_path), "--out", str(policy_path))
    assert complaint(capsys, str(policy_path), "--out", str(policy_path / "below"))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert "does not exist yet" in complaint(capsys, str(policy_path), "--out", ".")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["here", "out", "policy.safetensors"]


def test_a_write_that_fails_leaves_nothing(
    tmp_path: Path, policy_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write, left = Path.write_text, [3]

    def fail_at_the_third(self: Path, *args: Any, **kwargs: Any) -> int:
        left[0] -= 1
        if left[0] == 0:
            raise OSError(28, os.strerror(28))
        return write(self, *args, **kwargs)

    monkeypatch.setattr(Path, "write_text", fail_at_the_third)
    assert "No space left" in complaint(capsys, str(policy_path), "--out", str(tmp_path / "out"))
    assert [p.name for p in tmp_path.iterdir()] == ["policy.safetensors"]


def test_a_place_that_cannot_be_written_is_named_as_it_was_given(
    policy_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = complaint(capsys, str(policy_path), "--out", "/proc/exported")
    assert "cannot write the folder /proc/exported: " in said
    assert ".part" not in said


def test_a_folder_that_fills_in_the_meantime_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from scenarios.errors import UserError

    out, rename = tmp_path / "out", Path.rename

    def someone_was_faster(self: Path, target: Path) -> Path:
        out.mkdir()
        (out / "theirs").write_text("")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", someone_was_faster)
    with pytest.raises(UserError, match="not empty"):
        write_folder(move_base_export(POLICY).files, out)
    assert [p.name for p in tmp_path.rglob("*")] == ["out", "theirs"]


def test_export_needs_no_heavy_library(tmp_path: Path, policy_path: Path) -> None:
    import subprocess

    code = (
        "import sys; from pathlib import Path; from scenarios.export import export_command\n"
        f"export_command(Path({str(policy_path)!r}), 'nav2', Path({str(tmp_path / 'out')!r}))\n"
        "print([m for m in ('torch', 'rerun', 'dask', 'matplotlib', 'mujoco', 'cma') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.splitlines()[-1] == "[]"
