"""What can be broken in a positioner of the twin: hardware, for the firmware is the real one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from fiberloom.instruments.model import AXES


class FaultKind(StrEnum):
    """Kinds of faults, and what acts."""

    DEAD = "dead"  # no supply at the bridges: the motor does not turn
    LYING = "lying"  # the motor turns, the arm does not follow: the firmware reports arrival
    DARK = "dark"  # the camera does not see the fibre
    STUCK_HALL = "stuck_hall"  # the hall channels repeat what they showed
    BLOCKED = "blocked"  # the rotor cannot turn
    DEAF = "deaf"  # frames to it are lost
    MUTE = "mute"  # frames from it are lost


PER_POSITIONER = frozenset({FaultKind.DARK, FaultKind.DEAF, FaultKind.MUTE})


@dataclass(frozen=True)
class Fault:
    """A fault of one positioner; of both axes unless told."""

    kind: FaultKind | str
    positioner_id: int
    axis: Literal["alpha", "beta"] | None = None

    @property
    def axes(self) -> tuple[int, ...]:
        """0 alpha, 1 beta; one entry where axes make no difference."""
        if FaultKind(self.kind) in PER_POSITIONER:
            return (0,)
        return (0, 1) if self.axis is None else (AXES.index(self.axis),)
