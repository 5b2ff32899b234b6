"""Stops at random times: is every positioner at rest within half a second, is it recorded where?

    python benchmarks/array/stopping.py [--positioners N] [--stops N] [--seed S]

Each time a field of the twin is deployed and the task is cancelled at a random time of the motion, as Ctrl-C
does. Measured in the twin's own truth: the way that any axis still makes later than half a second after the
cancellation, contacts, and whether the record tells the places at which they were left. The next observation
then begins from there.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import fiberloom as fl
from fiberloom.store import Store
from fiberloom.store.run import STOPPED
from fiberloom.targets import random_targets
from fiberloom.twin.source import TwinSource

REST_S = 0.5
AT_REST_DEG = 0.02
"""Arms that have been stopped settle by less."""


class Stopping:
    """A transport that cancels a task at a given time of the twin, and notes where everything is later."""

    def __init__(self, inner: Any, twin: Any) -> None:
        self._inner, self._twin = inner, twin
        self.task: asyncio.Task[Any] | None = None
        self.at_s = np.inf
        self.rest: np.ndarray | None = None

    @property
    def time_s(self) -> float:
        """The twin's clock."""
        return self._inner.time_s

    async def send(self, frames: Any) -> None:
        """Passed on."""
        await self._inner.send(frames)

    async def receive(self, timeout_s: float) -> Any:
        """Passed on, up to the next moment at which something is to be done."""
        frames = await self._inner.receive(min(timeout_s, 0.005))
        if self.task is not None and self.time_s >= self.at_s:
            self.task.cancel()
            self.task = None
        if self.rest is None and self.time_s >= self.at_s + REST_S:
            self.rest = self._twin.truth()
        return frames

    async def close(self) -> None:
        """Passed on."""
        await self._inner.close()


@dataclass(frozen=True)
class Stop:
    """What came of one stop."""

    at_s: float
    later_deg: float
    """Largest way of an axis later than REST_S after the cancellation."""
    contacts: int
    recorded: int
    """Positioners whose place is in the record."""
    next_within: int
    """Positioners on target in the observation that follows."""
    next_assigned: int


async def stop_once(plane: fl.FocalPlane, targets: fl.TargetList, at_s: float, out: Path, seed: int) -> Stop:
    """One observation that is stopped, and the next one."""
    field = fl.Field.twin(plane, seed=seed, camera="noise")
    await field.calibrate()
    source = field.source
    assert isinstance(source, TwinSource)
    hardware = source.hardware
    twin: Any = hardware.truth
    stopping = Stopping(hardware.transport, twin)
    object.__setattr__(hardware, "transport", stopping)
    stopping.at_s = at_s
    stopping.task = asyncio.ensure_future(field.observe(targets, corrections=1, out=out))
    try:
        await stopping.task
        raise AssertionError(f"the observation ended before {at_s} s")
    except asyncio.CancelledError:
        pass
    twin.run(max(0.0, at_s + REST_S - twin.time_s))
    rest_deg = twin.truth() if stopping.rest is None else stopping.rest
    twin.run(2.0)
    later_deg = float(np.abs(twin.truth() - rest_deg).max())
    contacts = len(twin.touches())
    stopping.at_s = np.inf
    seen = await field.observe(targets, corrections=1, out=out)
    summary = seen.summary()
    return Stop(
        at_s,
        later_deg,
        contacts + len(twin.touches()),
        recorded(out),
        summary["n_within_requirement"],
        summary["n_assigned"],
    )


def recorded(out: Path) -> int:
    """Positioners of which the record of the first run tells where they were left."""
    with Store.open(out / "store.sqlite") as store:
        first = store.runs()[0]
        assert first.status == "interrupted", first
        assert STOPPED in store.events(first.id)["kind"].tolist()
        rows = store.measurements(first.id)
        return int((rows["kind"] == STOPPED).sum())


def main() -> int:
    """Exit code 1 where something moved too long, touched, or was not recorded."""
    parser = argparse.ArgumentParser(description="stops at random times")
    parser.add_argument("--positioners", type=int, default=37)
    parser.add_argument("--stops", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    plane = fl.FocalPlane.of("sdssv", n=given.positioners)
    targets = random_targets(plane, 8 * given.positioners, given.seed)
    rng = np.random.default_rng([given.seed, 0x57])
    found = []
    for k in range(given.stops):
        with tempfile.TemporaryDirectory() as folder:
            at_s = float(rng.uniform(1.5, 20.0))
            found.append(asyncio.run(stop_once(plane, targets, at_s, Path(folder), given.seed)))
        print(f"stop {k}: {found[-1]}", file=sys.stderr, flush=True)
    worst = max(f.later_deg for f in found)
    print(f"{given.positioners} positioners, {len(found)} stops at 1.5 to 20 s")
    print(f"largest way of any axis later than {REST_S} s after the stop: {worst:.4f} deg")
    print(f"contacts: {sum(f.contacts for f in found)}")
    print(f"places recorded: {min(f.recorded for f in found)} of {given.positioners} at least")
    within, assigned = sum(f.next_within for f in found), sum(f.next_assigned for f in found)
    print(f"on target in the next observation: {within} of {assigned}")
    bad = worst > AT_REST_DEG or any(f.contacts or f.recorded < given.positioners for f in found)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
