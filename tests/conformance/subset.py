"""Cuts the small set in tests/data/golden from a full one: `python -m tests.conformance.subset FOLDER`.

The layout stays; only the number of cases shrinks, and what no case refers to any more is dropped.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[1] / "data" / "golden"

Arrays = dict[str, np.ndarray]

# How many cases (or runs, or sequences) of each file are kept, spread evenly over it.
CASES = {
    "controller": 5,
    "footprint": 240,
    "inflation": 30,
    "mapgrid": 10,
    "navfn": 24,
    "obstacle": 4,
    "scoring": 30,
    "sequence": 4,
}
# offsets array -> the arrays that it cuts, one item per case
RAGGED = {
    "inflation": {"offset": ["grid_in", "grid_out"]},
    "mapgrid": {"plan_offset": ["plan"]},
    "navfn": {"offset": ["cost"], "path_offset": ["path"], "pot_offset": ["pot"]},
    "scoring": {"plan_offset": ["plan"], "cand_offset": ["cand_v", "cand_w", "cand_cost", "cand_npts"]},
}
# index array -> the arrays it points into
POINTERS = {
    "mapgrid": {"map_index": ["costmap"]},
    "scoring": {"map_index": ["costmap"]},
    "sequence": {"cost_index": ["costmap"], "plan_index": ["plan"]},
    "controller": {"cost_index": ["costmap"], "set_plan": ["plan"]},
}
SHARED = {"param_names", "footprint", "plan", "plan_offset", "costmap"}  # not one item per case
SHARED_OF = {"footprint": {"costmap", "origin", "footprint"}}
LARGEST_NAVFN = 200 * 200  # cells; larger fields would not fit


def pick_ragged(values: np.ndarray, offsets: np.ndarray, items: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The chosen items of a ragged array, and their new offsets."""
    parts = [values[offsets[k] : offsets[k + 1]] for k in items]
    return np.concatenate(parts), np.concatenate([[0], np.cumsum([len(p) for p in parts])]).astype(offsets.dtype)


def subset(name: str, data: Arrays) -> Arrays:
    """The reduced file."""
    count = len(data["points_offset"]) // data["pose"].shape[1] if name == "obstacle" else len(data[_first(name)])
    candidates = np.arange(count)
    if name == "navfn":
        candidates = candidates[data["shape"].prod(axis=1) <= LARGEST_NAVFN]
    chosen = candidates[np.linspace(0, len(candidates) - 1, CASES[name]).astype(int)]
    small: Arrays = {}
    if name == "obstacle":
        steps = data["pose"].shape[1]
        items = (chosen[:, None] * steps + np.arange(steps)).ravel()
        small["points"], small["points_offset"] = pick_ragged(data["points"], data["points_offset"], items)
    for offsets, arrays in RAGGED.get(name, {}).items():
        for array in arrays:
            small[array], small[offsets] = pick_ragged(data[array], data[offsets], chosen)
    shared = SHARED_OF.get(name, SHARED)
    for array in data:
        if array not in small:
            small[array] = data[array] if array in shared or len(data[array]) != count else data[array][chosen]
    for pointer, arrays in POINTERS.get(name, {}).items():
        used = np.unique(small[pointer][small[pointer] >= 0])
        index = np.searchsorted(used, np.maximum(small[pointer], 0))
        small[pointer] = np.where(small[pointer] >= 0, index, -1).astype(small[pointer].dtype)
        for array in arrays:
            if f"{array}_offset" in data:
                small[array], small[f"{array}_offset"] = pick_ragged(data[array], data[f"{array}_offset"], used)
            else:
                small[array] = data[array][used]
    return small


def _first(name: str) -> str:
    return {"footprint": "cost", "inflation": "shape", "navfn": "shape"}.get(name, "pose")


def main(folder: Path) -> None:
    """Write every file and say how large it became."""
    HERE.mkdir(parents=True, exist_ok=True)
    for name in CASES:
        with np.load(folder / f"{name}.npz", allow_pickle=False) as data:
            small = subset(name, dict(data))
        np.savez_compressed(HERE / f"{name}.npz", **small)
        print(f"{name}: {(HERE / f'{name}.npz').stat().st_size} bytes")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
