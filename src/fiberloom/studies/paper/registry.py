"""Which figures there are."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fiberloom.errors import InputError

if TYPE_CHECKING:
    from fiberloom.studies.paper.outcome import FigureOutcome, Settings


@dataclass(frozen=True)
class Figure:
    """A figure, equation, table or section of Kronig 2020 and the module that makes ours."""

    key: str
    """As typed: `16`, `eq22`, `table1`, `section2`."""
    title: str
    module: str

    @property
    def name(self) -> str:
        """File name and start of the ids of its quantities: `fig16`."""
        return f"fig{int(self.key):02d}" if self.key.isdigit() else self.key

    @property
    def heading(self) -> str:
        """As in the paper."""
        if self.key.isdigit():
            return f"Figure {self.key}"
        words = {"eq": "Equation ", "table": "Table ", "section": "Section "}
        return next(
            word + self.key[len(short) :] for short, word in words.items() if self.key.startswith(short)
        )

    @property
    def run(self) -> Callable[[Settings], FigureOutcome]:
        """The experiment; its module is loaded now."""
        module = importlib.import_module(f"fiberloom.studies.paper.{self.module}")
        run: Callable[[Settings], FigureOutcome] = module.run
        return run


FIGURES: tuple[Figure, ...] = (
    Figure("table1", "Six instruments through one pipeline", "focal_plane.table01_instruments"),
    Figure("section2", "Rules of the design", "focal_plane.section2_design"),
    Figure("5", "Coverage of the focal plane", "focal_plane.fig05_coverage"),
    Figure("10", "Non-linear transmission and backlash", "identification.fig10_transmission"),
    Figure("11", "Break-away torque over a motor turn", "identification.fig11_break_away"),
    Figure("12", "Torque at constant speed", "identification.fig12_drag"),
    Figure("13", "Stiffness of the gears", "identification.fig13_stiffness"),
    Figure("14", "A step of torque, and the inertia", "identification.fig14_inertia"),
    Figure("16", "Tracking of a motor along ramps", "control.fig16_tracking"),
    Figure("eq22", "Collision detection", "control.eq22_collision"),
    Figure("17", "Repeatability of three targets 1 um apart", "control.fig17_repeatability"),
    Figure("18", "Cameras of the bench on a static fibre", "focal_plane.fig18_camera"),
    Figure("19", "Precision iterations", "focal_plane.fig19_iterations"),
    Figure("20", "In-focal-plane calibration", "focal_plane.fig20_focal_plane"),
    Figure("21", "Arm lengths over a lifetime", "lifetime.fig21_arms"),
    Figure("22", "Transmission over a lifetime", "lifetime.fig22_wear"),
    Figure("25", "What the adaptive calibration follows", "lifetime.fig25_adaptive"),
    Figure("26", "Blind error over a lifetime", "lifetime.fig26_blind"),
)


def chosen(keys: Sequence[str], figures: Sequence[Figure] = FIGURES) -> list[Figure]:
    """The figures of these names, in their own order; all for no name."""
    by_key = {figure.key: figure for figure in figures}
    wanted = {_normal(key) for key in keys}
    unknown = sorted(wanted - by_key.keys())
    if unknown:
        raise InputError(f"figure {unknown[0]}: not among {', '.join(by_key)}")
    return [figure for figure in figures if not wanted or figure.key in wanted]


def _normal(key: str) -> str:
    """`Fig16`, `fig16`, `16` and `016` are the same."""
    plain = key.strip().lower().removeprefix("figure").removeprefix("fig").strip(". ")
    return str(int(plain)) if plain.isdigit() else plain
