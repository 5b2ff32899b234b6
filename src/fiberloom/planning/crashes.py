"""Random fields after a collision: for tests, benchmarks and trials of `untangle`."""

from dataclasses import dataclass

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import BODY_SHARE
from fiberloom.planning.bodies import CollisionBodies
from fiberloom.planning.fields import random_configuration
from fiberloom.planning.overlaps import Surroundings
from fiberloom.typing import Floats, Ints
from fiberloom.units import deg_to_rad, rad_to_deg

KINDS = ("buffer", "two arms", "knot", "fiducial", "immobile")
"""Arms closer than the buffer; two arms that touch; three; an arm at a fiducial; two arms, of which the one
that moved can no longer move."""

_PRESSED_MM = 0.3
"""How deep arms that touch are said to be in each other at most: they bend, and angles are not exact."""
_TRIES = 1000
_KNOTS = 20
_STEP_DEG = 0.05


@dataclass(frozen=True, eq=False)
class Crash:
    """A field after a collision."""

    plane: FocalPlane
    """The one that can no longer move is offline in it."""
    start_deg: Floats
    culprits: tuple[int, ...]
    """Rows that moved from a false place, in order."""


def random_crash(plane: FocalPlane, seed: int, kind: str = "two arms") -> Crash:
    """A valid field in which one positioner (or two) moved until it met something.

    Parameters
    ----------
    plane : FocalPlane
        N positioners.
    seed : int
        Of the field, the culprit, and where it moved.
    kind : str
        One of `KINDS`.

    Returns
    -------
    Crash
        The field and (N, 2) angles in deg; gaps of bodies that touch are up to 0.3 mm below contact.

    Raises
    ------
    InputError
        Another kind, or none was found.
    """
    if kind not in KINDS:
        raise InputError(f"random_crash: kind '{kind}': known are {', '.join(KINDS)}")
    field_rad = deg_to_rad(random_configuration(plane, seed))
    driver = _Driver(plane, np.random.default_rng([seed, 0xC4A5]), kind)
    for _ in range(_KNOTS):
        here, culprits = field_rad.copy(), list[int]()
        wanted = 2 if kind == "knot" else 1
        while len(culprits) < wanted and driver.collide(here, culprits):
            pass
        if len(culprits) == wanted:
            break
    else:
        raise InputError(f"random_crash: found no collision of kind '{kind}'")
    start = rad_to_deg(here)
    if kind == "immobile":
        plane = plane.with_offline([int(plane.positioner_id[culprits[0]])], start[culprits[0]][None])
    return Crash(plane, start, tuple(culprits))


class _Driver:
    def __init__(self, plane: FocalPlane, rng: np.random.Generator, kind: str) -> None:
        self.around = Surroundings(plane, CollisionBodies.of(plane))
        self.plane, self.rng, self.kind = plane, rng, kind
        self.low, self.high = deg_to_rad(plane.limits_deg).T

    def collide(self, here_rad: Floats, culprits: list[int]) -> bool:
        """Moves a random positioner straight on until it meets what the kind asks for; False: none does."""
        able = np.flatnonzero(~self.plane.offline & ~np.isin(np.arange(self.plane.n), culprits))
        for _ in range(_TRIES):
            row = int(self.rng.choice(able))
            met, angles = self._drive(row, here_rad)
            if met is not None and self._wanted(met, here_rad, culprits):
                here_rad[row] = angles
                culprits.append(row)
                return True
        return False

    def _wanted(self, met: int, here_rad: Floats, culprits: list[int]) -> bool:
        if (met >= self.plane.n) != (self.kind == "fiducial"):
            return False
        if not culprits:
            return True
        knot = {k for pair in self.around.overlapping(here_rad) for k in pair}
        return met in knot

    def _drive(self, row: int, here_rad: Floats) -> tuple[int | None, Floats]:
        """Straight towards random angles; the first body met, and where."""
        goal = self.rng.uniform(self.low, self.high)
        way = goal - here_rad[row]
        count = int(np.abs(way).max() / deg_to_rad(_STEP_DEG)) + 2
        path = here_rad[row] + np.linspace(0.0, 1.0, count)[:, None] * way
        others = self.around.near[row]
        deep = self.around.gaps_mm(row, path, here_rad, others) - self._contact_mm(others)
        met = np.flatnonzero((deep <= 0.0).any(axis=1))
        if len(met) == 0 or met[0] == 0:
            return None, here_rad[row]
        return int(others[deep[met[0]].argmin()]), path[met[0]]

    def _contact_mm(self, others: Ints) -> Floats:
        """The gap of the buffers at which the drive ends."""
        free = (1.0 - BODY_SHARE) * self.around.bodies.radius_mm
        bodies = np.where(others < self.plane.n, -2.0 * free, -free)
        if self.kind == "buffer":
            return np.asarray(self.rng.uniform(0.05, 1.0) * bodies)
        return np.asarray(bodies - self.rng.uniform(0.0, _PRESSED_MM))
