"""The cut-out of one fibre as a PNG: its spot, the measured centroid, and the goal."""

from __future__ import annotations

import io
import math

import numpy as np
from PIL import Image, ImageDraw

from fiberloom.service.stamps import Stamps
from fiberloom.typing import Array, Floats

ZOOM = 8
"""Of each pixel."""
CENTROID, GOAL = (240, 228, 66), (86, 180, 233)
"""Colours that the colour-blind tell apart; the shapes differ too: a cross, a ring."""


def cutout_png(stamps: Stamps, row: int, goal_mm: Floats) -> bytes:
    """The cut-out of the positioner in `row` of the `stamps`, as bytes of a PNG.

    A cross: the centroid as measured. A ring: where it is to be, `goal_mm` (2,), NaN: without a target.
    """
    image = Image.fromarray(stretched(stamps.pixels[row]), "L").convert("RGB")
    image = image.resize((ZOOM * image.width, ZOOM * image.height), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(image)
    _cross(draw, stamps.spot_within(row))
    if np.isfinite(goal_mm).all():
        _ring(draw, stamps.within(row, goal_mm))
    out = io.BytesIO()
    image.save(out, "PNG")
    return out.getvalue()


def stretched(pixels: Array) -> Array:
    """Grey values of a cut-out, uint8: the background is dark and the wings of a spot can be seen."""
    floor, top = np.percentile(pixels, 25.0), float(pixels.max())
    share = np.clip((pixels.astype(float) - floor) / max(top - floor, 1.0), 0.0, 1.0)
    return np.asarray(np.round(255.0 * np.sqrt(share)), dtype=np.uint8)


def _shown(place: tuple[float, float]) -> tuple[float, float] | None:
    """In the enlarged image; None: not known. The middle of a pixel is in its middle."""
    x, y = place
    return None if math.isnan(x) or math.isnan(y) else (ZOOM * (x + 0.5), ZOOM * (y + 0.5))


def _cross(draw: ImageDraw.ImageDraw, place: tuple[float, float]) -> None:
    if (at := _shown(place)) is None:
        return
    x, y = at
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        draw.line((x + 5 * dx, y + 5 * dy, x + 30 * dx, y + 30 * dy), CENTROID, 2)


def _ring(draw: ImageDraw.ImageDraw, place: tuple[float, float]) -> None:
    if (at := _shown(place)) is None:
        return
    x, y = at
    draw.ellipse((x - 20, y - 20, x + 20, y + 20), outline=GOAL, width=2)
