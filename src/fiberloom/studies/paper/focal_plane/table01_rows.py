"""Table 1 of Kronig 2020, row by row."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from fiberloom.instruments import load_instrument
from fiberloom.instruments.model import Operation
from fiberloom.units import UM_PER_MM


@dataclass(frozen=True)
class Row:
    """A row of Kronig 2020, Table 1, the preset that stands for it, and what is published of its field."""

    key: str
    name: str
    units: int
    l_alpha_mm: float
    l_beta_mm: float
    pitch_mm: float
    preset: str
    published: str
    why: str = ""
    """Why it misses, where it does."""
    camera: str = "noise"
    """Of the twin: noise, true places with that of the preset, or image, rendered and read again."""

    @functools.cached_property
    def operation(self) -> Operation:
        """What the preset asks for: the one place of each requirement."""
        return load_instrument(self.preset).operation

    @property
    def requirement_um(self) -> float:
        """As Table 1 prints it: a maximum."""
        return self.operation.requirement_um

    @property
    def reach_mm(self) -> float:
        """The longest lever of the alpha axis."""
        return self.l_alpha_mm + self.l_beta_mm

    @property
    def tolerance_mdeg(self) -> float:
        """Error of the alpha axis that uses up the requirement with the arm stretched."""
        return 1e3 * float(np.rad2deg(self.requirement_um / UM_PER_MM / self.reach_mm))


TABLE_1 = (
    Row("lamost", "LAMOST", 4000, 8.25, 8.25, 25.6, "lamost", "at most 40 um; 1 to 2 min", camera="image"),
    Row("megara", "MEGARA", 92, 5.803, 5.803, 20.1, "megara", "64.7 s for a turn of rotor 1"),
    Row(
        "desi",
        "DESI",
        5000,
        3.0,
        3.0,
        10.4,
        "desi",
        "one correction: 54 um rms blind, 6 to 9 measured then; 8 s and 3 s",
        "each move draws another scatter, and the last ones are still being moved",
    ),
    Row("sdssv", "SDSS-V", 500, 7.4, 15.0, 22.4, "sdssv", "90 % within 30 um; 2 to 3 min"),
    Row("moons", "MOONS", 1001, 8.0, 17.0, 25.0, "moons", "20 um asked for; 19.3 s for the range of alpha"),
    Row(
        "cobra",
        "COBRA",
        2400,
        2.375,
        2.375,
        8.0,
        "pfs",
        "92 % within 10 um, median 5 um; 22 s an iteration",
        "motors that scatter by half of each way need more moves, and so do those that pass a neighbour",
    ),
)
