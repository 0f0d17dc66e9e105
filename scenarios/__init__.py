"""Worlds, trials and their results, and the `appli` command.

    from scenarios import TrialSpec, run_trial

    result = run_trial(TrialSpec("barn-like/150", seed=1))
    print(result.outcome, result.time, result.min_clearance)

What stands in `__all__` is the public API. MuJoCo and numba are loaded with the first name that needs them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenarios.errors import UserError, one_line_errors
    from scenarios.store import Store, StoredTrial
    from scenarios.switches import Switches
    from scenarios.trials import TrialResult, TrialSpec, make_driver, make_simulation, result_as_dict, run_trial
    from scenarios.worlds import WorldEntry, WorldError, list_worlds, load_world

__all__ = [
    "Store",
    "StoredTrial",
    "Switches",
    "TrialResult",
    "TrialSpec",
    "UserError",
    "WorldEntry",
    "WorldError",
    "list_worlds",
    "load_world",
    "make_driver",
    "make_simulation",
    "one_line_errors",
    "result_as_dict",
    "run_trial",
]

_HOMES = {
    "WorldEntry": "worlds",
    "WorldError": "worlds",
    "list_worlds": "worlds",
    "load_world": "worlds",
    "TrialResult": "trials",
    "TrialSpec": "trials",
    "make_driver": "trials",
    "make_simulation": "trials",
    "result_as_dict": "trials",
    "run_trial": "trials",
    "Switches": "switches",
    "Store": "store",
    "StoredTrial": "store",
    "UserError": "errors",
    "one_line_errors": "errors",
}


def __getattr__(name: str) -> Any:
    """A name of the public API, loaded when it is first asked for (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
