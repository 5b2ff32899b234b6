"""What a drive of steppers asks of the controllers in front of them, whatever their frames are."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from fiberloom.bus.outcome import Outcome
from fiberloom.drive.steppers.together import Say, unsaid
from fiberloom.typing import Floats, Ints


class UnitTold(NamedTuple):
    """What a unit says of itself."""

    serial: int
    """Number of the unit, not of the place that it is plugged in."""
    homed: bool
    """It has found both its switches since power came on."""
    counts: tuple[int, int]
    """From home, of alpha and beta: it does not know of steps that it lost."""
    moving: bool = False


class Homed(NamedTuple):
    """How a search has ended."""

    found: bool
    slip: tuple[int, int]
    """Counted at the switches of alpha and beta: 0 of a unit that has lost nothing."""


@dataclass(frozen=True, eq=False)
class Leg:
    """Units that start together, each with C corners of its own; counts go straight in between."""

    rows: Ints
    """(m,) of the focal plane."""
    time_s: Floats
    """(C, m) from the start of the leg, never falling, from 0."""
    counts: Ints
    """(C, m, 2) from home."""

    @property
    def duration_s(self) -> float:
        """Until the last one has ended."""
        return float(self.time_s[-1].max(initial=0.0))


class StepperLink(Protocol):
    """Controllers of steppers on a bus, by the numbers of their units."""

    @property
    def time_s(self) -> float:
        """Of the bus."""
        ...

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass, s."""
        ...

    async def ask(self, ids: Iterable[int]) -> dict[int, UnitTold]:
        """What these say of themselves; one that does not answer is missing."""
        ...

    async def run(self, ids: Sequence[int], leg: Leg, say: Say = unsaid) -> dict[int, Outcome]:
        """Moves units `ids` (m,) along a leg and waits for its end; how each has ended.

        Where one of them cannot be started none is, or all stop: `say` is told why.
        """
        ...

    async def home(self, ids: Sequence[int]) -> dict[int, Homed]:
        """Searches the switches of these, beta before alpha; one that does not answer is missing."""
        ...

    async def stop(self) -> None:
        """Brings all to rest."""
        ...

    async def close(self) -> None:
        """Lets go of the bus."""
        ...
