"""A plan as a film: arms, buffers, obstacles and goals above, who is in motion and the least gap below."""

from __future__ import annotations

import logging
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from PIL import Image

from fiberloom.errors import InputError
from fiberloom.instruments.model import BODY_SHARE
from fiberloom.planning import Verification
from fiberloom.planning.obstacles import RADIUS
from fiberloom.report.film.formats import GIF, require_film
from fiberloom.report.film.moments import NEAR_MM, Moments
from fiberloom.units import deg_to_rad
from fiberloom.wholefile import whole

SIZE_IN, DPI = (9.0, 10.0), 100
PICTURES_PER_S = 10
LAST_S = 1.5
"""The end is shown so long, before a film that repeats begins anew."""

MOVING, RESTING, ARRIVED, REFUSED, OFFLINE = "#1f6fb4", "#8a94a3", "#2a9d5c", "#d7263d", "#333333"
_STATES = (MOVING, RESTING, ARRIVED, REFUSED, OFFLINE)
ALONE, NEAR, STRANDED = "#d3dce8", "#ffb000", "#f5b8c0"
_BUFFERS = (ALONE, NEAR, STRANDED)
OBSTACLE, ALPHA, GOAL, CURVE = "#b9b2a6", "#9e9e9e", "#14532d", "#b37400"

_FIELD = (0.06, 0.215, 0.925, 0.707)
_CURVES = ((0.06, 0.123, 0.925, 0.05), (0.06, 0.048, 0.925, 0.05))
_MOST_NAMED = 40
_TITLE_PT, _TITLE_LETTERS = 13.0, 76
_IN_A_ROW = 6
_INCH_PT = 72.0


def write_film(path: Path, shown: Moments, title: str, progress: Callable[[int, int], None]) -> None:
    """Write a plan at its moments as .gif or .mp4.

    `path`: file to write; `shown`: the plan; `title`: the result, as of `film_title`; `progress`: called with
    how many pictures are drawn, of how many. InputError where it cannot be made or written.
    """
    require_film("film", path)
    picture = Picture(shown, title)
    order = [*shown.pictures, *[shown.pictures[-1]] * round(LAST_S * PICTURES_PER_S)]
    with _writing(path, picture.figure) as writer:
        for done, moment in enumerate(order, 1):
            picture.show(int(moment))
            writer.grab_frame()
            progress(done, len(order))


def film_title(shown: Moments, checked: Verification) -> str:
    """What the motion comes to, in a line."""
    n, refused = shown.plane.n, int(shown.refused.sum())
    who = f"{n - refused} of {n} positioners arrive" if refused else f"{n} positioners"
    gap = "no neighbours"
    if overlaps := len(checked.contacts):
        gap = f"{overlaps} pairs overlap and stay" if overlaps > 1 else "a pair overlaps and stays"
    elif np.isfinite(checked.min_clearance_mm):
        gap = f"least gap {checked.min_clearance_mm:.3f} mm beyond the buffer"
    proof = "verified" if checked.ok else "NOT VERIFIED"
    return f"{who}, {shown.plan.duration_s:.1f} s of motion, {gap}, {proof}"


@contextmanager
def _writing(path: Path, figure: Figure) -> Iterator[AbstractMovieWriter]:
    gif = path.suffix.lower() == GIF
    writer: AbstractMovieWriter = _Gif(PICTURES_PER_S) if gif else FFMpegWriter(PICTURES_PER_S, codec="h264")
    try:
        with _told_once(), whole(path) as part, writer.saving(figure, str(part), DPI):
            yield writer
    except subprocess.CalledProcessError as error:
        last = str(error.stderr or "").strip().splitlines()[-1:] or [f"exit code {error.returncode}"]
        raise InputError(f"{path}: cannot be written (ffmpeg: {last[0]})") from None


@contextmanager
def _told_once() -> Iterator[None]:
    """What ffmpeg complains of is in the error; matplotlib does not log it as well."""
    log = logging.getLogger("matplotlib.animation")
    log.addFilter(_nothing)
    try:
        yield
    finally:
        log.removeFilter(_nothing)


