"""One move of a field: its goals, its result, and the protocol of a recorder."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fiberloom.assignment import Assignment
from fiberloom.bus.outcome import Results
from fiberloom.health.status import FibreStatus
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Measurement
from fiberloom.planning import Plan
from fiberloom.sky.guiding import FieldOffset
from fiberloom.typing import Flags, Floats


@dataclass(frozen=True)
class Goals:
    """Goals of a move. Arrays over N positioners."""

    angles_deg: Floats
    """(N, 2) alpha and beta."""
    approach_deg: Floats
    """(N,) overshoot of the approach on both axes."""
    fibre: NDArray[np.str_]
    """(N,) name of the fibre that goes to the target."""
    has_target: Flags
    """(N,) False: the positioner is only moved out of the way."""
    metrology_mm: Floats | None = None
    """(N, 2) where the camera is to see the metrology fibres with the science fibres on target, as far as
    images have told; None: where it is at these angles."""
    target_mm: Floats | None = None
    """(N, 2) where the targets have gone, as far as is known; None: as in the list."""
    short_mm: Floats | None = None
    """(N, 2) from the fibres at these angles to targets that have gone out of reach; None: none has."""
    star_mm: Floats | None = None
    """(N, 2) where they are in truth, of a twin whose telescope points off; None: there."""
    pointed: FieldOffset | None = None
    """How guide stars have told that the telescope points; None: as it should."""

    @classmethod
    def of(cls, assignment: Assignment) -> Goals:
        """The goals of an assignment."""
        return cls(assignment.goal_deg, assignment.approach_deg, assignment.fibre, assignment.target >= 0)

    def gone(self, target_mm: Floats, angles_deg: Floats, short_mm: Floats) -> Goals:
        """The goals once the targets have gone to (N, 2) mm.

        `angles_deg`, `short_mm` (N, 2): where the fibres shall be then, and what is missing from there.
        """
        return replace(self, target_mm=target_mm, angles_deg=angles_deg, short_mm=short_mm)

    @classmethod
    def without_targets(cls, plane: FocalPlane, angles_deg: Floats) -> Goals:
        """The goals of angles (N, 2) alone, with the instrument's approach."""
        n = plane.n
        approach_deg = np.full(n, plane.instrument.approach_deg)
        return cls(angles_deg, approach_deg, np.full(n, ""), np.zeros(n, dtype=bool))


@dataclass(frozen=True)
class Move:
    """One move of the whole field and the image after it. Arrays over N positioners."""

    number: int
    """1 for the blind move."""
    label: str
    plan: Plan
    commanded_deg: Floats
    """(N, 2) angles at the end of the plan."""
    wire_deg: Floats
    """(N, 2) wire positions reported after the move."""
    measurement: Measurement
    measured_error_um: Floats
    """(N,) distance of the metrology fibre in the image from its goal; NaN without target or light."""
    true_mm: Floats | None
    """(N, 2) the science fibre (metrology fibre where parked), in the middle of the exposure; a twin only."""
    status: list[FibreStatus]
    interrupted: bool = False
    """Stopped before its end, because a positioner collided or did not move."""
    comparison: bool = False
    """Not part of the observation: a move by another model, for comparison."""
    metrology_goal_mm: Floats | None = None
    """(N, 2) where the camera was to see the metrology fibres; None: at the angles of the goals."""
    true_metrology_mm: Floats | None = None
    """(N, 2) the metrology fibre, at the image; a twin only."""
    true_image_mm: Floats | None = None
    """(N, 2) the science fibre at the image; None: as in `true_mm`."""
    true_ends_mm: Floats | None = None
    """(2, N, 2) the science fibre at begin and end of the exposure; None: as in its middle."""
    target_mm: Floats | None = None
    """(N, 2) where the targets were, once they have gone from where the list has them; None: as there."""
    star_mm: Floats | None = None
    """(N, 2) where they were in truth, of a twin whose telescope points off; None: as in `target_mm`."""
    short_mm: Floats | None = None
    """(N, 2) from where the fibres could come to targets that have gone out of reach; None: none has."""
    pointed: FieldOffset | None = None
    """What guide stars have told, and is in `target_mm`; None: nothing."""

    @property
    def motion_s(self) -> float:
        """Duration of the motion."""
        return self.plan.duration_s


@dataclass(frozen=True)
class MadeMove:
    """A move that was made, before its image; as in `Move`."""

    number: int
    label: str
    plan: Plan
    goals: Goals
    comparison: bool
    before_deg: Floats
    """(N, 2) as reported before it."""
    results: Results
    """How it ended on the bus."""


class Recorder(Protocol):
    """Keeps the record of an observation while it runs."""

    def start(self, here_deg: Floats, wire_deg: Floats, image: Measurement) -> None:
        """Called before the first move: reported angles and wire positions (N, 2), and the image."""
        ...

    def move(self, move: Move) -> None:
        """Called after every move, before anything else is done."""
        ...

    def left(self, here_deg: Floats, wire_deg: Floats, answered: Flags, why: str) -> None:
        """Keeps where each was left after a stop.

        `here_deg`, `wire_deg`: (N, 2) angles and wire positions as reported; `answered` (N,): which have;
        `why`: for the operator.
        """
        ...

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """A fault or a remark. `kind`: one word; `text`: for the operator; `positioner_id`: None for all."""
        ...
