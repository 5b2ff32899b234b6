"""A recorder for runs of which only the result counts."""

from __future__ import annotations

from fiberloom.metrology import Measurement
from fiberloom.operation.move import Move
from fiberloom.typing import Floats


class NoRecord:
    """Implements `operation.move.Recorder`; the loop keeps its moves itself."""

    def start(self, here_deg: Floats, wire_deg: Floats, image: Measurement) -> None:
        """Not a move."""

    def move(self, move: Move) -> None:
        """Nothing to keep."""

    def left(self, *_: object) -> None:
        """Nothing."""

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """Shows in the moves."""
