"""What an export consists of: commented YAML files, written into a new folder all at once or not at all."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from learning.policy import Policy
from scenarios.errors import UserError, blame
from twin.planner.params import INTEGERS, PlannerParams
from twin.records import DEFAULT_CONTEXT


@dataclass(frozen=True, slots=True)
class YamlFile:
    """One file: its path in the folder, what a reader must know, and the values."""

    path: str  # relative, with forward slashes
    comment: str  # lines, without the "#"
    values: dict[str, Any]

    @property
    def text(self) -> str:
        """The file's contents; numbers as Python writes them, so that they read back exactly."""
        lines = [f"# {line}".rstrip() for line in self.comment.splitlines()]
        return "\n".join([*lines, "", yaml.safe_dump(self.values, sort_keys=False, allow_unicode=True, width=110)])


@dataclass(frozen=True, slots=True)
class Export:
    """The files of one format, and what they are for."""

    shared: dict[str, YamlFile]  # role -> file, what holds whichever context is in force
    contexts: dict[str, dict[str, YamlFile]]  # context label -> role -> file

    @property
    def files(self) -> tuple[YamlFile, ...]:
        """All of them."""
        return (*self.shared.values(), *(file for roles in self.contexts.values() for file in roles.values()))


@dataclass(frozen=True, slots=True)
class NamedContext:
    """A context of the policy with a name that is safe in paths and in parameter names."""

    name: str  # letters, digits and underscores
    label: str
    theta: PlannerParams

    @property
    def values(self) -> dict[str, float]:
        """theta with every number of the type that ROS insists on: counts whole, everything else not."""
        return {name: int(v) if name in INTEGERS else float(v) for name, v in self.theta.as_dict().items()}


def named_contexts(policy: Policy) -> tuple[NamedContext, ...]:
    """The default context, then the learned ones in the policy's order; the number keeps equal-looking labels apart."""
    return tuple(
        NamedContext(f"context{number}_{re.sub(r'[^A-Za-z0-9_]', '_', label)}", label, policy.theta(label))
        for number, label in enumerate((DEFAULT_CONTEXT, *policy.labels))
    )


def free_folder(out: Path) -> Path:
    """Where the folder will really be; UserError when something is there already."""
    with blame(f"cannot use the folder {out}"):
        target = out.resolve()
        if target.exists() and not target.is_dir():
            raise UserError(f"{out} is a file; give --out a folder that does not exist yet")
        if target.is_dir() and any(target.iterdir()):
            raise UserError(f"the folder {out} is not empty; give --out another one, or first: rm -r {out}")
        if target == Path.cwd():
            raise UserError(f"give --out a folder that does not exist yet, such as {out / 'export'}")
    return target


def write_folder(files: Sequence[YamlFile], out: Path) -> None:
    """Write all files beside `out` and rename. Raises UserError; then nothing is left behind."""
    target = free_folder(out)
    with blame(f"cannot write the folder {out}"):
        target.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}.", suffix=".part"))
        try:
            for file in files:
                path = part / file.path
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(file.text, encoding="utf-8")
            mask = os.umask(0)  # mkdtemp makes private folders; an export is an ordinary one
            os.umask(mask)
            part.chmod(0o777 & ~mask)
            part.rename(target)
        except BaseException:
            shutil.rmtree(part, ignore_errors=True)
            raise
