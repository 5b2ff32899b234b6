"""Diagrams of the design tools; titles say the result."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes

from fiberloom.design.coverage import ArrayCoverage, Coverage
from fiberloom.design.efficiency import Efficiency
from fiberloom.design.gear import GearWindow, gear_verdict
from fiberloom.design.lattice import Lattice, Pattern
from fiberloom.design.spring import SpringWindow
from fiberloom.design.sweep import VariedDesign
from fiberloom.report.figures import figure_with, save

GRID = 400


def draw_coverage(
    path: Path,
    name: str,
    lattice: Lattice,
    pattern: Pattern,
    found: Coverage,
    array: ArrayCoverage | None,
) -> None:
    """A map of the lattice, and of the whole array where there is one, as an image file.

    `path` to write; `name` of the instrument; `lattice` and `pattern` that were counted; what was
    `found`; the
    `array`, or None.
    """
    figure, panels = figure_with((13.0 if array else 7.0, 6.0), 1, 2 if array else 1, squeeze=False)
    most = max(found.most, int(array.number.max()) if array else 0)
    image = _draw_lattice(panels[0, 0], lattice, pattern, most)
    panels[0, 0].set_title(f"{name}: {_reached(found)}, {found.mean:.2f} fibres at a point")
    if array is not None:
        _draw_array(panels[0, 1], array, most)
        panels[0, 1].set_title(
            f"whole array: {array.covered:.2%} reached, {array.blocked.mean():.2%} blocked"
        )
    figure.colorbar(image, ax=panels, label="fibres that reach the point", ticks=range(most + 1))
    save(figure, path)


def _reached(found: Coverage) -> str:
    """In words: a hole may be too small for a share, and the ranges of the axes may leave a rest."""
    share = found.at_least[min(found.least, len(found.at_least) - 1)]
    if found.least > 0:
        return f"{'every point' if share == 1.0 else f'{share:.2%}'} reached by {found.least} or more"
    return f"{found.at_least[1]:.2%} reached, with holes"


def _colours(most: int) -> dict[str, Any]:
    return {"cmap": colormaps["viridis"].resampled(most + 1), "vmin": -0.5, "vmax": most + 0.5}


def _draw_lattice(axes: Axes, lattice: Lattice, pattern: Pattern, most: int) -> Any:
    half = 2.0 * lattice.pitch_mm
    side = np.linspace(-half, half, GRID)
    points = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    number = lattice.count(points, pattern, free=False).reshape(GRID, GRID)
    image = axes.imshow(number, origin="lower", extent=(-half, half, -half, half), **_colours(most))
    q, r = (a.ravel() for a in np.meshgrid(np.arange(-6, 7), np.arange(-6, 7)))
    with_fibre = pattern.carries(q, r)
    axes.plot(*lattice.centres_mm(q, r)[with_fibre].T, "o", color="white", markeredgecolor="black", ms=4)
    axes.set(xlim=(-half, half), ylim=(-half, half), xlabel="x [mm]", ylabel="y [mm]")
    return image


def _draw_array(axes: Axes, array: ArrayCoverage, most: int) -> None:
    low, high = array.xy_mm.min(axis=0), array.xy_mm.max(axis=0)
    column, row = np.rint((array.xy_mm - low) / array.step_mm).astype(int).T
    image = np.full((row.max() + 1, column.max() + 1), np.nan)
    image[row, column] = array.number
    axes.imshow(image, origin="lower", extent=(low[0], high[0], low[1], high[1]), **_colours(most))
    axes.set(xlabel="x [mm]", ylabel="y [mm]")


def draw_gear(path: Path, name: str, windows: Sequence[GearWindow]) -> None:
    """The window of the ratio of both axes, with the ratio that each has: `windows` of `name`, into
    `path`."""
    figure, axes = figure_with((8.0, 3.4))
    for k, one in enumerate(windows):
        most = min(one.most, 30.0 * max(one.ratio, one.least))
        axes.barh(k, max(most - one.least, 0.0), left=one.least, height=0.5, color="tab:green", alpha=0.4)
        axes.plot(one.ratio, k, "o", color="black" if one.fits else "crimson")
        axes.annotate(f"{one.ratio:g}", (one.ratio, k), (0, 9), textcoords="offset points", ha="center")
    said = gear_verdict(windows)
    axes.set(xscale="log", xlabel="motor turns per output turn", title=f"{name}: {said}")
    axes.set_yticks(range(len(windows)), [one.axis for one in windows])
    axes.set_ylim(-0.6, len(windows) - 0.3)
    save(figure, path)


def draw_spring(path: Path, name: str, windows: Sequence[SpringWindow]) -> None:
    """Torque of the springs of all units over the range, between what bounds it: `windows` of `name`, into
    `path`."""
    figure, panels = figure_with((11.0, 4.6), 1, len(windows), squeeze=False)
    for axes, one in zip(panels[0], windows, strict=True):
        axes.fill_between(
            one.range_deg, one.ends_mNm.min(axis=0), one.ends_mNm.max(axis=0), alpha=0.4, label="all units"
        )
        axes.plot(one.range_deg, np.median(one.ends_mNm, axis=0), label="median")
        axes.axhline(one.low_mNm, color="crimson", ls="--", label=f"{one.factor:g} x load: play closed above")
        axes.axhline(one.high_mNm, color="crimson", label=f"friction / {one.factor:g} less load: held below")
        word = "fits" if one.advice() == "fits" else "outside"
        axes.set_title(f"{name} {one.axis}: {word}, {one.good_share:.0%} of units by {one.factor:g}")
        axes.set(xlabel=f"{one.axis} [deg]", ylabel="torque at the output [mNm]", ylim=(0.0, None))
    panels[0, 0].legend()
    save(figure, path)


def draw_efficiency(path: Path, name: str, found: Sequence[Efficiency]) -> None:
    """Shares of fibres used and of targets observed against targets per fibre: `found` of `name`, into
    `path`."""
    figure, (left, right) = figure_with((11.0, 4.6), 1, 2)
    for rule in dict.fromkeys(one.rule for one in found):
        rows = [one for one in found if one.rule == rule]
        per_fibre = [one.per_fibre for one in rows]
        for axes, share in ((left, "used"), (right, "observed")):
            value, error = ([getattr(one, word) for one in rows] for word in (share, f"{share}_error"))
            axes.errorbar(per_fibre, value, error, marker="o", ms=4, capsize=3, label=rule)
    last = found[-1]
    many = f"{last.exposures} exposures" if last.exposures > 1 else "one exposure"
    left.set(
        ylabel="share of the fibres that are used",
        title=f"{name}: {last.used:.1%} at {last.per_fibre:.2f} targets per fibre",
    )
    right.set(ylabel="share of the targets observed", title=f"{last.observed:.1%} of them after {many}")
    for axes in (left, right):
        axes.set(xlabel="targets per working fibre", ylim=(0.0, 1.03), xlim=(0.0, None))
    left.legend()
    save(figure, path)


def draw_front(
    path: Path, name: str, found: Sequence[VariedDesign], front: Sequence[bool], objectives: Sequence[str]
) -> None:
    """The first two `objectives` of all designs `found` of `name`, those on the `front` named, into
    `path`."""
    first, second = [*objectives, *objectives][:2]
    figure, axes = figure_with((8.0, 5.5))
    known = [
        ((x, y), one, on)
        for one, on in zip(found, front, strict=True)
        if (x := one.figures.get(first)) is not None and (y := one.figures.get(second)) is not None
    ]
    middle = float(np.median([at[0] for at, _, _ in known])) if known else 0.0
    for at, one, on in known:
        axes.plot(*at, "o", color="tab:red" if on else "0.7", zorder=3 if on else 2)
        if on:
            words = ", ".join(f"{key} {value:g}" for key, value in one.changes.items())
            side, off = ("left", 6) if at[0] < middle else ("right", -6)
            axes.annotate(words, at, (off, 5), textcoords="offset points", fontsize=8, ha=side)
    many = sum(on for _, _, on in known)
    axes.set(xlabel=first.replace("_", " "), ylabel=second.replace("_", " "))
    axes.margins(0.12)
    axes.set_title(f"{name}: {many} of {len(found)} designs on the front")
    save(figure, path)
