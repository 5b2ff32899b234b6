"""One page per exposure: what was seen, what disagrees, and how the camera bends."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fiberloom.instruments import FocalPlane
from fiberloom.metrology.images import CameraImage
from fiberloom.metrology.matching import MatchStatus
from fiberloom.metrology.pipeline import Reduction
from fiberloom.metrology.spots import Flag, Spots
from fiberloom.report.figures import figure_with_room, number_points, save, set_title
from fiberloom.timing import part
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM

_SHOWN_PX = 1000
"""Blocks of a plotted image per side: of more, some fall between the pixels of a page."""
_LABELS = 700
_FAR_MM = 0.5
"""A fibre farther from its target has not gone there: it is astray, and no residual."""
_COLOURS = {MatchStatus.DARK: "orange", MatchStatus.AMBIGUOUS: "magenta"}


@part("figures")
def plot_spots(path: Path, image: CameraImage, spots: Spots) -> None:
    """The image with its spots; flagged ones in red."""
    figure, axes = figure_with_room((11, 10))
    _show(axes, image)
    flagged = (spots.flags & ~np.uint32(Flag.COSMIC)) != 0
    _ring(axes, spots.xy_px[~flagged], "deepskyblue")
    _ring(axes, spots.xy_px[flagged], "crimson", size=60)
    set_title(axes, f"{len(spots)} spots, {int(flagged.sum())} flagged")
    axes.set(xlabel="x [px]", ylabel="y [px]")
    save(figure, path, 120)


@part("figures")
def plot_reduction(
    folder: Path, name: str, plane: FocalPlane, reduction: Reduction, goal_mm: Floats | None = None
) -> list[Path]:
    """Image with labels, residual vectors, distortion field; returns the files.

    `folder` and the beginning of the `name` of each file; `reduction`: of an image of the `plane`;
    `goal_mm` (N, 2): where the metrology fibres should be, NaN without a target; without it the residuals
    are against where the motors say that the fibres are.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}-{what}.png" for what in ("image", "residuals", "distortion")]
    _plot_labels(paths[0], plane, reduction)
    _plot_residuals(paths[1], plane, reduction, goal_mm)
    _plot_distortion(paths[2], reduction)
    return paths


