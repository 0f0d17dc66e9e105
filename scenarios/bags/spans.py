"""Which parts of a bag are interventions: time ranges from the command line, or a marker topic that says so."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import cast

from learning.interventions import Kind
from scenarios.bags.files import BagError, BagReader
from scenarios.errors import UserError
from scenarios.teaching import LONGEST


@dataclass(frozen=True, slots=True)
class Span:
    """One intervention to be: from `start` to before `end` [s since the bag's first message]."""

    start: float
    end: float
    kind: Kind
    label: str | None  # None: numbered when it is written
    said_by: str  # for messages: how the user or the bag put it


def kind_and_label(text: str) -> tuple[Kind, str | None] | None:
    """ "A" or "A1" taken apart; None for anything else."""
    match = re.fullmatch(r"([ABD])(\d{1,4})?", text)
    return None if match is None else (cast(Kind, match[1]), text if match[2] else None)


def default_type(kind: str | None, label: str | None) -> tuple[Kind, str | None] | None:
    """What --type and --label say together."""
    said = None if label is None else kind_and_label(label)
    if label is not None and (said is None or said[1] is None):
        raise UserError(f"--label takes a type and a number, such as A1, not {label!r}")
    if kind is not None and (kind_and_label(kind) is None or len(kind) != 1):
        raise UserError(f"--type takes A, B or D, not {kind!r}")
    if said is not None and kind not in (None, said[0]):
        raise UserError(f"--type {kind} and --label {label} contradict each other")
    return said if said is not None else kind_and_label(kind or "")


def parse_range(text: str, default: tuple[Kind, str | None] | None) -> Span:
    """START:END[:TYPE], e.g. 12.5:20:A or 12.5:20:A1."""
    parts = text.split(":")
    try:
        start, end = (float(part) for part in parts[:2])
    except ValueError:
        start = end = math.nan
    said = kind_and_label(parts[2]) if len(parts) == 3 else default
    if len(parts) not in (2, 3) or not (0.0 <= start < end < math.inf) or (len(parts) == 3 and said is None):
        raise UserError(
            f"--range takes START:END[:TYPE] in seconds since the bag's start, e.g. 12.5:20:A, not {text!r}"
        )
    if said is None:
        raise UserError(f"--range {text} does not say of which type it is; try: --range {text}:A, or add --type A")
    return checked(Span(start, end, *said, said_by=f"--range {text}"))


def marked_spans(bag: BagReader, topic: str, default: tuple[Kind, str | None] | None) -> list[Span]:
    """A String names the type or label while an intervention lasts and is empty otherwise; a Bool is true meanwhile."""
    spans: list[Span] = []
    begun: tuple[float, str] | None = None
    by_bool = bag.topics[topic].endswith("/Bool")
    if by_bool and default is None:
        raise UserError(f"{topic} says when, but not which type the interventions are of; add --type A")
    for _, time, sent in bag.messages([topic]):
        at = bag.seconds(time)
        text = ("true" if sent.data else "") if by_bool else str(sent.data).strip()
        if not by_bool and text and kind_and_label(text) is None:
            raise BagError(
                f"{bag.path}: {topic} says {text[:40]!r} at {at:.2f} s; "
                "it should name a type (A, B, D) or a label (A1), or be empty"
            )
        if begun is not None and text != begun[1]:
            spans.append(_marked(begun, at, topic, default))
            begun = None
        if begun is None and text:
            begun = at, text
    if begun is not None:
        spans.append(_marked(begun, bag.seconds(bag.end), topic, default))
    if not spans:
        raise BagError(f"{bag.path}: no intervention in it: {topic} never says that one lasts")
    return spans


def _marked(begun: tuple[float, str], end: float, topic: str, default: tuple[Kind, str | None] | None) -> Span:
    said = kind_and_label(begun[1]) or default
    assert said is not None  # marked_spans looked
    if said[1] is None and default is not None and default[0] == said[0]:
        said = default
    return checked(Span(begun[0], end, *said, said_by=f"{topic} from {begun[0]:.2f} to {end:.2f} s"))


def checked(span: Span) -> Span:
    """The span, unless it is too long for one intervention."""
    if span.end - span.start > LONGEST:
        raise UserError(
            f"{span.said_by} lasts {span.end - span.start:.0f} s; an intervention lasts at most {LONGEST:.0f} s: "
            "show the part that matters, or give two ranges"
        )
    return span
