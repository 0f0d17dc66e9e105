"""The import rules of the house, read from the source tree."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("twin", "learning", "scenarios")

# Who may import what of ours (prefixes). Everything may import itself and what stands below it.
ALLOWED: dict[str, tuple[str, ...]] = {
    "twin.records": (),
    "twin.compiled": (),
    "twin.geometry": ("twin.records",),
    "twin.world": ("twin.records", "twin.geometry"),
    "twin.free_space": ("twin.records", "twin.geometry", "twin.world"),
    "twin.clearance": ("twin.compiled", "twin.free_space", "twin.records", "twin.geometry", "twin.world"),
    "twin.robot": ("twin.robot", "twin.records", "twin.geometry"),
    "twin.planner": ("twin.planner", "twin.compiled", "twin.records", "twin.geometry"),
    "twin.columns": ("twin.records", "twin.world"),
    "twin.arena": ("twin.columns", "twin.world", "twin.robot", "twin.records", "twin.geometry"),
    "twin.simulation": (
        "twin.arena",
        "twin.world",
        "twin.robot",
        "twin.clearance",
        "twin.records",
        "twin.geometry",
        "twin.planner.obstacle_memory",  # an observation holds what the obstacle layers remember
    ),
    "twin.environment": (
        *("twin.rollout", "twin.simulation", "twin.world", "twin.records", "twin.geometry"),
        *("twin.planner.move_base", "twin.planner.params"),
    ),
    "twin.rewind": ("twin.rollout", "twin.simulation", "twin.records"),
    "twin.rollout": ("twin.simulation", "twin.world", "twin.records", "twin.geometry"),
    "twin.recording": (
        "twin.recording",
        "twin.simulation",
        "twin.world",
        "twin.robot",
        "twin.records",
        "twin.geometry",
    ),
    "twin": ("twin",),
    # the bystander of learning.intervener sees true poses and the true map: data, no physics
    "learning": (
        "learning",
        "twin.planner",
        "twin.compiled",
        "twin.records",
        "twin.geometry",
        "twin.world",
        "twin.free_space",
    ),
    "scenarios": ("scenarios", "learning", "twin"),
}

# One doorway per heavy library: top-level package -> modules that may import it.
DOORWAYS: dict[str, tuple[str, ...]] = {
    "rerun": ("twin.recording",),
    "rerun_cli": ("twin.recording",),
    "torch": ("learning.evidential",),
    "cma": ("learning.fit", "scenarios.headroom"),  # Eq. 1; and a diagnosis that is no part of learning
    "trimesh": ("twin.assets", "scenarios.imported"),
    "distributed": ("scenarios.sweep",),
    "dask": ("scenarios.sweep",),
    "matplotlib": ("scenarios.report.figures",),
    "mujoco": (
        *("twin.simulation", "twin.arena", "twin.robot"),
        "scenarios.surfaces.studio",  # Studio comes with mujoco
        "scenarios.pictures.stage",  # and so does the renderer
    ),
    "websockets": ("scenarios.surfaces.web_guard",),
    "dm_control": ("twin.arena", "twin.robot"),
    "dm_env": ("twin.environment",),
    "rosbags": ("scenarios.bags.files",),
}


def modules() -> list[tuple[str, Path]]:
    """(dotted name, file) of every module of the packages."""
    found = []
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found.append((".".join(parts[:-1] if parts[-1] == "__init__" else parts), path))
    return found


def imports(path: Path) -> set[str]:
    """Dotted names imported anywhere in a file but for the type checker's sake, `from a import b` as a.b."""
    names: set[str] = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):  # drop the bodies of `if TYPE_CHECKING:`
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            node.body = [ast.Pass()]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def within(name: str, prefix: str) -> bool:
    """Whether a dotted name is the prefix or below it."""
    return name == prefix or name.startswith(prefix + ".")


def rule_for(module: str) -> tuple[str, ...]:
    """The rule of the longest prefix."""
    return ALLOWED[max((p for p in ALLOWED if within(module, p)), key=len)]


@pytest.mark.parametrize(("module", "path"), modules(), ids=lambda value: value if isinstance(value, str) else "")
def test_imports_run_downwards(module: str, path: Path) -> None:
    for name in imports(path):
        if name.split(".")[0] in PACKAGES:
            assert any(within(name, allowed) for allowed in rule_for(module)), f"{module} may not import {name}"


@pytest.mark.parametrize(("module", "path"), modules(), ids=lambda value: value if isinstance(value, str) else "")
def test_heavy_libraries_have_one_doorway(module: str, path: Path) -> None:
    for name in imports(path):
        doors = DOORWAYS.get(name.split(".")[0])
        assert doors is None or any(within(module, door) for door in doors), f"{module} may not import {name}"
