"""What `appli collect --bag` takes, as one flat record for the command line."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import UseAppendAction

from scenarios.errors import UserError


@dataclass(frozen=True, slots=True)
class BagOptions:
    """Topics that are not named are found by their usual names and types (docs/real_robot.md)."""

    bag: Path | None = None
    """Take the interventions out of a recorded drive instead: a ROS 1 .bag, the folder of a ROS 2 bag, an .mcap."""
    type: Literal["A", "B", "D"] | None = None
    """Type of the interventions that do not say it themselves."""
    label: str | None = None
    """Label of these interventions, e.g. A1; otherwise they are numbered."""
    scan: str | None = None
    """Topic of the lidar."""
    odom: str | None = None
    """Topic of the odometry."""
    cmd_vel: str | None = None
    """Topic of the commands that the person gave."""
    goal: str | None = None
    """Topic of the goal: poses, or paths, whose last pose is then the goal."""
    marker: str | None = None
    """Topic that says when an intervention lasts: a String such as A1 (otherwise empty), or a Bool."""
    range: Annotated[tuple[str, ...], UseAppendAction] = ()
    """START:END[:TYPE] in seconds since the bag's start, e.g. 12.5:20:A; may come several times."""

    def refuse_without_bag(self) -> None:
        """These options mean nothing without a bag."""
        given = [f.name for f in fields(self) if getattr(self, f.name) not in (None, ())]
        if self.bag is None and given:
            raise UserError(f"--{given[0].replace('_', '-')} is for recorded drives; add --bag FILE")
