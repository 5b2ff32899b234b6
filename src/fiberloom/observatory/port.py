"""All that a control system sees of an array and may ask of it. OPC UA and EPICS are thin covers of this."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from fiberloom.store.service.alarms import Severity

PERIOD_S = 0.25
"""Between two looks at an array, of whatever shows it."""

BEATS = 1_000_000
"""A heartbeat counts the looks up to this, and begins again."""


@dataclass(frozen=True)
class ArrayAlarm:
    """One alarm; it is there as long as its cause."""

    code: str
    severity: Severity
    subject: str
    """`array`, or `positioner N`."""
    text: str
    advice: str
    """What to do."""

    def __str__(self) -> str:
        return f"{self.code} ({self.subject}): {self.text}; {self.advice}"


@dataclass(frozen=True)
class ArrayView:
    """An array at one time."""

    address: str
    """Of its bus."""
    state: str
    """A `SessionState`."""
    text: str
    """Why it is in that state."""
    owner: str
    """Which process moves it; empty: none."""
    command: str
    """What runs in this process; empty: nothing."""
    positioners: int
    excluded: tuple[int, ...]
    """Numbers of positioners."""
    alarms: tuple[ArrayAlarm, ...]
    """The worst first."""

    @property
    def severity(self) -> Severity | None:
        """Of the worst alarm; None: there is none."""
        return self.alarms[0].severity if self.alarms else None


class ArrayPort(Protocol):
    """An array as a control system has it.

    Methods may be called from any thread. They block for a look at the store; `stop` until all is at rest.
    InputError, in one line, where something is refused. `who` asks, for the record.
    """

    def view(self) -> ArrayView:
        """How it is now. Raises nothing: a store that cannot be read is an alarm."""
        ...

    def stop(self, who: str) -> str:
        """Stops what moves, whichever process moves it; how that went, in words. Always possible."""
        ...

    def park(self, who: str) -> str:
        """Begins to fold all positioners."""
        ...

    def home(self, who: str) -> str:
        """Begins to search all datums."""
        ...

    def recover(self, who: str) -> str:
        """Begins to take arms apart that touch, and unlocks."""
        ...

    def configure(self, who: str, targets: str) -> str:
        """Begins to put fibres on `targets`: the name of a list in the folder of target lists."""
        ...


COMMANDS = ("stop", "park", "home", "recover")
"""Those that need no more than who asks."""
