"""A recorder for runs of which only the result counts."""

from __future__ import annotations

from fiberloom.operation.loop import Move


class NoRecord:
    """Implements `operation.loop.Recorder`; the loop keeps its moves itself."""

    def move(self, move: Move) -> None:
        """Nothing to keep."""

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """Shows in the moves."""
