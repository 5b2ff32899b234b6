"""The shutter of the spectrographs: another system's. It opens once for a key, and remembers what it did."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Protocol

from fiberloom.night.clock import NightClock
from fiberloom.operation.safety.writing import beside


@dataclass(frozen=True)
class Exposed:
    """What a shutter knows of an exposure."""

    start: datetime | None = None
    """None: it was never opened for that."""
    end: datetime | None = None
    """None: it is open, or was never opened."""


class Shutter(Protocol):
    """Of the spectrographs."""

    async def start(self, key: str, exposure_s: float) -> None:
        """Opens for `exposure_s` s; a second time for the same `key` does nothing."""
        ...

    async def seen(self, key: str) -> Exposed:
        """What became of the exposure of a `key`."""
        ...


class TimedShutter:
    """A stand-in that opens at once and closes by itself: a timer with a log. Implements `Shutter`.

    The log outlives the process, as a spectrograph does: one line of JSON for each exposure.
    """

    def __init__(self, log: Path, clock: NightClock) -> None:
        """`log`: file, made with the first exposure; `clock`: of the night."""
        self.log, self.clock = log, clock

    async def start(self, key: str, exposure_s: float) -> None:
        """Opens for `exposure_s` s, once for a `key`."""
        if (await self.seen(key)).start is not None:
            return
        line = {"key": key, "utc": self.clock.now().isoformat(), "exposure_s": exposure_s}
        await beside(self._append, json.dumps(line))

    async def seen(self, key: str) -> Exposed:
        """What became of the exposure of a `key`."""
        line = (await beside(self._lines)).get(key)
        if line is None:
            return Exposed()
        start = datetime.fromisoformat(line["utc"])
        end = start + timedelta(seconds=line["exposure_s"])
        return Exposed(start, end if end <= self.clock.now() else None)

    def _append(self, line: str) -> None:
        """A line that was cut short, of a process that was killed or on a full disk, stays alone."""
        with self.log.open("a+b") as log:
            size = log.tell()
            log.seek(max(size - 1, 0))
            begin = b"" if log.read() in (b"", b"\n") else b"\n"
            log.write(begin + line.encode() + b"\n")
            log.flush()
            os.fsync(log.fileno())

    def _lines(self) -> dict[str, dict[str, Any]]:
        if not self.log.exists():
            return {}
        lines = self.log.read_text(encoding="utf-8").splitlines()
        read = [json.loads(line) for line in lines if line.endswith("}")]  # one that was cut short never was
        return {line["key"]: line for line in read}
