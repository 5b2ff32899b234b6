"""What can be broken in a positioner of the twin: hardware, for the firmware is the real one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from fiberloom.instruments.model import AXES
from fiberloom.twin.faults.kinds import PER_POSITIONER, FaultKind


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