def _nothing(record: logging.LogRecord) -> bool:
    return False


class _Gif(AbstractMovieWriter):
    """As matplotlib's PillowWriter, but all pictures have one palette, of the colours of the film.

    So a picture takes a byte a pixel, and no colour changes from one to the next.
    """

    def setup(self, fig: Figure, outfile: str | Path, dpi: float | None = None) -> None:
        super().setup(fig, outfile, dpi)
        self._pictures: list[Image.Image] = []
        self._colours = Image.new("P", (1, 1))
        self._colours.putpalette(_palette().ravel().tolist())

    def grab_frame(self, **how: Any) -> None:
        data = BytesIO()
        self.fig.savefig(data, format="rgba", dpi=self.dpi, **how)
        drawn = Image.frombytes("RGBA", self.frame_size, data.getvalue()).convert("RGB")
        self._pictures.append(drawn.quantize(palette=self._colours, dither=Image.Dither.NONE))

    def finish(self) -> None:
        if not self._pictures:  # given up before the first
            return
        first, *others = self._pictures
        first.save(
            self.outfile, format="GIF", save_all=True, append_images=others, duration=1000 // PICTURES_PER_S,
            loop=0,
        )  # fmt: skip


def _palette() -> NDArray[np.uint8]:
    """(n, 3) colours of the film, and what the edges of lines make of them; n at most 256."""
    lines = np.array([to_rgb(c) for c in (*_STATES, *_BUFFERS, ALPHA, OBSTACLE, GOAL, CURVE)])
    grounds = np.array([to_rgb(c) for c in ("white", *_BUFFERS)])
    share = np.linspace(0.2, 1.0, 5)[:, None, None, None]
    blends = (share * lines[:, None] + (1.0 - share) * grounds).reshape(-1, 3)
    greys = np.linspace(0.0, 1.0, 24)[:, None].repeat(3, axis=1)
    found = np.unique(np.rint(255.0 * np.concatenate([blends, greys])).astype(np.uint8), axis=0)
    nearly_white = (found.min(axis=1) > 236) & (found.min(axis=1) < 255)  # would take the place of white
    return np.asarray(found[~nearly_white], dtype=np.uint8)


