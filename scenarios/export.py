"""`appli export`: a policy as YAML files for a real robot, with a table of contents."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from learning.policy import Policy
from learning.policy_file import ROBOT, load_policy
from scenarios.errors import blame
from scenarios.export_files import Export, YamlFile, named_contexts, write_folder
from scenarios.export_move_base import move_base_export
from scenarios.export_nav2 import nav2_export

Format = Literal["move_base", "nav2"]

FORMATS: dict[Format, Callable[[Policy], Export]] = {"move_base": move_base_export, "nav2": nav2_export}
MANIFEST = "contexts.yaml"
SCHEMA = 1  # of the manifest

MANIFEST_COMMENT = """\
What is in this folder, and how the policy used it. Written by appli-twin {version}; see docs/real_robot.md, "Export".
These files hold parameters only. Which context is in force is decided, once per control cycle, from the scan: by the
classifier in the policy file, below eps_u of confidence the default context, then the most frequent of the last
`window` decisions (steps of a 20 Hz loop)."""


def export_command(path: Path, format: Format, out: Path) -> int:
    """Read the policy, write the folder, say what to read first. Exit code 0."""
    with blame():
        policy = load_policy(path)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
    export = FORMATS[format](policy)
    manifest = YamlFile(
        MANIFEST,
        MANIFEST_COMMENT.format(version=version("appli-twin")),
        _manifest(policy, export, format, path, digest),
    )
    write_folder((manifest, *export.files), out)
    print(f"{len(export.contexts)} contexts ({', '.join(export.contexts)}) as {format} parameters in {out}")
    print(f"read first: {out / MANIFEST}")
    return 0


def _manifest(policy: Policy, export: Export, format: Format, path: Path, digest: str) -> dict[str, Any]:
    origin = policy.provenance
    contexts = []
    for context in named_contexts(policy):
        entry: dict[str, Any] = {
            "label": context.label,
            "files": {role: file.path for role, file in export.contexts[context.label].items()},
            "theta": context.values,
            "interventions": [d for d, label in origin.interventions.items() if label == context.label],
        }
        if context.label in origin.losses:
            entry["loss"] = dict(zip(("default", "theta"), origin.losses[context.label], strict=True))
        contexts.append(entry)
    return {
        "schema": SCHEMA,
        "format": format,
        "robot": ROBOT,
        "policy": {"file": path.name, "sha256": digest},
        "eps_u": policy.eps_u,
        "window": policy.window,
        "use_confidence": policy.use_confidence,
        "switches": asdict(policy.switches),
        "files": {role: file.path for role, file in export.shared.items()},
        "contexts": contexts,
        "provenance": {
            "types": origin.types,
            "seed": origin.seed,
            "interventions": dict(origin.interventions),
            "figures": dict(origin.figures),
            "versions": dict(origin.versions),
        },
    }
