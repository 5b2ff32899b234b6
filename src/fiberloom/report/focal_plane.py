"""The focal plane with its arms, and the errors of its fibres, as figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from fiberloom.instruments import FocalPlane
from fiberloom.report.figures import figure_with_room, save, set_title
from fiberloom.timing import part
from fiberloom.typing import Flags, Floats


@dataclass(frozen=True)
class FieldPicture:
    """What is drawn of a field: arrays over N positioners."""

    angles_deg: Floats
    """(N, 2) where the arms are."""
    error_um: Floats
    """(N,) error of each fibre; NaN: no target."""
    flagged: Flags
    """(N,) in red."""
    requirement_um: float
    title: str


@part("figures")
def plot_focal_plane(path: Path, plane: FocalPlane, picture: FieldPicture) -> None:
    """Draw every arm, coloured by the error of its fibre, flags in red; the part that the arms reach.

    `path`: file to write; `plane`: the N positioners; `picture`: what is drawn of them.
    """
    figure, axes = figure_with_room((10, 7.7))
    draw_focal_plane(axes, plane, picture)
    frame_positioners(axes, plane)
    save(figure, path)


def draw_focal_plane(axes: Axes, plane: FocalPlane, picture: FieldPicture) -> Axes:
    """The same into `axes` that exist, with a colour bar beside them."""
    base, elbow, tip = _arm_points(plane, picture.angles_deg)
    alpha_arms = np.stack([base, elbow], axis=1)
    beta_arms = np.stack([elbow, tip], axis=1)
    axes.add_collection(LineCollection(list(alpha_arms), colors="0.8", linewidths=1.0))
    axes.add_collection(LineCollection(list(beta_arms), colors="0.55", linewidths=1.6))
    _draw_discs(axes, plane.fiducials)
    for x0, y0, x1, y1, radius in plane.guide_cameras:
        axes.plot([x0, x1], [y0, y1], color="0.88", linewidth=4 * radius / 3, zorder=0)
    _draw_fibres(axes, plane, picture, tip)
    set_title(axes, picture.title)
    axes.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
    axes.autoscale_view()
    return axes


def _draw_discs(axes: Axes, discs: Floats) -> None:
    """Of centres and radii (n, 3) mm, as one artist: as patches the extent of each would be sought."""
    width, level = 2.0 * discs[:, 2], np.zeros(len(discs))
    how: dict[str, Any] = {"units": "xy", "offsets": discs[:, :2], "offset_transform": axes.transData}
    axes.add_collection(EllipseCollection(width, width, level, color="0.88", zorder=0, **how))


def frame_positioners(axes: Axes, plane: FocalPlane) -> None:
    """Shows the part of the field that the arms reach."""
    reach_mm = 1.2 * float(plane.body_reach_mm.max(initial=0.0))
    (left, bottom), (right, top) = plane.centres_mm.min(axis=0), plane.centres_mm.max(axis=0)
    axes.set(xlim=(left - reach_mm, right + reach_mm), ylim=(bottom - reach_mm, top + reach_mm))


def _draw_fibres(axes: Axes, plane: FocalPlane, picture: FieldPicture, tip: Floats) -> None:
    flagged, error_um = picture.flagged, picture.error_um
    served = np.isfinite(error_um) & ~flagged
    dots = axes.scatter(
        tip[served, 0],
        tip[served, 1], c=error_um[served], s=14, cmap="viridis_r", vmin=0, vmax=picture.requirement_um,
        zorder=3,
    )  # fmt: skip
    if flagged.any():
        axes.scatter(
            tip[flagged, 0], tip[flagged, 1], s=60, facecolors="none", edgecolors="crimson", zorder=4
        )
        for index in np.flatnonzero(flagged):
            axes.annotate(str(plane.positioner_id[index]), tip[index], color="crimson", fontsize=7)
    figure = axes.get_figure()
    if isinstance(figure, Figure):
        figure.colorbar(dots, ax=axes, label="error of the fibre [µm]", shrink=0.75, extend="max")


def _arm_points(plane: FocalPlane, angles_deg: Floats) -> tuple[Floats, Floats, Floats]:
    """Alpha axis, beta axis and end of the beta arm of every positioner, mm."""
    tip = plane.forward(angles_deg[:, 0], angles_deg[:, 1], fibre="metrology")
    return plane.centres_mm, plane.elbows_mm(angles_deg[:, 0]), tip


@part("figures")
def plot_errors(
    path: Path, errors_um: list[Floats], labels: list[str], requirement_um: float, title: str = ""
) -> None:
    """Cumulative distribution of the true (or measured) error after each move, on a log axis.

    `path`: file to write; `errors_um`: (n,) for each move, with its name in `labels`; `requirement_um`:
    drawn as a line; `title`: the result, as of `errors_title`.
    """
    figure, axes = figure_with_room((8, 5))
    for error, label in zip(errors_um, labels, strict=True):
        values = np.sort(error[np.isfinite(error)])
        if not len(values):
            continue
        share = 100.0 * np.arange(1, len(values) + 1) / len(values)
        axes.step(values, share, where="post", label=f"{label}: {_rms(values):.2f} µm rms")
    axes.axvline(requirement_um, color="crimson", linestyle="--", label=f"requirement {requirement_um:g} µm")
    axes.set_xscale("log")
    # as 0.1, 1, 10: powers of ten want the parser of formulas, which takes as long as the rest of the figure
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(xlabel="error of the fibre [µm]", ylabel="fibres below [%]", ylim=(0, 101))
    set_title(axes, title, fontsize=10)
    _log_grid(axes, alpha=0.25)
    axes.legend(loc="upper left", fontsize=8)  # no curve comes there: the first errors are those of few
    save(figure, path)


def _log_grid(axes: Axes, alpha: float) -> None:
    """Lines at the ticks of a logarithmic x axis and a linear y axis, and between powers of ten at 2 to 9 of
    the lower one: these as one artist, for a tick of its own takes as long as a curve.
    """
    axes.xaxis.set_minor_locator(NullLocator())
    axes.grid(True, alpha=alpha)
    at = LogLocator(subs=range(2, 10)).tick_values(*axes.get_xlim())
    how = {"colors": rcParams["grid.color"], "linewidths": rcParams["grid.linewidth"], "alpha": alpha}
    lines = LineCollection(
        [[(x, 0.0), (x, 1.0)] for x in at], transform=axes.get_xaxis_transform(), zorder=0, **how
    )
    axes.add_collection(lines, autolim=False)


def errors_title(errors_um: list[Floats], n_assigned: int, requirement_um: float) -> str:
    """What the moves of an observation came to, in a line.

    `errors_um`: (n,) for each of its moves, NaN where not measured; `n_assigned`: fibres with a target.
    """
    measured = [error[np.isfinite(error)] for error in errors_um]
    rms_um = [_rms(error) for error in measured if len(error)]
    if not n_assigned:
        return "no target was assigned"
    if not rms_um:
        return f"no error is known of any of {n_assigned} assigned fibres"
    within = int((measured[-1] <= requirement_um).sum())
    head = f"{within} of {n_assigned} assigned fibres within {requirement_um:g} µm"
    return f"{head}; {_course(rms_um)}"


def _course(rms_um: list[float]) -> str:
    """How the rms went from move to move."""
    first, last = rms_um[0], rms_um[-1]
    if len(rms_um) == 1:
        return f"{first:.2f} µm rms"
    if last > first:
        return f"the corrections made it worse: {first:.2f} to {last:.2f} µm rms"
    if last > rms_um[-2]:
        return f"the last correction made it worse: {rms_um[-2]:.2f} to {last:.2f} µm rms"
    return f"corrected from {first:.2f} to {last:.2f} µm rms"


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
