"""One move of a field: where it should go, what came of it, and who keeps the record."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fiberloom.assignment import Assignment
from fiberloom.health.status import FibreStatus
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Measurement
from fiberloom.planning import Plan
from fiberloom.typing import Flags, Floats


@dataclass(frozen=True)
class Goals:
    """Where the arms should go. Arrays over N positioners."""

    angles_deg: Floats
    """(N, 2) alpha and beta."""
    approach_deg: Floats
    """(N,) overshoot of the approach on both axes."""
    fibre: NDArray[np.str_]
    """(N,) the fibre that looks at a target."""
    has_target: Flags
    """(N,) False: the positioner only has to be out of the way."""

    @classmethod
    def of(cls, assignment: Assignment) -> Goals:
        """The goals of an assignment."""
        return cls(assignment.goal_deg, assignment.approach_deg, assignment.fibre, assignment.target >= 0)

    @classmethod
    def without_targets(cls, plane: FocalPlane, angles_deg: Floats) -> Goals:
        """Angles (N, 2) alone, with the instrument's approach."""
        n = plane.n
        approach_deg = np.full(n, plane.instrument.approach_deg)
        return cls(angles_deg, approach_deg, np.full(n, ""), np.zeros(n, dtype=bool))


@dataclass(frozen=True)
class Move:
    """One move of the whole field and what was seen afterwards. Arrays over N positioners."""

    number: int
    label: str
    plan: Plan
    commanded_deg: Floats
    wire_deg: Floats
    measurement: Measurement
    measured_error_um: Floats
    """Seen minus wanted metrology fibre; NaN without target or light."""
    true_mm: Floats | None
    """The science fibre (metrology fibre where parked); a twin only."""
    status: list[FibreStatus]
    interrupted: bool = False
    """Stopped before its end, because a positioner collided or did not go."""
    comparison: bool = False
    """Not part of the observation: shows what another model would give."""

    @property
    def motion_s(self) -> float:
        """Duration of the motion."""
        return self.plan.duration_s


class Recorder(Protocol):
    """Keeps what happened, as it happens."""

    def start(self, here_deg: Floats, wire_deg: Floats, image: Measurement) -> None:
        """Called before the first move: angles and wire positions reported, and the image."""
        ...

    def move(self, move: Move) -> None:
        """Called after every move, before anything else is done."""
        ...

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """Something an operator wants to know later."""
        ...
