"""Gravity and the camera's frame on the twin: what no map knows, at every attitude of the telescope.

The full physics (`fiberloom.twin.Twin`) holds arms at rest and points the telescope; the statistical twin
arrives where it arrives and takes the way of gravity from there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.design.budget.places import random_goals_deg
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.instruments.pointing import ExposurePointing, Pointing
from fiberloom.twin import StatisticalTwin, Twin, Units
from fiberloom.twin.errors.frame import WrongFrame
from fiberloom.twin.errors.sizes import TwinErrors
from fiberloom.typing import Flags, Floats
from fiberloom.units import UM_PER_MM

ARRAYS = 24
"""Whose fiducials are drawn, for the frame."""
ROTATORS = 6
"""Angles of the rotator for each configuration, drawn."""


class PointedTwin:
    """Positioners at rest in a telescope that points somewhere; a camera looks at them as at a `Twin`."""

    def __init__(self, twin: StatisticalTwin) -> None:
        self.plane: FocalPlane = twin.plane
        self.dark: Flags = twin.dark
        self.pointing = Pointing()
        self._twin = twin

    @property
    def time_s(self) -> float:
        """There is no time here."""
        return 0.0

    def move(self, wire_deg: Floats) -> None:
        """All go to (N, 2) wire positions in deg."""
        self._twin.move(wire_deg)

    def fibre_xy(self, fibre: str = METROLOGY) -> Floats:
        """True position (N, 2) in mm of a fibre, with gravity as the telescope points."""
        here_mm = self._twin.fibre_xy(fibre)
        units = self._twin.units
        if self.pointing.zenith_deg == 0.0 or not units.loaded:
            return here_mm
        return here_mm + fallen_mm(_held(self.plane, units, self._twin.truth()), fibre, self.pointing)


def _held(plane: FocalPlane, units: Units, at_deg: Floats) -> Twin:
    """The full physics with its arms at (N, 2) deg; nothing moves."""
    return Twin(plane, units, neighbours=False, threads=1, start_deg=at_deg)


def fallen_mm(twin: Twin, fibre: str, pointing: Pointing) -> Floats:
    """(N, 2) mm by which gravity moves a `fibre` of a `twin`, from the zenith to a `pointing`."""
    way: Floats = twin.fibre_xy_at(fibre, pointing) - twin.fibre_xy_at(fibre, Pointing())
    return way


@dataclass(frozen=True)
class Sagged:
    """What gravity does at one zenith distance, um rms of the science fibre over places and rotators."""

    zenith_deg: float
    blind_um: float
    """Against maps that were measured in the zenith."""
    turned_um: float
    """From the image to the exposure, by which the rotator has turned."""


def sagged(
    plane: FocalPlane, units: Units, zenith_deg: float, turn_deg: float, configurations: int
) -> Sagged:
    """On the full physics, at rest.

    `plane`, `units`: N positioners; `zenith_deg`: of the telescope, 0 to 90; `turn_deg`: of the rotator from
    image to exposure; `configurations`: random ones, each at six rotators.
    """
    rng = np.random.default_rng([units.seed, 0x6AF1])
    fibre = plane.instrument.science_fibres[0]
    square = []
    for _ in range(configurations):
        twin = _held(plane, units, random_goals_deg(plane, rng))
        for rotator in rng.uniform(0.0, 360.0, ROTATORS):
            pointing = ExposurePointing(Pointing(zenith_deg, float(rotator)), turn_deg)
            image_mm = fallen_mm(twin, fibre, pointing.image)
            exposure_mm = fallen_mm(twin, fibre, pointing.middle)
            square.append([_mean_square(exposure_mm), _mean_square(exposure_mm - image_mm)])
    blind, turned = UM_PER_MM * np.sqrt(np.mean(square, axis=0))
    return Sagged(zenith_deg, float(blind), float(turned))


def frame_alone_um(plane: FocalPlane, errors: TwinErrors, seed: int) -> float:
    """um rms of the science fibre: frames fitted on fiducials whose table is wrong, of 24 arrays.

    `plane`: of N positioners; `errors`: of the table; `seed` of the first array and of the places.
    """
    rng = np.random.default_rng([seed, 0xF4A3])
    fibre = plane.instrument.science_fibres[0]
    square = []
    for array in range(ARRAYS):
        alpha_deg, beta_deg = random_goals_deg(plane, rng).T
        at_mm = plane.forward(alpha_deg, beta_deg, fibre)
        frame = WrongFrame(plane, errors.fiducials_mm(plane, seed + array))
        square.append(_mean_square(frame.seen_mm(at_mm) - at_mm))
    return UM_PER_MM * float(np.sqrt(np.mean(square)))


def _mean_square(way_mm: Floats) -> float:
    return float((way_mm**2).sum(axis=1).mean())
