"""What is written on top of a picture: labels, tinted floor, and the colours of the contexts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from PIL import Image, ImageChops, ImageColor, ImageDraw, ImageFont

from scenarios.pictures.stage import View
from scenarios.report.figures.style import context_colours
from twin.records import DEFAULT_CONTEXT, Array, Tick

RGB = tuple[int, int, int]
DARK: RGB = (38, 42, 50)
PALE: RGB = (250, 250, 248)
SPACING = 0.05  # [m] between the points of a stripe
FINE = 3  # drawn pixels per pixel of the picture, along each side
TINT = 0.3  # how much of an area's colour the floor takes


def colour_of(context: str) -> RGB:
    """As in the report's figures; the default, grey there, is dark here to stand out from the floor."""
    if context == DEFAULT_CONTEXT:
        return DARK
    r, g, b = ImageColor.getrgb(context_colours([context])[context])[:3]
    return r, g, b


def font(size: float) -> ImageFont.FreeTypeFont:
    """Pillow's own typeface, so that pictures look the same everywhere."""
    found = ImageFont.load_default(size)
    if not isinstance(found, ImageFont.FreeTypeFont):
        raise RuntimeError("this Pillow cannot draw text of a given size; install it with FreeType")
    return found


def label(image: Image.Image, at: Sequence[float], text: str, colour: RGB, size: float = 22) -> None:
    """A name on a rounded plate of its colour, centred at a pixel but never over the edge."""
    draw = ImageDraw.Draw(image)
    left, top, right, bottom = draw.textbbox((0, 0), text, font=font(size))
    half = np.array([(right - left) / 2 + 0.45 * size, (bottom - top) / 2 + 0.32 * size])
    low = np.minimum(np.maximum(np.asarray(at) - half, 4), np.array(image.size) - 2 * half - 4)
    draw.rounded_rectangle([*low, *(low + 2 * half)], radius=0.35 * size, fill=colour)
    bright = 0.299 * colour[0] + 0.587 * colour[1] + 0.114 * colour[2] > 150
    draw.text(tuple(low + half), text, font=font(size), fill=DARK if bright else PALE, anchor="mm")


def tinted(image: Image.Image, floor: Image.Image, areas: Iterable[tuple[Array, RGB]]) -> Image.Image:
    """The picture with areas of the floor (pixels (n, 2), colour) tinted; shadows and obstacles stay as they are."""
    paint = Image.new("RGB", image.size, "white")
    draw = ImageDraw.Draw(paint)
    for outline, colour in areas:
        r, g, b = (round(255 - TINT * (255 - c)) for c in colour)
        draw.polygon([tuple(p) for p in outline], fill=(r, g, b))
    product = np.asarray(image, np.float32) * np.asarray(paint, np.float32) / 255
    return Image.composite(Image.fromarray(product.astype(np.uint8)), image, floor)


@dataclass(frozen=True, slots=True)
class Stripe:
    """A line painted on the floor."""

    points: Array  # (n, 2) world [m]
    colour: RGB
    width: float = 5.0  # [px]


def painted(image: Image.Image, floor: Image.Image, view: View, stripes: Iterable[Stripe]) -> Image.Image:
    """The picture with stripes on its floor; what stands in front hides them."""
    size = (image.width * FINE, image.height * FINE)
    layer = Image.new("RGBA", size, (0, 0, 0, 0))
    draw = ImageDraw.Draw(layer)
    for stripe in stripes:
        points = view.pixels(np.column_stack([stripe.points, np.zeros(len(stripe.points))]), size)
        width = round(stripe.width * FINE)
        for k, (a, b) in enumerate(pairwise(points)):
            if np.isfinite([a, b]).all() and np.abs([a, b]).max() < 10 * max(size):
                draw.line([*a, *b], fill=(*stripe.colour, 255), width=width)
                for x, y in (a, b) if k == 0 else (b,):
                    r = width / 2
                    draw.ellipse([x - r, y - r, x + r, y + r], fill=(*stripe.colour, 255))
    layer = layer.resize(image.size, Image.Resampling.LANCZOS)
    return Image.composite(layer.convert("RGB"), image, ImageChops.multiply(layer.getchannel("A"), floor))


def dot(image: Image.Image, at: Sequence[float], colour: RGB, radius: float = 6.0) -> None:
    """A disc with a pale rim."""
    fine = Image.new("RGBA", (round(2 * radius + 4) * FINE,) * 2, (0, 0, 0, 0))
    middle = fine.width / 2
    for reach, fill in ((radius + 1.5, PALE), (radius - 0.5, colour)):
        r = reach * FINE
        ImageDraw.Draw(fine).ellipse([middle - r, middle - r, middle + r, middle + r], fill=(*fill, 255))
    small = fine.resize((fine.width // FINE,) * 2, Image.Resampling.LANCZOS)
    image.paste(small, (round(at[0] - small.width / 2), round(at[1] - small.height / 2)), small)


def path_of(ticks: Iterable[Tick]) -> Array:
    """(n, 2) where the robot was, in world [m]."""
    return np.array([(t.true_pose.x, t.true_pose.y) for t in ticks])


def thinned(points: Array) -> Array:
    """Points of a path that are at least SPACING apart, and the last."""
    kept = [points[0]]
    for point in points[1:]:
        if np.hypot(*(point - kept[-1])) >= SPACING:
            kept.append(point)
    return np.array([*kept, points[-1]])


def stripes_by_context(points: Array, contexts: Sequence[str]) -> list[Stripe]:
    """A path coloured by the context in force: one stripe per stretch of one context."""
    cuts = [0, *(k for k, (a, b) in enumerate(pairwise(contexts), 1) if a != b), len(contexts)]
    stretches = [(points[a : b + 1], contexts[a]) for a, b in pairwise(cuts)]
    return [Stripe(thinned(part), colour_of(context)) for part, context in stretches if len(part) > 1]
