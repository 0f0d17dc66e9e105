"""Where is a policy's classifier sure of itself? `python examples/confidence.py results/policies/A+B+c.safetensors 5`

Drives training and unseen with the policy and sorts the scans by the place they were taken in: in a place named after
one of the policy's contexts it should be right and confident, elsewhere it should not be confident.
"""

from collections import defaultdict
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from learning.intervener import segment_at
from learning.policy_file import load_policy
from scenarios.errors import one_line_errors
from scenarios.trials import TrialSpec, run_trial
from scenarios.worlds import load_world
from twin.records import Tick


def main(
    path: Annotated[str, tyro.conf.Positional] = "results/policies/A+B+c.safetensors",
    seeds: Annotated[int, tyro.conf.Positional] = 1,  # drives of each course
) -> None:
    """Print a line per place."""
    policy = load_policy(Path(path))
    if policy.classifier is None or seeds < 1:
        raise ValueError("give a policy of two or more contexts, and 1 or more drives")
    judge = policy.classifier.judge
    print("world      place   steps  confidence  confident  the confident ones are judged as")
    for name in ("training", "unseen"):
        world = load_world(name)
        seen: dict[str, list[tuple[str, float]]] = defaultdict(list)

        def watch(tick: Tick, world=world, seen=seen) -> None:  # type: ignore[no-untyped-def]
            place = segment_at(world, tick.true_pose)
            answer = judge(tick.observation.scan.ranges)
            if place is not None and answer is not None:
                seen[place.name].append((answer.label, answer.confidence))

        for seed in range(seeds):
            run_trial(TrialSpec(name, driver=path, seed=seed), world, watch)
        for place, answers in sorted(seen.items()):
            certain = np.array([u for _, u in answers])
            sure = [label for label, u in answers if u >= policy.eps_u]
            shares = ", ".join(f"{label} {sure.count(label) / len(sure):.2f}" for label in sorted(set(sure)))
            share = len(sure) / len(answers)
            print(f"{name:10s} {place:6s} {len(answers):6d} {certain.mean():11.2f} {share:10.2f}  {shares}")


if __name__ == "__main__":
    with one_line_errors():
        tyro.cli(main)
