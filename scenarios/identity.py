"""What makes a stored trial that trial: digests of the code, the world and the policy, and the key made of them.

The code is all that `scenarios.trials` imports, as syntax without comments and docstrings, with the robot's model and
the versions of the packages that compute. Two things are left out: how worlds are read or generated, because the
world's contents are hashed themselves, and whatever works on results. So neither a new course nor a better report makes
a day of computing worthless.
"""

from __future__ import annotations

import ast
import hashlib
import json
import platform
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

import twin
from twin.world import Mesh, World

ROOT = Path(twin.__file__).parents[1]  # holds the packages, in a checkout as where they are installed
PACKAGES = ("twin", "learning", "scenarios")
START = "scenarios.trials"
WORLD_READERS = "scenarios.worlds"  # left out: what it makes of a world is hashed
LIBRARIES = ("mujoco", "numpy", "numba")


def _digest(*parts: str | bytes) -> str:
    """SHA-256 of the parts, each with its length so that no two lists run into one."""
    state = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        state.update(f"{len(data)}:".encode() + data)
    return state.hexdigest()


# --- code ------------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def code_digest() -> str:
    """Of all that decides a trial beside world, policy and seed. The first answer stays for this process."""
    sources = [part for path in deciding_sources() for part in (path.relative_to(ROOT).as_posix(), _syntax(path))]
    assets = [p for p in sorted((ROOT / "twin" / "assets").iterdir()) if p.suffix in (".xml", ".stl")]
    model = [part for path in assets for part in (path.name, path.read_bytes())]
    versions = [f"{name} {version(name)}" for name in LIBRARIES]
    python = ".".join(platform.python_version_tuple()[:2])  # the syntax tree's form depends on it
    return _digest(python, *versions, *sources, *model)


def deciding_sources() -> list[Path]:
    """The files of ours that `scenarios.trials` imports, directly or not."""
    found: dict[str, Path] = {}
    waiting = [START]
    while waiting:
        name = waiting.pop()
        path = _source(name)
        if name in found or name == WORLD_READERS or path is None:
            continue
        found[name] = path
        waiting += sorted(_imports(path))
    return sorted(set(found.values()))


def _source(name: str) -> Path | None:
    """The file of a dotted name; None for what is not a module (a class, a function)."""
    stem = ROOT.joinpath(*name.split("."))
    return next((p for p in (stem.with_suffix(".py"), stem / "__init__.py") if p.is_file()), None)


def _imports(path: Path) -> set[str]:
    """Dotted names of ours that a file imports: `from a.b import c` may mean the module a.b or a.b.c."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in names if name.split(".")[0] in PACKAGES}


def _syntax(path: Path) -> str:
    """The program without what does not run: comments, layout, docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            node.body = [statement for statement in node.body if not _is_text(statement)]
    return ast.dump(tree)


def _is_text(statement: ast.stmt) -> bool:
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


# --- world, policy, trial --------------------------------------------------------------------------------------------


def world_digest(world: World) -> str:
    """Of everything in a world that a trial meets, and of its name."""
    parts: list[str | bytes] = [repr((world.name, world.index, world.start, world.goal, world.rules))]
    for obstacle in world.obstacles:
        if isinstance(obstacle, Mesh):
            parts += [obstacle.style, obstacle.vertices.tobytes(), obstacle.faces.tobytes()]
        else:
            parts.append(repr(obstacle))
    return _digest(*parts)


def policy_digest(policy: bytes | None) -> str:
    """Of a policy file's bytes; "" where there is none."""
    return "" if policy is None else hashlib.sha256(policy).hexdigest()


def trial_key(world: str, policy: str, code: str, seed: int, run: int) -> str:
    """The key of a trial, from digests. Names of methods and of files are not in it."""
    return _digest(json.dumps([world, policy, code, seed, run]))
