"""The focal plane with its arms, and the errors of its fibres, as figures."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # files only: no display is needed at an observatory's console

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import LineCollection
from numpy.typing import NDArray

from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats


def plot_focal_plane(
    path: Path,
    plane: FocalPlane,
    angles_deg: Floats,
    error_um: Floats,
    flagged: NDArray[np.bool_],
    requirement_um: float,
    title: str,
) -> None:
    """Draw every arm at `angles_deg` (N, 2), coloured by `error_um` (N,), NaN without a target.

    `path`: file to write; `plane`: the N positioners; `flagged` (N,): drawn in red; `requirement_um`:
    upper end of the colours; `title` above the figure.
    """
    figure, axes = plt.subplots(figsize=(10, 9.2), layout="constrained")
    base, elbow, tip = _arm_points(plane, angles_deg)
    alpha_arms = np.stack([base, elbow], axis=1)
    beta_arms = np.stack([elbow, tip], axis=1)
    axes.add_collection(LineCollection(list(alpha_arms), colors="0.8", linewidths=1.0))
    axes.add_collection(LineCollection(list(beta_arms), colors="0.55", linewidths=1.6))
    for x, y, radius in plane.fiducials:
        axes.add_patch(plt.Circle((x, y), radius, color="0.88", zorder=0))
    for x0, y0, x1, y1, radius in plane.guide_cameras:
        axes.plot([x0, x1], [y0, y1], color="0.88", linewidth=4 * radius / 3, zorder=0)

    served = np.isfinite(error_um) & ~flagged
    dots = axes.scatter(
        tip[served, 0],
        tip[served, 1], c=error_um[served], s=14, cmap="viridis_r", vmin=0, vmax=requirement_um,
        zorder=3,
    )  # fmt: skip
    if flagged.any():
        axes.scatter(
            tip[flagged, 0], tip[flagged, 1], s=60, facecolors="none", edgecolors="crimson", zorder=4
        )
        for index in np.flatnonzero(flagged):
            axes.annotate(str(plane.positioner_id[index]), tip[index], color="crimson", fontsize=7)
    figure.colorbar(dots, ax=axes, label="error of the fibre [µm]", shrink=0.75, extend="max")
    axes.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", title=title)
    axes.autoscale_view()
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _arm_points(plane: FocalPlane, angles_deg: Floats) -> tuple[Floats, Floats, Floats]:
    """Alpha axis, beta axis and end of the beta arm of every positioner, mm."""
    tip = plane.forward(angles_deg[:, 0], angles_deg[:, 1], fibre="metrology")
    return plane.centres_mm, plane.elbows_mm(angles_deg[:, 0]), tip


def plot_errors(path: Path, errors_um: list[Floats], labels: list[str], requirement_um: float) -> None:
    """Cumulative distribution of the true (or measured) error after each move, on a log axis.

    `path`: file to write; `errors_um`: (n,) for each move, with its name in `labels`; `requirement_um`:
    drawn as a line.
    """
    figure, axes = plt.subplots(figsize=(8, 5), layout="constrained")
    for error, label in zip(errors_um, labels, strict=True):
        values = np.sort(error[np.isfinite(error)])
        if not len(values):
            continue
        share = 100.0 * np.arange(1, len(values) + 1) / len(values)
        rms = float(np.sqrt(np.mean(values**2)))
        axes.step(values, share, where="post", label=f"{label}: {rms:.2f} µm rms")
    axes.axvline(requirement_um, color="crimson", linestyle="--", label=f"requirement {requirement_um:g} µm")
    axes.set(xscale="log", xlabel="error of the fibre [µm]", ylabel="fibres below [%]", ylim=(0, 101))
    axes.set_title("Each correction brings the fibres nearer to their targets")
    axes.grid(True, which="both", alpha=0.25)
    axes.legend(loc="lower right", fontsize=8)
    figure.savefig(path, dpi=120)
    plt.close(figure)
