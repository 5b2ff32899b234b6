"""A recorder for benchmarks of arrays."""

from __future__ import annotations

from fiberloom.studies.paper.no_record import NoRecord


class EventsOnly(NoRecord):
    """Keeps what was booked: (kind, positioner, text)."""

    def __init__(self) -> None:
        self.events: list[tuple[str, int | None, str]] = []

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """Something happened."""
        self.events.append((kind, positioner_id, text))

    def lines(self) -> list[str]:
        """Each event as a line."""
        return [f"{kind} {positioner}: {text}" for kind, positioner, text in self.events]
