"""An intervention while a person is still at it, and the numbers in the names of those that are done."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

from learning.interventions import Intervention, Kind, Metadata, Step
from twin.simulation import TICK

TAPE = 60.0  # [s] that can be wound back
LONGEST = 40.0  # [s] of one intervention; its maps take 14 MB per second until they are packed


@dataclass
class Taught:
    """An intervention in progress."""

    kind: Kind
    noticed: int  # the tick at which the person saw the trouble: here the rewind, if any, began
    state: str  # what the driver was doing then
    steps: dict[int, Step] = field(default_factory=dict)  # by tick

    @property
    def seconds(self) -> float:
        """[s] recorded so far."""
        return len(self.steps) * TICK

    def wind_back(self, index: int) -> None:
        """Forget the steps from tick `index` on."""
        self.steps = {k: step for k, step in self.steps.items() if k < index}

    def finished(self, label: str, world_name: str, seed: int) -> Intervention:
        """I_i. A person winds back to where the trouble began, so its first step is when and where that was."""
        first = min(self.steps)
        began = self.steps[first].observation
        metadata = Metadata(
            world=world_name,
            seed=seed,
            source="teleop",
            trigger=f"a person at the keyboard; the driver was {self.state}",
            trouble_time=None if self.kind == "D" else began.time,
            trouble_pose=None if self.kind == "D" else began.pose,
            rewound=max(0, self.noticed - first) * TICK,
            versions={name: version(name) for name in ("appli-twin", "mujoco", "numpy")},
        )
        return Intervention(self.kind, label, [self.steps[k] for k in sorted(self.steps)], metadata)


def highest_numbers(folder: Path) -> dict[Kind, int]:
    """The highest label number of each kind among the files of a folder."""
    numbers: dict[Kind, int] = {"A": 0, "B": 0, "D": 0}
    for path in folder.glob("*.npz"):
        for kind in numbers:
            if match := re.match(rf"{kind}(\d{{1,4}})-", path.name):
                numbers[kind] = max(numbers[kind], int(match[1]))
    return numbers
