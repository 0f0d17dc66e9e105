"""How far a reimplementation agrees with recordings of the original."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Agreement:
    """The outcome of one golden file: every case is either equal or named with what differs."""

    name: str
    cases: int
    differing: list[str]

    @property
    def complete(self) -> bool:
        """Whether every case agrees."""
        return not self.differing

    def __str__(self) -> str:
        return f"{self.name}: {self.cases - len(self.differing)} of {self.cases} cases equal"
