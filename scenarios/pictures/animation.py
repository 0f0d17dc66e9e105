"""APPLI drives `training`: the course with the path coloured by context, the robot from behind, what is in force."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from scenarios.pictures.ink import (
    DARK,
    PALE,
    RGB,
    Stripe,
    colour_of,
    font,
    label,
    painted,
    path_of,
    stripes_by_context,
)
from scenarios.pictures.stage import Stage, View
from scenarios.pictures.views import whole
from scenarios.trials import TrialSpec, run_trial
from scenarios.worlds import load_world
from twin.records import DEFAULT_CONTEXT, Outcome, Tick
from twin.robot.jackal import WHEEL_RADIUS

WORLD = "training"
SEEDS = 10  # at most: the first drive that arrives is shown
SIZE = (800, 560)  # [px]
COURSE, BEHIND = (800, 328), (420, 232)  # [px] above; below on the left
FASTER, FRAMES = 4.0, 10.0  # times real time; [1/s]
TICKS = round(FASTER / FRAMES / 0.05)  # per frame
HOLD = 2000  # [ms] of the last frame
LIMIT = 4_900_000  # [bytes]
QUALITIES = (72, 60, 48, 36, 24)  # of WebP: the best that fits
SHADE: RGB = (205, 208, 212)
GOAL: RGB = (38, 130, 70)
AHEAD = 0.2  # [m] of the robot is what the camera behind it looks at


def animation(policy: Path) -> bytes:
    """A WebP that plays for ever."""
    frames = film(drive(policy))
    for quality in QUALITIES:
        data = io.BytesIO()
        times = [round(1000 / FRAMES)] * (len(frames) - 1) + [HOLD]
        frames[0].save(
            data, "WEBP", save_all=True, append_images=frames[1:], duration=times, loop=0, quality=quality, method=4
        )
        if data.tell() <= LIMIT:
            return data.getvalue()
    raise RuntimeError(f"the animation takes more than {LIMIT} bytes; drive something shorter")


def drive(policy: Path) -> list[Tick]:
    """The first drive that arrives; the last of all that were tried if none does."""
    world = load_world(WORLD)
    for seed in range(SEEDS):
        ticks: list[Tick] = []
        result = run_trial(TrialSpec(WORLD, driver=str(policy), seed=seed), world, ticks.append)
        if result.outcome is Outcome.REACHED:
            break
    return ticks


def film(ticks: Sequence[Tick]) -> list[Image.Image]:
    """One picture for every TICKS ticks."""
    world = load_world(WORLD)
    view, points, contexts = whole(world, COURSE), path_of(ticks), [t.decision.context for t in ticks]
    shown = [*range(0, len(ticks) - 1, TICKS), len(ticks) - 1]
    frames, yaw = [], ticks[0].true_pose.yaw
    turn = np.linspace(0.0, math.tau, 60)
    near = world.rules.goal_tolerance  # [m]
    circle = np.column_stack([world.goal.x + near * np.cos(turn), world.goal.y + near * np.sin(turn)])
    with Stage(world, COURSE, 24.0, fine=4096) as above, Stage(world, BEHIND, 5.0, fine=2048) as behind:
        above.hide_goal()
        behind.hide_goal()
        for k in shown:
            pose = ticks[k].true_pose
            yaw += 0.5 * math.remainder(pose.yaw - yaw, math.tau)  # the camera swings after the robot
            for stage in (above, behind):
                stage.place(pose, [_rolled(points[: k + 1])] * 4)
            close = View(
                (pose.x + AHEAD * math.cos(yaw), pose.y + AHEAD * math.sin(yaw), 0.1), math.degrees(yaw), -48.0, 2.3
            )
            stripes = [Stripe(circle, GOAL), *stripes_by_context(points[: k + 1], contexts[: k + 1])]
            image = Image.new("RGB", SIZE, PALE)
            image.paste(_seen(above, view, stripes, 3.5), (0, 0))
            image.paste(_seen(behind, close, stripes, 6.0), (0, COURSE[1]))
            _panel(image, ticks[k])
            frames.append(image)
    return frames


def _seen(stage: Stage, view: View, stripes: list[Stripe], width: float) -> Image.Image:
    return painted(stage.picture(view), stage.floor(view), view, [replace(s, width=width) for s in stripes])


def _rolled(points: np.ndarray) -> float:  # type: ignore[type-arg]
    """[rad] that the wheels have turned along a path."""
    return float(np.hypot(*np.diff(points, axis=0).T).sum() / WHEEL_RADIUS) if len(points) > 1 else 0.0


def _panel(image: Image.Image, tick: Tick) -> None:
    """Context, confidence and what the planner is told, right of the robot."""
    draw, left, top = ImageDraw.Draw(image), BEHIND[0] + 22, COURSE[1] + 18
    decision, colour = tick.decision, colour_of(tick.decision.context)
    name = "default parameters" if decision.context == DEFAULT_CONTEXT else f"context {decision.context}"
    width = draw.textlength(name, font=font(24))
    label(image, (left + width / 2 + 11, top + 20), name, colour, 24)
    _bar(
        draw,
        (left, top + 58),
        "confidence",
        decision.confidence or 0.0,
        1.0,
        f"{decision.confidence or 0.0:.2f}",
        colour,
    )
    theta = decision.theta
    _bar(
        draw, (left, top + 88), "speed", abs(tick.observation.twist.v), 2.0, f"{tick.observation.twist.v:.2f} m/s", DARK
    )
    rows = (
        ("max_vel_x", theta.max_vel_x, 2.0),
        ("occdist_scale", theta.occdist_scale, 1.0),
        ("inflation", theta.inflation_radius, 0.5),
    )
    for k, (text, value, largest) in enumerate(rows):
        _bar(draw, (left, top + 118 + 26 * k), text, value, largest, f"{value:.2f}", colour)
    clock = f"{tick.elapsed:.0f} s, shown {FASTER:.0f} x faster"
    draw.text((SIZE[0] - 14, SIZE[1] - 9), clock, font=font(13), fill=(110, 114, 122), anchor="rs")


def _bar(
    draw: ImageDraw.ImageDraw, at: tuple[float, float], text: str, value: float, largest: float, says: str, colour: RGB
) -> None:
    x, y = at
    draw.text((x, y), text, font=font(15), fill=DARK, anchor="lm")
    start, length = x + 112, 140
    draw.rounded_rectangle([start, y - 6, start + length, y + 6], radius=4, fill=SHADE)
    filled = length * min(1.0, value / largest)
    if filled >= 3:
        draw.rounded_rectangle([start, y - 6, start + filled, y + 6], radius=min(4, filled / 2), fill=colour)
    draw.text((start + length + 10, y), says, font=font(15), fill=DARK, anchor="lm")
