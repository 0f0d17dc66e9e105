"""One intervention of type A and one of type B on `training`: how the default drove, and what was shown instead."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw

from scenarios.collect import Collected, Session
from scenarios.pictures.ink import DARK, PALE, RGB, Stripe, colour_of, dot, font, label, painted, path_of, thinned
from scenarios.pictures.stage import Stage, View
from scenarios.pictures.views import on_floor
from scenarios.trials import TrialSpec, run_trial
from scenarios.worlds import load_world
from twin.records import Array, Tick
from twin.world import World

WORLD = "training"
SEEDS = 10  # at most: the first drive in which both types occur is shown
SIZE = (640, 600)  # [px] of one of the two
GAP = 10  # [px]
ROOM = 0.9  # [m] round the demonstration
TROUBLE: RGB = (170, 30, 40)
CAPTION = 34  # [px]


def intervention() -> Image.Image:
    """Both side by side."""
    world = load_world(WORLD)
    seed, chosen = _both_types(world)
    default: list[Tick] = []
    run_trial(TrialSpec(WORLD, seed=seed), world, default.append)
    parts = [_one(world, default, chosen[kind]) for kind in ("A", "B")]
    image = Image.new("RGB", (2 * SIZE[0] + GAP, SIZE[1]), "white")
    for k, part in enumerate(parts):
        image.paste(part, (k * (SIZE[0] + GAP), 0))
    return image


def _both_types(world: World) -> tuple[int, dict[str, Collected]]:
    for seed in range(SEEDS):
        kept: list[Collected] = []
        Session(TrialSpec(WORLD, seed=seed), world).run(kept.append)
        first: dict[str, Collected] = {}
        for one in kept:
            first.setdefault(one.intervention.kind, one)
        if {"A", "B"} <= set(first):
            return seed, first
    raise RuntimeError(f"no drive on {WORLD} with interventions of type A and B; try more SEEDS")


def _one(world: World, default: list[Tick], shown: Collected) -> Image.Image:
    made = shown.intervention
    noticed = shown.ticks[0].observation.time + made.metadata.rewound
    before = path_of(t for t in default if t.observation.time <= noticed)
    drive, colour = path_of(shown.ticks), colour_of(made.label)
    view = _close(drive, before[-60:])
    with Stage(world, SIZE, shadows=14.0) as stage:
        stage.place(shown.ticks[-1].true_pose)
        image, floor = stage.picture(view), stage.floor(view)
    image = painted(image, floor, view, [Stripe(thinned(before), DARK, 4), Stripe(thinned(drive), colour, 7)])

    def mark(x: float, y: float, text: str, colour: RGB, shift: tuple[float, float]) -> None:
        at = view.pixels(on_floor([(x, y)]), SIZE)[0]
        dot(image, at, colour)
        label(image, at + np.array(shift), text, colour, 17)

    if (trouble := made.metadata.trouble_pose) is not None:  # in odom, which begins at the start, parallel to the world
        mark(trouble.x + world.start.x, trouble.y + world.start.y, "trouble begins", TROUBLE, (0, -28))
    mark(drive[0, 0], drive[0, 1], "wound back to here", colour, (0, 28))
    at = view.pixels(on_floor([drive[-1]]), SIZE)[0]
    label(image, at + np.array([0.0, 52.0]), "handed back", colour, 17)
    image.paste(PALE, (0, 0, SIZE[0], CAPTION))
    text = f"Type {made.kind} ({made.label}): the default {made.metadata.trigger}"
    ImageDraw.Draw(image).text((10, CAPTION / 2), text, font=font(18), fill=DARK, anchor="lm")
    return image


def _close(drive: Array, before: Array) -> View:
    points = np.concatenate([drive, before])
    low, high = points.min(axis=0) - ROOM, points.max(axis=0) + ROOM
    middle, extent = (low + high) / 2, high - low
    height = max(float(extent[1]), float(extent[0]) * SIZE[1] / SIZE[0])
    return View((float(middle[0]), float(middle[1]), 0.2), 90.0, -68.0, height=height)
