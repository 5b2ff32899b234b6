"""One page per exposure: what was seen, what disagrees, and how the camera bends."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")  # files only: no display is needed at an observatory's console

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from fiberloom.instruments import FocalPlane
from fiberloom.metrology.images import CameraImage
from fiberloom.metrology.matching import MatchStatus
from fiberloom.metrology.pipeline import Reduction
from fiberloom.metrology.spots import Flag, Spots
from fiberloom.units import UM_PER_MM

Floats = NDArray[np.float64]

_SHOWN_PX = 1500
"""Pixels of a plotted image per side: more do not fit on a page."""
_LABELS = 700
_COLOURS = {MatchStatus.DARK: "orange", MatchStatus.AMBIGUOUS: "magenta"}


def plot_spots(path: Path, image: CameraImage, spots: Spots) -> None:
    """The image with its spots; flagged ones in red."""
    figure, axes = plt.subplots(figsize=(11, 10), layout="constrained")
    _show(axes, image)
    flagged = (spots.flags & ~np.uint32(Flag.COSMIC)) != 0
    _ring(axes, spots.xy_px[~flagged], "deepskyblue")
    _ring(axes, spots.xy_px[flagged], "crimson", size=60)
    axes.set(title=f"{len(spots)} spots, {int(flagged.sum())} flagged", xlabel="x [px]", ylabel="y [px]")
    figure.savefig(path, dpi=120)
    plt.close(figure)


def plot_reduction(folder: Path, name: str, plane: FocalPlane, reduction: Reduction) -> list[Path]:
    """Image with labels, residual vectors, distortion field; returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}-{what}.png" for what in ("image", "residuals", "distortion")]
    _plot_labels(paths[0], plane, reduction)
    _plot_residuals(paths[1], plane, reduction)
    _plot_distortion(paths[2], reduction)
    return paths


def _show(axes: Any, image: CameraImage) -> None:
    step = max(1, max(image.shape) // _SHOWN_PX)
    pixels = image.pixels[: image.shape[0] // step * step, : image.shape[1] // step * step]
    whole = CameraImage(pixels, image.fits_bytes).array()
    # the brightest of each block: a spot must not fall between the pixels that are shown
    blocks = whole.reshape(whole.shape[0] // step, step, whole.shape[1] // step, step).max(axis=(1, 3))
    low, high = np.percentile(blocks, [5, 99.7])
    extent = (-0.5, blocks.shape[1] * step - 0.5, -0.5, blocks.shape[0] * step - 0.5)
    shade = np.arcsinh((blocks - low) / max(high - low, 1) * 10)
    axes.imshow(shade, origin="lower", extent=extent, cmap="gray", interpolation="nearest")


def _ring(axes: Any, at: Floats, colour: str, size: float = 30, marker: str = "o") -> None:
    axes.scatter(at[:, 0], at[:, 1], s=size, marker=marker, facecolors="none", edgecolors=colour)


def _plot_labels(path: Path, plane: FocalPlane, reduction: Reduction) -> None:
    figure, axes = plt.subplots(figsize=(13, 13), layout="constrained")
    _show(axes, reduction.image)
    spots, seen = reduction.spots, reduction.seen
    _ring(axes, spots.xy_px[reduction.acquisition.spot], "lime", size=50, marker="s")
    at = spots.xy_px[reduction.spot_of_match[seen]]
    _ring(axes, at, "deepskyblue")
    if seen.sum() <= _LABELS:
        for number, xy in zip(plane.positioner_id[seen], at, strict=True):
            axes.annotate(str(number), xy, color="deepskyblue", fontsize=5, xytext=(3, 3),
                          textcoords="offset points")  # fmt: skip
    _mark_missing(axes, plane, reduction)
    title = (
        f"{int(seen.sum())} of {len(plane)} fibres, {len(reduction.acquisition.fiducial)} fiducials "
        "(squares); orange dark, magenta ambiguous"
    )
    axes.set(title=title, xlabel="x [px]", ylabel="y [px]")
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _mark_missing(axes: Any, plane: FocalPlane, reduction: Reduction) -> None:
    for status, colour in _COLOURS.items():
        rows = np.flatnonzero(reduction.match.status == status)
        if not len(rows):
            continue
        expected = reduction.expected_mm[rows]
        known = np.asarray(np.isfinite(expected).all(axis=1, keepdims=True))
        place = reduction.transform.to_px(np.where(known, expected, plane.centres_mm[rows]))
        axes.scatter(*place.T, s=70, marker="x", c=colour)
        for number, xy in zip(plane.positioner_id[rows], place, strict=True):
            axes.annotate(str(number), xy, color=colour, fontsize=7)


def _plot_residuals(path: Path, plane: FocalPlane, reduction: Reduction) -> None:
    figure, (left, right) = plt.subplots(1, 2, figsize=(16, 8), layout="constrained")
    fit = reduction.acquisition.fit
    at = plane.fiducials[reduction.acquisition.fiducial, :2]
    loo_um = UM_PER_MM * fit.leave_one_out_mm
    _arrows(left, at, loo_um)
    left.set_title(f"fiducials: {fit.rms_um:.2f} µm rms fitted, {fit.leave_one_out_rms_um:.2f} µm left out")
    rows = reduction.seen & np.isfinite(reduction.expected_mm).all(axis=1)
    off_um = UM_PER_MM * (reduction.xy_mm - reduction.expected_mm)[rows]
    _arrows(right, reduction.expected_mm[rows], off_um)
    rms = float(np.sqrt(np.mean(np.sum(off_um**2, axis=1)))) if rows.any() else float("nan")
    right.set_title(f"fibres: measured minus expected, {rms:.1f} µm rms")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _arrows(axes: Any, at_mm: Floats, vector_um: Floats) -> None:
    size = np.hypot(*vector_um.T)
    typical = float(np.median(size)) if len(size) else 1.0
    extent = float(np.ptp(at_mm)) if len(at_mm) else 1.0
    q = axes.quiver(*at_mm.T, *vector_um.T, angles="xy", scale_units="xy",
                    scale=max(typical, 1e-6) / (0.03 * extent), width=0.002)  # fmt: skip
    unit = float(f"{typical:.1g}") or 1.0
    axes.quiverkey(q, 0.9, 0.94, unit, f"{unit:g} µm")
    axes.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")


def _plot_distortion(path: Path, reduction: Reduction) -> None:
    height, width = reduction.image.shape
    grid = np.stack(np.meshgrid(np.linspace(0, width - 1, 23), np.linspace(0, height - 1, 23)), -1).reshape(
        -1, 2
    )
    at = reduction.transform.to_mm(grid)
    inside = np.hypot(*at.T) < 1.05 * reduction.transform.radius_mm
    bend = UM_PER_MM * reduction.transform.distortion_mm(grid[inside])
    figure, axes = plt.subplots(figsize=(9, 8.5), layout="constrained")
    _arrows(axes, at[inside], bend)
    axes.set_title(f"distortion beyond shift, scale and rotation: {np.hypot(*bend.T).max():.0f} µm at most")
    figure.savefig(path, dpi=110)
    plt.close(figure)
