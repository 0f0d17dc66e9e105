"""The planner against recordings of ROS's own C++ (costmap_2d, navfn, base_local_planner).

Every case of every file in the folder named by the environment variable APPLI_GOLDEN runs through the public functions
of `twin.planner`. Without the variable: ../shared/golden beside the checkout, or the small set in tests/data/golden.
`pytest tests/test_conformance.py -s` prints the agreement per file; docs/conformance.md explains it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.conformance import grids, local_planner
from tests.conformance.agreement import Agreement

ROOT = Path(__file__).resolve().parents[1]
SMALL = ROOT / "tests" / "data" / "golden"

CHECKS: dict[str, Callable[[Mapping[str, np.ndarray]], Agreement]] = {
    "obstacle": grids.check_obstacle,
    "inflation": grids.check_inflation,
    "navfn": grids.check_navfn,
    "mapgrid": local_planner.check_mapgrid,
    "footprint": grids.check_footprint,
    "scoring": local_planner.check_scoring,
    "sequence": local_planner.check_sequence,
    "controller": local_planner.check_controller,
}


def golden_folder() -> Path:
    """Where the recordings are: APPLI_GOLDEN, else the full set beside the checkout, else our small one."""
    if "APPLI_GOLDEN" in os.environ:
        return Path(os.environ["APPLI_GOLDEN"])
    beside = ROOT.parent / "shared" / "golden"
    return beside if beside.is_dir() else SMALL


@pytest.mark.parametrize("name", CHECKS)
def test_equal_to_ros(name: str) -> None:
    with np.load(golden_folder() / f"{name}.npz", allow_pickle=False) as data:
        agreement = CHECKS[name](data)
    print(f"\n{agreement}")
    assert agreement.cases > 0
    assert not agreement.differing, f"{agreement}\n" + "\n".join(agreement.differing)


@pytest.mark.parametrize("name", CHECKS)
def test_the_small_set_holds_cases_of_every_file(name: str) -> None:
    with np.load(SMALL / f"{name}.npz", allow_pickle=False) as data:
        agreement = CHECKS[name](data)
    assert agreement.cases > 0
    assert not agreement.differing, "\n".join(agreement.differing)


def test_a_wrong_recording_is_noticed() -> None:
    """The checks can fail: one byte of one expected grid is enough."""
    with np.load(SMALL / "inflation.npz", allow_pickle=False) as data:
        arrays = dict(data)
    arrays["grid_out"] = arrays["grid_out"].copy()
    arrays["grid_out"][12] ^= 1
    assert len(grids.check_inflation(arrays).differing) == 1