class Picture:
    """The figure of a plan; `show` sets it to a moment."""

    def __init__(self, shown: Moments, title: str) -> None:
        self.shown = shown
        self.figure = Figure(figsize=SIZE_IN)
        size_pt = min(_TITLE_PT, _TITLE_PT * _TITLE_LETTERS / len(title))
        self.figure.text(0.5, 0.985, title, ha="center", va="top", fontsize=size_pt, weight="bold")
        self.field = self.figure.add_axes(_FIELD)
        self.pt_per_mm = _frame(self.field, shown)
        self.fiducials, self.others = self._draw_obstacles()
        self.alpha_arms = self._lines(ALPHA, 1.0 if shown.plane.n > 100 else 2.0, 2)
        self.buffers = self._lines(ALONE, 1.0, 1)
        self.buffers.set_linewidth([self._pt(2.0 * r) for r in shown.bodies.parts[:, RADIUS]])
        body_mm = 2.0 * BODY_SHARE * shown.plane.collision_buffer_mm
        self.beta_arms = self._lines(RESTING, self._pt(0.6 * body_mm), 3)
        self.goals = self._draw_goals()
        self._name_refused()
        self.clock = self.field.text(
            0.012, 0.985, "", transform=self.field.transAxes, va="top", fontsize=11, zorder=7,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5},
        )  # fmt: skip
        self.now = self._draw_curves()
        self._draw_legend()
        self.show(0)

    def show(self, moment: int) -> None:
        """Sets arms, colours and clock to a moment, by its number."""
        shown, (alpha_deg, beta_deg) = self.shown, self.shown.angles_deg[moment].T
        elbows = shown.plane.elbows_mm(alpha_deg)
        self.alpha_arms.set_segments([*np.stack([shown.plane.centres_mm, elbows], axis=1)])
        self.beta_arms.set_segments([*shown.plane.beta_segments(alpha_deg, beta_deg).reshape(-1, 2, 2)])
        parts = shown.around.all_lines_mm(deg_to_rad(shown.angles_deg[moment]))
        self.buffers.set_segments([*parts.reshape(-1, 2, 2)])
        near, n = shown.near[moment], shown.plane.n
        halo = np.where(near[:n], NEAR, np.where(shown.refused, STRANDED, ALONE))
        self.buffers.set_color(list(halo[shown.bodies.parts[:, 0].astype(np.int64)]))
        self.beta_arms.set_color(list(self._colours(moment)))
        obstacles, discs = list(np.where(near[n:], NEAR, OBSTACLE)), len(shown.plane.fiducials)
        self.fiducials.set_color(obstacles[:discs])
        self.others.set_color(obstacles[discs:])
        self.goals.set_facecolor(list(np.where(shown.arrived[moment], ARRIVED, "white")))
        time_s = shown.time_s[moment]
        clock = f"{time_s:.1f} s   {int(shown.moving[moment].sum())} in motion"
        self.clock.set_text(f"{clock}\n{shown.nearest(moment)}".rstrip())
        for line in self.now:
            line.set_xdata([time_s, time_s])

    def _colours(self, moment: int) -> NDArray[np.str_]:
        shown = self.shown
        state = [shown.plane.offline, shown.refused, shown.moving[moment], shown.arrived[moment]]
        return np.asarray(np.select(state, [OFFLINE, REFUSED, MOVING, ARRIVED], RESTING))

    def _pt(self, mm: float, least: float = 0.8) -> float:
        return max(least, mm * self.pt_per_mm)

    def _lines(self, colour: str, width_pt: float, zorder: int) -> LineCollection:
        lines = LineCollection([], colors=colour, linewidths=width_pt, capstyle="round", zorder=zorder)
        self.field.add_collection(lines, autolim=False)
        return lines

    def _draw_obstacles(self) -> tuple[PathCollection, LineCollection]:
        """Fiducials as discs, all others as lines with round ends, as large as they are."""
        plane = self.shown.plane
        x, y, radius = plane.fiducials.T
        discs = self.field.scatter(x, y, s=(2.0 * radius * self.pt_per_mm) ** 2, linewidths=0, zorder=0)
        others = self._lines(OBSTACLE, 1.0, 0)
        rest = self.shown.bodies.obstacles[len(x) :]
        others.set_segments([*rest[:, :4].reshape(-1, 2, 2)])
        others.set_linewidth([self._pt(2.0 * r) for r in rest[:, 4]] or [1.0])
        return discs, others

    def _draw_goals(self) -> PathCollection:
        plane, goal_deg = self.shown.plane, self.shown.goal_deg
        x, y = np.where(plane.offline, np.nan, plane.forward(goal_deg[:, 0], goal_deg[:, 1]).T)
        edge = list(np.where(self.shown.refused, REFUSED, GOAL))
        size_pt = self._pt(1.6, least=2.6)
        return self.field.scatter(x, y, s=size_pt**2, facecolor="white", edgecolor=edge, lw=0.8, zorder=5)

    def _name_refused(self) -> None:
        shown = self.shown
        for row in np.flatnonzero(shown.refused)[:_MOST_NAMED]:
            self.field.annotate(
                str(shown.plane.positioner_id[row]), shown.plane.centres_mm[row], color=REFUSED,
                fontsize=8, weight="bold", ha="center", va="center", zorder=6,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8},
            )  # fmt: skip

    def _draw_curves(self) -> list[Line2D]:
        """Who is in motion and the least gap against time; the lines that say what time it is."""
        shown, end_s = self.shown, max(self.shown.plan.duration_s, 0.1)
        above, below = (self.figure.add_axes(box) for box in _CURVES)
        above.fill_between(shown.time_s, shown.moving.sum(axis=1), step="mid", color=MOVING, alpha=0.35)
        above.set(ylim=(0, None), xticklabels=[])
        gap_mm = shown.least_gap_mm
        below.axhspan(0.0, NEAR_MM, color=NEAR, alpha=0.2, linewidth=0)
        below.plot(shown.time_s, gap_mm, color=CURVE, linewidth=1.2)
        top_mm = max(1.2 * NEAR_MM, 1.05 * float(gap_mm[np.isfinite(gap_mm)].max(initial=0.0)))
        below.set(ylim=(min(0.0, 1.05 * float(gap_mm.min())), top_mm))
        below.set_xlabel("time [s]", fontsize=9, labelpad=1)
        for axes, what in ((above, "positioners in motion"), (below, "least gap beyond the buffers [mm]")):
            axes.set_xlim(0.0, end_s)
            axes.tick_params(labelsize=8)
            axes.spines[["top", "right"]].set_visible(False)
            axes.text(1.0, 1.04, what, transform=axes.transAxes, ha="right", va="bottom", fontsize=8.5)
        return [axes.axvline(0.0, color="black", linewidth=1.2) for axes in (above, below)]

    def _draw_legend(self) -> None:
        shown = self.shown
        said = [(MOVING, "in motion"), (RESTING, "waiting"), (ARRIVED, "at its goal")]
        said += [(REFUSED, "does not arrive")] if shown.refused.any() else []
        said += [(OFFLINE, "offline")] if shown.plane.offline.any() else []
        said += [(NEAR, f"less than {NEAR_MM:g} mm beyond the buffers")]
        said += [(OBSTACLE, ", ".join(self._kinds_of_obstacles()))] if len(shown.bodies.obstacles) else []
        marks = [Line2D([], [], color=c, linewidth=6, solid_capstyle="round", label=t) for c, t in said]
        marks.append(Line2D([], [], linestyle="", marker="o", mfc="white", mec=GOAL, label="goal"))
        top, columns = (0.96, len(marks)) if len(marks) <= _IN_A_ROW else (0.968, 4)
        self.figure.legend(
            handles=marks, loc="upper center", bbox_to_anchor=(0.5, top), ncols=columns, fontsize=8.5,
            frameon=False, labelspacing=0.2, handlelength=1.0, handletextpad=0.5, columnspacing=1.4,
        )  # fmt: skip

    def _kinds_of_obstacles(self) -> list[str]:
        plane = self.shown.plane
        fixed = {
            "fiducial": len(plane.fiducials),
            "guide camera": len(plane.guide_cameras),
            "keep-out": len(plane.instrument.bodies.keep_outs),
            "where an arm may be": int((self.shown.bodies.obstacles[:, 6] >= 0).sum()),
        }
        return [name for name, count in fixed.items() if count]


def _frame(axes: Axes, shown: Moments) -> float:
    """Shows what the arms reach, x and y alike; points of the page in a mm."""
    plane = shown.plane
    margin_mm = 1.15 * float(plane.body_reach_mm.max(initial=1.0))
    low, high = plane.centres_mm.min(axis=0) - margin_mm, plane.centres_mm.max(axis=0) + margin_mm
    width_pt, height_pt = (_INCH_PT * s * f for s, f in zip(SIZE_IN, _FIELD[2:], strict=True))
    pt_per_mm = min(width_pt / (high[0] - low[0]), height_pt / (high[1] - low[1]))
    middle = (low + high) / 2.0
    half = np.array([width_pt, height_pt]) / pt_per_mm / 2.0
    (left, bottom), (right, top) = middle - half, middle + half
    axes.set(xlim=(left, right), ylim=(bottom, top))
    axes.text(0.99, 0.012, "x, y [mm]", transform=axes.transAxes, ha="right", fontsize=9)
    axes.tick_params(labelsize=8)
    return float(pt_per_mm)
