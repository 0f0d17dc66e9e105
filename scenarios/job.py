"""One job of a sweep, done in whatever process it lands: a fresh trial, and its facts as a row."""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from functools import lru_cache

from learning.deploy import AppliDriver
from learning.policy_file import parse_policy
from scenarios.agenda import PLAIN, Job
from scenarios.identity import code_digest
from scenarios.store import CONFIDENCE_BINS, StoredTrial
from scenarios.switches import Switches
from scenarios.trials import TrialSpec, make_driver, move_base_settings, run_trial
from scenarios.warm_up import warm_up
from twin.planner.move_base import MoveBase
from twin.records import Tick
from twin.rollout import Driver
from twin.world import World

MAX_ERROR = 20_000  # characters of a traceback that are kept

# What has been brought to this process, by digest; set once, before its first job (`equip`).
_worlds: dict[str, World] = {}
_policies: dict[str, bytes] = {}


class OtherCodeError(Exception):
    """This process runs other code than the one that made the agenda."""


def equip(worlds: Mapping[str, World], policies: Mapping[str, bytes]) -> None:
    """Give this process what its jobs will name."""
    _worlds.update(worlds)
    _policies.update(policies)


def do(job: Job) -> StoredTrial:
    """The trial, done or failed. Raises OtherCodeError: rows of other code must not carry this job's digest."""
    if code_digest() != job.code:
        raise OtherCodeError
    try:
        _prepare()
        began = time.perf_counter()
        return _done(job, began)
    except Exception:
        return failed(job, traceback.format_exc())


@lru_cache(maxsize=1)
def _prepare() -> None:
    """Once per process, so that the first trial's wall time is that of the trial."""
    warm_up()


def _done(job: Job, began: float) -> StoredTrial:
    confidence = [0] * CONFIDENCE_BINS
    judged = 0

    def watch(tick: Tick) -> None:
        nonlocal judged
        if (u := tick.decision.confidence) is not None:
            judged += 1
            confidence[min(int(u * CONFIDENCE_BINS), CONFIDENCE_BINS - 1)] += 1

    spec = TrialSpec(job.world, job.protocol, seed=job.seed, run=job.run)
    result = run_trial(spec, _worlds[job.world_digest], watch, driver=_driver(job, spec))
    return StoredTrial(
        **asdict(job),
        status="done",
        outcome=result.outcome.value,
        time=result.time,
        distance=result.distance,
        recoveries=result.recoveries,
        min_clearance=result.min_clearance if math.isfinite(result.min_clearance) else None,
        contexts=result.contexts,
        confidence=tuple(confidence) if judged else None,
        ticks=result.ticks,
        digest=result.digest,
        wall=round(time.perf_counter() - began, 3),
        finished=_now(),
    )


def _driver(job: Job, spec: TrialSpec) -> Driver:
    if job.method == PLAIN:
        return make_driver(spec)
    return AppliDriver(parse_policy(_policies[job.policy]), MoveBase(move_base_settings(Switches())))


def failed(job: Job, error: str) -> StoredTrial:
    """The row of a trial that could not be done."""
    return StoredTrial(**asdict(job), status="error", error=error[-MAX_ERROR:], finished=_now())


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