def _show(axes: Any, image: CameraImage) -> None:
    step = max(1, max(image.shape) // _SHOWN_PX)
    blocks = _brightest(image, step)
    low, high = np.percentile(blocks[::4, ::4], [5, 99.7]).tolist()
    extent = (-0.5, blocks.shape[1] * step - 0.5, -0.5, blocks.shape[0] * step - 0.5)
    shade = np.arcsinh((blocks - low) / max(high - low, 1) * 10)
    # the same picture as by its colours, of which matplotlib would make four images in single precision
    how = {"cmap": "gray", "interpolation": "nearest", "interpolation_stage": "data"}
    axes.imshow(shade, origin="lower", extent=extent, **how)


def _brightest(image: CameraImage, step: int) -> NDArray[np.float32]:
    """Of each block: a spot must not fall between the pixels that are shown."""
    height, width = (size // step for size in image.shape)
    rows = []
    for j in range(height):  # row by row: no copy of the image
        band = CameraImage(image.pixels[j * step : (j + 1) * step, : width * step], image.fits_bytes)
        rows.append(band.array().max(axis=0).reshape(width, step).max(axis=1))
    return np.nan_to_num(np.array(rows, dtype=np.float32))


def _ring(axes: Any, at: Floats, colour: str, size: float = 30, marker: str = "o") -> None:
    axes.scatter(at[:, 0], at[:, 1], s=size, marker=marker, facecolors="none", edgecolors=colour)


def _plot_labels(path: Path, plane: FocalPlane, reduction: Reduction) -> None:
    figure, axes = figure_with_room((12, 12))
    _show(axes, reduction.image)
    spots, seen = reduction.spots, reduction.seen
    _ring(axes, spots.xy_px[reduction.acquisition.spot], "lime", size=50, marker="s")
    at = spots.xy_px[reduction.spot_of_match[seen]]
    _ring(axes, at, "deepskyblue")
    if seen.sum() <= _LABELS:
        number_points(axes, plane.positioner_id[seen], at, "deepskyblue", 5)
    _mark_missing(axes, plane, reduction)
    _frame(axes, np.vstack([at, spots.xy_px[reduction.acquisition.spot]]))
    title = (
        f"{int(seen.sum())} of {len(plane)} fibres, {len(reduction.acquisition.fiducial)} fiducials "
        "(squares); orange dark, magenta ambiguous"
    )
    set_title(axes, title)
    axes.set(xlabel="x [px]", ylabel="y [px]")
    save(figure, path, 110)


def _frame(axes: Any, shown: Floats) -> None:
    """The part of the image where something is."""
    low, high = shown.min(axis=0), shown.max(axis=0)
    room = 0.04 * (high - low).max()
    axes.set_xlim(low[0] - room, high[0] + room)
    axes.set_ylim(low[1] - room, high[1] + room)


def _mark_missing(axes: Any, plane: FocalPlane, reduction: Reduction) -> None:
    for status, colour in _COLOURS.items():
        rows = np.flatnonzero(reduction.match.status == status)
        if not len(rows):
            continue
        expected = reduction.expected_mm[rows]
        known = np.asarray(np.isfinite(expected).all(axis=1, keepdims=True))
        place = reduction.transform.to_px(np.where(known, expected, plane.centres_mm[rows]))
        axes.scatter(*place.T, s=70, marker="x", c=colour)
        number_points(axes, plane.positioner_id[rows], place, colour, 7)


def _plot_residuals(path: Path, plane: FocalPlane, reduction: Reduction, goal_mm: Floats | None) -> None:
    figure, (left, right) = figure_with_room((16, 8), 2)
    fit = reduction.acquisition.fit
    at = plane.fiducials[reduction.acquisition.fiducial, :2]
    loo_um = UM_PER_MM * fit.leave_one_out_mm
    _arrows(left, at, loo_um)
    set_title(left, f"fiducials: {fit.rms_um:.2f} µm rms fitted, {fit.leave_one_out_rms_um:.2f} µm left out")
    wanted, words = (
        (reduction.expected_mm, "where the motors say") if goal_mm is None else (goal_mm, "target")
    )
    rows = reduction.seen & np.isfinite(wanted).all(axis=1)
    near = rows & (np.hypot(*(reduction.xy_mm - wanted).T) < _FAR_MM)
    off_um = UM_PER_MM * (reduction.xy_mm - wanted)[near]
    _arrows(right, wanted[near], off_um)
    left_out = _left_out(int((rows & ~near).sum()))
    set_title(right, f"fibres: measured minus {words}, {_rms_text(off_um)}{left_out}")
    save(figure, path, 110)


def _rms_text(off_um: Floats) -> str:
    if not len(off_um):
        return "none seen"
    return f"{np.sqrt(np.mean(np.sum(off_um**2, axis=1))):.2f} µm rms of {len(off_um)}"


def _left_out(n: int) -> str:
    return f"; {n} farther than {_FAR_MM:g} mm left out" if n else ""


def _arrows(axes: Any, at_mm: Floats, vector_um: Floats) -> None:
    axes.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
    if not len(at_mm):
        return
    typical = max(float(np.median(np.hypot(*vector_um.T))), 1e-6)
    extent = float(np.ptp(at_mm, axis=0).max()) or 1.0
    scale = typical / (0.03 * extent)
    q = axes.quiver(*at_mm.T, *vector_um.T, angles="xy", scale_units="xy", scale=scale, width=0.002)
    unit = float(f"{typical:.1g}")
    axes.quiverkey(q, 0.9, 0.94, unit, f"{unit:g} µm")
    _frame(axes, np.vstack([at_mm, at_mm + vector_um / scale]))


def _plot_distortion(path: Path, reduction: Reduction) -> None:
    height, width = reduction.image.shape
    grid = np.stack(np.meshgrid(np.linspace(0, width - 1, 23), np.linspace(0, height - 1, 23)), -1).reshape(
        -1, 2
    )
    at = reduction.transform.to_mm(grid)
    inside = np.hypot(*at.T) < 1.05 * reduction.transform.radius_mm
    bend = UM_PER_MM * reduction.transform.distortion_mm(grid[inside])
    figure, axes = figure_with_room((9, 8.5))
    _arrows(axes, at[inside], bend)
    most_um = np.hypot(*bend.T).max()
    set_title(axes, f"distortion beyond shift, scale and rotation: {most_um:.0f} µm at most")
    save(figure, path, 110)
