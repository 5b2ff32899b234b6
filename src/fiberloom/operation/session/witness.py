"""A witness of a motion: told what begins, what was measured and what went wrong, while it happens."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from fiberloom.metrology import Measurement
from fiberloom.metrology.pipeline import Reduction
from fiberloom.operation.move import Goals, Move, Recorder
from fiberloom.planning import Plan
from fiberloom.typing import Flags, Floats


@dataclass(frozen=True, eq=False)
class BegunMove:
    """A move whose plan is verified, and that is sent to the positioners now."""

    number: int
    """1 for the blind move."""
    label: str
    plan: Plan
    goals: Goals
    clock: Callable[[], float]
    """Time of the bus, s."""


class Witness(Recorder, Protocol):
    """As a recorder, told after the record is written; and of moves when they begin. It must not raise."""

    def begins(self, move: BegunMove) -> None:
        """Called before a verified `move` is sent to the positioners."""
        ...

    def started(self, time_s: float) -> None:
        """Called when positioners are told to go; `time_s`: of the bus."""
        ...

    def image(self, reduction: Reduction) -> None:
        """Called with every image of a camera that takes images, as it was reduced; it is not kept."""
        ...

    def rests(self, angles_deg: Floats) -> None:
        """Called when the store has where all are: `angles_deg` (N, 2), NaN: not known."""
        ...


class WitnessedRecorder:
    """Implements `Recorder`: writes by one, and tells a witness of what is written."""

    def __init__(self, recorder: Recorder, witness: Witness) -> None:
        self._recorder, self._witness = recorder, witness

    def start(self, here_deg: Floats, wire_deg: Floats, image: Measurement) -> None:
        """Where every positioner is before the first move: angles and wire positions (N, 2)."""
        self._recorder.start(here_deg, wire_deg, image)
        self._witness.start(here_deg, wire_deg, image)

    def move(self, move: Move) -> None:
        """A move and its image."""
        self._recorder.move(move)
        self._witness.move(move)

    def left(self, here_deg: Floats, wire_deg: Floats, answered: Flags, why: str) -> None:
        """Where each was left after a stop.

        `here_deg`, `wire_deg`: (N, 2) angles and wire positions as reported; `answered` (N,): which have;
        `why`: for the operator.
        """
        self._recorder.left(here_deg, wire_deg, answered, why)
        self._witness.left(here_deg, wire_deg, answered, why)

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """A fault or a remark."""
        self._recorder.event(kind, text, positioner_id)
        self._witness.event(kind, text, positioner_id)
