"""What a sweep has to do: worlds x methods x runs as jobs, in an order that keeps an unfinished sweep balanced."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from learning.policy import PolicyError
from learning.policy_file import MAX_BYTES, parse_policy
from scenarios.barn_files import archive_indices
from scenarios.barn_generator import COUNT
from scenarios.errors import UserError, blame
from scenarios.identity import policy_digest, trial_key, world_digest
from scenarios.store import StoredTrial
from scenarios.worlds import WorldError, load_world
from twin.world import World

PLAIN = "dwa"  # the method without a policy


@dataclass(frozen=True, slots=True)
class Job:
    """One trial to be done. Small: world and policy are named by their digests and travel once (scenarios.job)."""

    key: str
    world: str
    world_digest: str
    protocol: str
    method: str
    policy: str  # digest; "" for dwa
    code: str  # digest
    seed: int
    run: int


@dataclass(frozen=True, slots=True)
class Agenda:
    """The jobs of a sweep in their order, and what they need."""

    jobs: tuple[Job, ...]
    worlds: Mapping[str, World]  # by digest
    policies: Mapping[str, bytes]  # by digest


def make_agenda(
    worlds: Sequence[World], methods: Mapping[str, bytes | None], runs: int, seed: int, code: str
) -> Agenda:
    """All jobs: first run 0 of every world and method, then run 1, and so on. Raises UserError for ambiguous names."""
    by_digest = {world_digest(world): world for world in worlds}
    names: dict[tuple[str, str], str] = {}
    for digest, world in by_digest.items():
        if names.setdefault((world.name, world.rules.protocol), digest) != digest:
            raise UserError(f"--worlds holds two different worlds called {world.name}; sweep them into two files")
    policies = {policy_digest(data): data for data in methods.values() if data is not None}
    digests = {name: policy_digest(data) for name, data in methods.items()}
    for name, digest in digests.items():
        twins = [other for other in digests if digests[other] == digest and other != name]
        if twins:
            raise UserError(f"the policies {name} and {twins[0]} are the same file; leave one of them out")
    jobs = [
        Job(
            key=trial_key(at, digests[method], code, seed, run),
            world=world.name,
            world_digest=at,
            protocol=world.rules.protocol,
            method=method,
            policy=digests[method],
            code=code,
            seed=seed,
            run=run,
        )
        for run, (at, world), method in product(range(runs), by_digest.items(), methods)
    ]
    return Agenda(tuple(jobs), by_digest, policies)


# --- worlds ----------------------------------------------------------------------------------------------------------


def read_worlds(text: str, protocol: str) -> list[World]:
    """The worlds of --worlds. Raises UserError."""
    with blame():
        names = [name for item in _items(text, "--worlds") for name in expand(item)]
        return [load_world(name, protocol) for name in dict.fromkeys(names)]


def expand(item: str) -> list[str]:
    """One entry of --worlds to names that `appli run` knows. Raises WorldError.

    barn-like is all of the generated worlds, barn-like/0-99 some; FILE.npz is all worlds of an archive, FILE.npz#0-99
    those of them with such an index; a folder is its *.world files.
    """
    if Path(item).is_dir():
        if names := sorted(map(str, Path(item).glob("*.world"))):
            return names
        raise WorldError(f"{item} is a folder without *.world files; name files of another kind themselves")
    if item == "barn-like":
        return [f"barn-like/{k}" for k in range(COUNT)]
    if match := re.fullmatch(r"barn-like/(\d{1,6})(?:-|\.\.)(\d{1,6})", item):
        first, last = _range(item, *match.groups())
        return [f"barn-like/{k}" for k in range(first, min(last, COUNT) + 1)]
    if match := re.fullmatch(r"(.+\.npz)(?:#(\d{1,6})(?:-|\.\.)(\d{1,6}))?", item, re.IGNORECASE):
        name, *ends = match.groups()
        first, last = (0, 10**6) if ends[0] is None else _range(item, *ends)
        if not Path(name).is_file():
            raise WorldError(f"{name} does not exist; check the path")
        names = [f"{name}#{k}" for k in archive_indices(Path(name)) if first <= k <= last]
        if not names:
            raise WorldError(f"{item}: no world of {name} has such an index")
        return names
    return [item]


def _range(item: str, first: str, last: str) -> tuple[int, int]:
    if int(first) > int(last):
        raise WorldError(f"{item}: write the smaller number first")
    return int(first), int(last)


def _items(text: str, option: str) -> list[str]:
    items = [item.strip() for item in text.split(",")]
    if not all(items):
        raise UserError(f"{option} takes names with commas between and no blank ones, not {text!r}")
    return items


# --- methods ---------------------------------------------------------------------------------------------------------


def read_methods(text: str, folder: Path | None) -> dict[str, bytes | None]:
    """The methods of --methods: name to the bytes of its policy file, None for dwa. Raises UserError."""
    methods: dict[str, bytes | None] = {}
    for name in _items(text, "--methods"):
        methods[name] = None if name == PLAIN else _policy_bytes(name, folder)
    return methods


def _policy_bytes(name: str, folder: Path | None) -> bytes:
    """A policy file that can be driven."""
    if folder is None:
        raise UserError(
            f"the method {name} needs --policies DIR, a folder with {name}.safetensors; see: appli train --help"
        )
    if Path(name).name != name:
        raise UserError(f"a method is the name of a policy in {folder}, not a path such as {name}")
    path = folder / f"{name}.safetensors"
    if not path.is_file() or not path.resolve().is_relative_to(folder.resolve()):
        there = sorted(p.stem for p in folder.glob("*.safetensors")) if folder.is_dir() else []
        raise UserError(f"no policy {path}; {folder} has {', '.join(there) or 'none'} (make them with: appli train)")
    with blame():
        if path.stat().st_size > MAX_BYTES:
            raise UserError(f"{path}: not a policy: larger than {MAX_BYTES // 2**20} MiB")
        data = path.read_bytes()
    try:
        parse_policy(data)
    except PolicyError as error:
        raise UserError(f"{path}: {error}") from error
    return data


# --- what the store has already --------------------------------------------------------------------------------------


def missing(jobs: Iterable[Job], done: set[str]) -> list[Job]:
    """The jobs that are not done, in order."""
    return [job for job in jobs if job.key not in done]


def check_names(agenda: Agenda, rows: Iterable[StoredTrial]) -> None:
    """A policy keeps its name within a store: the same trials under another would not be found. Raises UserError."""
    ours = {job.key: job.method for job in agenda.jobs}
    for row in rows:
        if ours.get(row.key, row.method) != row.method:
            raise UserError(
                f"the policy {ours[row.key]} is in this file as {row.method}; keep to that name, or give another --out"
            )


def other_versions(agenda: Agenda, rows: Iterable[StoredTrial]) -> list[str]:
    """One line per kind of row that the store holds for the same methods and worlds, but made differently."""
    ours = {(job.world, job.protocol, job.method): job for job in agenda.jobs}
    counts = dict.fromkeys(("code", "policy", "world"), 0)
    for row in rows:
        job = ours.get((row.world, row.protocol, row.method))
        if job is None:
            continue
        counts["code"] += row.code != job.code
        counts["policy"] += row.code == job.code and row.policy != job.policy
        counts["world"] += (row.code, row.policy) == (job.code, job.policy) and row.world_digest != job.world_digest
    what = {"code": "by other code or packages", "policy": "with other policies", "world": "in worlds since changed"}
    return [
        f"{count} stored trials of these methods and worlds were made {what[kind]}; they stay apart"
        for kind, count in counts.items()
        if count
    ]
