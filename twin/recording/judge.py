"""What a recording asks of the context classifier that drives, so that this package need not know it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from twin.records import Scan


@dataclass(frozen=True, slots=True)
class Judge:
    """The classifier behind `Decision.confidence`."""

    labels: tuple[str, ...]  # of the contexts that it tells apart
    threshold: float | None  # confidence below which the default drives; None = it is never asked for
    evidence: Callable[[Scan], Mapping[str, float]]  # label -> evidence >= 0; empty for a scan it cannot judge
