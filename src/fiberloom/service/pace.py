"""A twin inside of this process at the speed of a real array: its virtual clock waits for the wall's."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fiberloom.bus.transport import Frame, Transport
from fiberloom.calibration.transmission.sweep import Calibration, Progress
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.operation.source import Doubting, Source
from fiberloom.typing import Floats

SLICE_S = 0.02
"""Between two looks at the clock of the wall, at most."""
_BEHIND_S = 0.1
"""Farther behind than this the clocks are compared anew: a pause is not made up for."""


class PacedTransport:
    """Implements `Transport`: as the one inside, whose clock does not run ahead of the wall's.

    `speed`: virtual seconds a second, asked again at each look.
    """

    def __init__(self, inside: Transport, speed: Callable[[], float]) -> None:
        self._inside, self._speed = inside, speed
        self._kept = speed()
        self._begun_s = self.time_s, time.monotonic()

    @property
    def time_s(self) -> float:
        """Virtual time."""
        return self._inside.time_s

    async def send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> None:
        """Puts frames on the bus now."""
        await self._inside.send(frames)

    async def receive(self, timeout_s: float) -> list[Frame]:
        """As the one inside; takes as long as on the wall clock."""
        end_s = self.time_s + timeout_s
        while True:
            left_s = end_s - self.time_s
            slice_s = SLICE_S * max(self._speed(), 1.0)
            frames = await self._inside.receive(min(left_s, slice_s))
            await self._keep_pace()
            if frames or left_s <= slice_s:
                return frames

    async def _keep_pace(self) -> None:
        virtual_s, wall_s = self._begun_s
        if self._kept != (speed := self._speed()):
            self._kept = speed
            virtual_s, wall_s = self._begun_s = self.time_s, time.monotonic()
        ahead_s = (self.time_s - virtual_s) / speed - (time.monotonic() - wall_s)
        if ahead_s > 0.0:
            await asyncio.sleep(ahead_s)
        elif ahead_s < -_BEHIND_S:
            self._begun_s = self.time_s, time.monotonic()

    async def close(self) -> None:
        """Closes the one inside."""
        await self._inside.close()


class PacedSource:
    """Implements `Source`: a twin whose motions last as long as those of an array, over `speed`.

    `speed`, virtual seconds a second, may be changed at any time.
    """

    def __init__(self, inside: Source, speed: float) -> None:
        self._inside, self.speed = inside, speed

    async def open(self) -> Hardware:
        """As the one inside, with a bus that keeps pace."""
        hardware = await self._inside.open()
        if hardware.transport is None:
            return hardware
        return replace(hardware, transport=PacedTransport(hardware.transport, lambda: self.speed))

    async def sweep(self, points: int, progress: Progress) -> Calibration | None:
        """As the one inside, as quick as the machine is: `points`, `progress`."""
        return await self._inside.sweep(points, progress)

    def maps_file(self, points: int) -> Path | None:
        """As the one inside."""
        return self._inside.maps_file(points)

    def know(self, file: Path) -> None:
        """As the one inside."""
        self._inside.know(file)

    def keep(self, file: Path | None) -> None:
        """As the one inside."""
        self._inside.keep(file)

    def about(self) -> dict[str, Any]:
        """As the one inside."""
        return self._inside.about()

    @property
    def true_plane(self) -> FocalPlane | None:
        """As of the one inside."""
        return self._inside.true_plane


class PacedDoubting(PacedSource):
    """The same of a twin that calibrates its motors before a field. Implements `Doubting`."""

    def __init__(self, inside: Source, doubting: Doubting, speed: float) -> None:
        """`inside` and `doubting` are one; `speed` as of any."""
        super().__init__(inside, speed)
        self._doubting = doubting

    async def doubtful(self, moves: int | None = None) -> dict[int, str]:
        """As the one inside, of so many `moves`."""
        return await self._doubting.doubtful(moves)

    def standing_deg(self) -> Floats:
        """As the one inside."""
        return self._doubting.standing_deg()

    def scatter(self) -> Floats | None:
        """(N, 2), dimensionless: as the one inside; None where it knows none."""
        return self._doubting.scatter()


def paced(inside: Source, speed: float) -> PacedSource:
    """A source `inside` at the pace of an array; `speed`: virtual seconds in 1 s."""
    return (
        PacedDoubting(inside, inside, speed) if isinstance(inside, Doubting) else PacedSource(inside, speed)
    )
