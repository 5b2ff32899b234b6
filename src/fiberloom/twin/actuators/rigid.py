"""Arms whose gears do not yield to gravity: where their fibres are, and what has touched."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

import numpy as np

from fiberloom._core import geometry
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import METROLOGY
from fiberloom.instruments.pointing import Pointing
from fiberloom.twin.twin import Touch
from fiberloom.typing import Floats
from fiberloom.units import deg_to_rad


class TrueArms(Protocol):
    """Units as they really are."""

    @property
    def arms(self) -> Floats:
        """(N, 5) true arms, mm and rad: columns of FocalPlane.arms."""
        ...

    @property
    def beta_longer_mm(self) -> Floats:
        """(N,) by which the beta arm is longer than the layout says."""
        ...


class RigidArms(ABC):
    """What cameras and reports ask of a twin: places of fibres, and contacts.

    `plane`: the layout; `units`: the true ones. A twin adds `truth` and notes what touches in `_touches`.
    """

    def __init__(self, plane: FocalPlane, units: TrueArms) -> None:
        self._arms, self._layout = units, plane
        self.pointing = Pointing()
        self._touches: list[Touch] = []
        self._given = 0

    @abstractmethod
    def truth(self) -> Floats:
        """(N, 2) true alpha and beta in deg."""

    def fibre_xy(self, fibre: str = METROLOGY) -> Floats:
        """(N, 2) true places of a fibre in mm. InputError where the layout has none of this name."""
        points = self._layout.points
        if fibre not in points:
            raise InputError(f"fibre '{fibre}': this plane has {', '.join(points)}")
        longer = np.column_stack([self._arms.beta_longer_mm, np.zeros(len(self._layout))])
        at = np.ascontiguousarray(points[fibre] + longer)
        return geometry.forward(self._arms.arms, at, deg_to_rad(self.truth()))

    def point(self, pointing: Pointing) -> None:
        """Points the telescope; gears of such ratios do not yield to gravity here."""
        self.pointing = pointing

    def fibre_xy_at(self, fibre: str, pointing: Pointing) -> Floats:
        """As `fibre_xy`, (N, 2) mm, whatever the `pointing`."""
        return self.fibre_xy(fibre)

    def touches(self) -> list[Touch]:
        """Contacts since the last call: the first moment of each pair in each move."""
        found, self._touches = self._touches, []
        self._given += len(found)
        return found

    def contacts(self) -> int:
        """How many of these there have been so far."""
        return self._given + len(self._touches)
