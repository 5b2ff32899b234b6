"""A bench: positioners that cannot touch each other, a camera, and weights that are hung on arms.

`Operator` is what every measurement shares: moves that wait for their end, looks, traces, and the book
of which dropped out and why.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from fiberloom import units
from fiberloom.bus.client import Client
from fiberloom.bus.outcome import Results
from fiberloom.bus.protocol import Command
from fiberloom.bus.trace import Trace, push, read_trace, start_trace
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Camera
from fiberloom.typing import Floats, Ints
from fiberloom.units import GEAR, RUN_UP_MOTOR_DEG, motor_to_output_deg

Progress = Callable[[int, int], None]
"""Called with (steps done, steps in all)."""

APPROACH_DEG = motor_to_output_deg(RUN_UP_MOTOR_DEG, GEAR)
"""Larger than the largest backlash: the paper's run-up, as wire position."""
BENCH_MARGIN_DEG = 30
"""Of the collision watch, motor degrees, where a motor runs for long or under a weight."""
_POLL_S = 0.02


class TorqueActuator(Protocol):
    """Applies a known torque to an arm. By hand: a weight on a thread, and a key pressed."""

    tolerance: float
    """Relative standard error of the torques."""

    def apply_torque(self, positioner_id: int, axis: int, torque_mNm: float) -> None:
        """Holds axis 0 (alpha) or 1 (beta) with this torque, positive towards positive angles, until
        the next call; 0 takes it off."""
        ...


class Operator:
    """Moves all positioners that still take part, looks, and keeps the record."""

    def __init__(
        self,
        client: Client,
        camera: Camera | None,
        plane: FocalPlane,
        progress: Progress | None = None,
    ) -> None:
        self.client, self.camera, self.plane = client, camera, plane
        self.trouble = ["offline" if off else "" for off in plane.offline]
        """(N,) why a positioner left; empty for those that stayed."""
        self._row = {int(p): row for row, p in enumerate(plane.positioner_id)}
        self._progress = progress or (lambda done, total: None)
        self._done, self._total = 0, 0
        self._overrun_s = 0.0
        self._wire = np.full((plane.n, 2), np.nan)

    @property
    def ids(self) -> list[int]:
        """Positioners that still take part."""
        return [p for p, row in self._row.items() if not self.trouble[row]]

    @property
    def rows(self) -> Ints:
        """Their rows."""
        return np.array([self._row[p] for p in self.ids], dtype=np.int64)

    def expect(self, steps: int) -> None:
        """So many steps are to come."""
        self._total += steps

    def step(self) -> None:
        """One of them is done."""
        self._done += 1
        self._progress(self._done, self._total)

    def _book(self, results: Results) -> None:
        for positioner, result in results.failed.items():
            self.trouble[self._row[positioner]] = str(result).partition(": ")[2]

    async def prepare(self, rpm: float = 2000.0) -> None:
        """No approach of their own, and one speed for all."""
        self._book(await self.client.set_precise_moves(self.ids, on=False))
        await self.speed(rpm, rpm)

    async def margin(self, motor_deg: int) -> None:
        """Widens what counts as a collision: 0 as in operation. On a bench nothing is in the way, and
        loads that are put on for measurement must not count as a collision."""
        self._book(await self.client.command(Command.SET_INCREASE_COLLISION_MARGIN, self.ids, motor_deg))

    async def speed(self, alpha_rpm: float, beta_rpm: float) -> None:
        """Of the moves from now on."""
        self._book(await self.client.set_speed(self.ids, alpha_rpm, beta_rpm))

    async def goto(self, alpha_deg: ArrayLike, beta_deg: ArrayLike) -> None:
        """To wire positions, one for all or (N,) each its own, and waits for the end."""
        goal = np.column_stack(
            [np.broadcast_to(np.asarray(a, dtype=np.float64), self.plane.n) for a in (alpha_deg, beta_deg)]
        )
        rows = self.rows
        begun = await self.client.goto(self.ids, goal[rows, 0], goal[rows, 1])
        self._book(begun)
        self._wire[rows] = goal[rows]
        begun_s = self.client.time_s
        estimate_s = float(begun.values_array(2).max(initial=0)) * units.TICK_S
        await self._wait(begun.ok_ids, estimate_s)
        overrun_s = self.client.time_s - begun_s - estimate_s
        self._overrun_s = min(max(overrun_s - _POLL_S, 0.0), 1.0)

    async def _wait(self, ids: list[int], estimate_s: float) -> None:
        self._book(
            await self.client.wait_until_done(
                ids,
                timeout_s=estimate_s + 10.0,
                expected_s=estimate_s + self._overrun_s,
                poll_s=_POLL_S,
                stop_on_collision=False,
            )
        )

    async def approach(self, alpha_deg: ArrayLike, beta_deg: ArrayLike) -> None:
        """To wire positions from above, as every final approach of an observation."""
        await self.goto(
            np.asarray(alpha_deg, dtype=np.float64) + APPROACH_DEG,
            np.asarray(beta_deg, dtype=np.float64) + APPROACH_DEG,
        )
        await self.goto(alpha_deg, beta_deg)

    async def push(
        self, axis: int, voltages: tuple[float | None, float | None], times_s: tuple[float, float]
    ) -> None:
        """A torque step of one axis, to its end: two `voltages` as shares of the full one, None for the
        open bridge, for `times_s` each.
        """
        begun = await push(self.client, self.ids, axis, voltages, times_s)
        self._book(begun)
        await self._wait(begun.ok_ids, sum(times_s))

    async def trace(self, period_s: float) -> None:
        """Record from now on."""
        self._book(await start_trace(self.client, self.ids, period_s))

    async def take(self, axis: int) -> Trace:
        """What was recorded, a row for each positioner of the plane."""
        return _all_rows(await read_trace(self.client, self.ids, axis), self.rows, self.plane)

    def look(self, images: int = 1) -> Floats:
        """(N, 2) mean of so many images in mm; NaN where not seen in each, or not taking part."""
        assert self.camera is not None
        seen = [self.camera.measure() for _ in range(images)]
        every = np.all([m.seen for m in seen], axis=0) & np.array([not t for t in self.trouble])
        xy = np.mean([np.where(m.seen[:, None], m.xy_mm, 0.0) for m in seen], axis=0)
        return np.where(every[:, None], xy, np.nan)


def _all_rows(trace: Trace, rows: Ints, plane: FocalPlane) -> Trace:
    motor, voltage = (np.full((plane.n, trace.motor_deg.shape[1]), np.nan) for _ in range(2))
    zero = np.full(plane.n, np.nan)
    motor[rows], voltage[rows], zero[rows] = trace.motor_deg, trace.voltage, trace.zero_deg
    return Trace(plane.positioner_id, motor, voltage, trace.period_s, zero)


def joined(trouble: list[str], *reasons: list[str]) -> list[str]:
    """Row by row the first that says something."""
    return [next((r for r in each if r), "") for each in zip(trouble, *reasons, strict=True)]
