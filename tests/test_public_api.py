"""The public API: what `from twin import ...`, `from learning import ...` and `from scenarios import ...` offer."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import subprocess
import sys
import textwrap
from types import ModuleType

import pytest

import learning
import scenarios
import twin

PACKAGES = (twin, learning, scenarios)
NAMES = [(package, name) for package in PACKAGES for name in package.__all__]
HEAVY = ("mujoco", "dm_control", "numba", "torch", "rerun", "cma", "scipy", "matplotlib", "distributed", "pandas")


@pytest.mark.parametrize(("package", "name"), NAMES, ids=lambda x: x if isinstance(x, str) else x.__name__)
def test_every_public_name_is_there_and_documented(package: ModuleType, name: str) -> None:
    found = getattr(package, name)
    assert inspect.isclass(found) or inspect.isfunction(found)
    assert found.__name__ == name
    assert found.__module__.startswith(package.__name__)
    text = inspect.getdoc(found)
    assert text
    assert not text.startswith(f"{name}("), "the signature that dataclass writes is no documentation"
    assert name in dir(package)


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_no_lazy_name_is_that_of_a_module(package: ModuleType) -> None:
    # Importing a submodule puts it into its package: then the name would mean the one or the other, by order of import.
    assert not set(package._HOMES) & {module.name for module in pkgutil.iter_modules(package.__path__)}


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_every_public_name_is_listed_once(package: ModuleType) -> None:
    assert len(set(package.__all__)) == len(package.__all__)
    assert set(package._HOMES) <= set(package.__all__)


def test_rollout_is_the_function_whatever_was_imported_before() -> None:
    code = "import twin.rollout; from twin.rollout import Loop; from twin import rollout; print(rollout.__name__)"
    assert fresh(code) == "rollout"
    assert inspect.isfunction(twin.rollout)
    assert importlib.import_module("twin.rollout").rollout is twin.rollout


def test_an_unknown_name_is_an_attribute_error() -> None:
    for package in PACKAGES:
        with pytest.raises(AttributeError, match="no attribute 'Simulator'"):
            _ = package.Simulator


@pytest.mark.parametrize("code", ["import twin", "import twin.records", "import learning", "import scenarios"])
def test_importing_a_package_loads_nothing_heavy(code: str) -> None:
    assert fresh(f"import sys; {code}; print(*(name for name in {HEAVY} if name in sys.modules))") == ""


def test_the_planner_is_offered_without_mujoco() -> None:
    assert fresh("import sys; from twin import MoveBase, PlannerParams; print('mujoco' in sys.modules)") == "False"


@pytest.mark.parametrize(("package", "word"), [(twin, "reached"), (scenarios, "reached")])
def test_the_example_in_the_docstring_runs(package: ModuleType, word: str) -> None:
    lines = inspect.getdoc(package)
    assert lines is not None
    example = [line for line in lines.splitlines() if line.startswith("    ") or not line]
    assert word in fresh(textwrap.dedent("\n".join(example))).splitlines()[-1]


def fresh(code: str) -> str:
    """What a Python process of its own prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()
