"""Keeps the limits of an instrument's `[care]`: moves per time, current, speed in the cold.

Without limits nothing is asked of the bus and nothing waits. Each limit acts before a motion begins. A
verified plan is never stretched or staggered: where a plan would take too much current it is made anew at a
lower speed or in waves, and verified like any other.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from fiberloom.bus.client import Client
from fiberloom.bus.protocol import Command
from fiberloom.drive.sdssv.limits import (
    DEG_S_PER_RPM,
    cold_rule,
    holding_percent,
    motor_speed_rpm,
    temperature_C,
)
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import ColdRule
from fiberloom.planning import Plan, PlanSettings, plan, plan_corrections
from fiberloom.planning.supply import plan_in_waves, plan_within_supply, verify_supply


class MotorCare:
    """Keeps the limits of an instrument's `[care]` in the motions of one field."""

    def __init__(self, plane: FocalPlane, client: Client) -> None:
        self.plane, self.instrument, self.client = plane, plane.instrument, client
        self.rule: ColdRule | None = None
        """The cold rule in force."""
        self.at_C: float | None = None
        """Temperature at the last `refresh`."""
        self._begun_s: dict[int, deque[float]] = {}

    async def refresh(self) -> None:
        """Reads the temperature and sets speeds and holding currents, each time, whatever was set before.

        A positioner that was switched off and on in between has its own speeds again.
        """
        if not self.instrument.care.cold:
            return
        reported = await self.client.command(Command.GET_RAW_TEMPERATURE)
        self.at_C = temperature_C(self.instrument.care, reported)
        self.rule = cold_rule(self.instrument.care, self.at_C)
        await self.client.set_speed(None, self._speed_rpm(0), self._speed_rpm(1))
        await self.client.command(Command.SET_HOLDING_CURRENT, None, *holding_percent(self.rule))

    def _speed_rpm(self, axis: int) -> float:
        return motor_speed_rpm(self.instrument, axis, self.rule)

    def settings(self, share: float = 1.0) -> PlanSettings | None:
        """How to plan at this share of the speed that the temperature allows; None: as ever."""
        if share == 1.0 and self.rule is None:
            return None
        gears = [axis.gear for axis in self.instrument.axes]
        speeds = [DEG_S_PER_RPM * self._speed_rpm(axis) / gears[axis] for axis in range(2)]
        return PlanSettings(speed_deg_s=share * min(speeds))

    async def planned(self, make: Callable[..., Plan], *arguments: Any, **settings: Any) -> Plan:
        """The fastest plan that the temperature allows and the supply can feed, made beside the event loop.

        `make`: a planner, called with `arguments`, `settings` and, where speeds are limited, `settings=` of
        PlanSettings. One that is made by `plan` or `plan_corrections` may be in waves. InputError where the
        supply can feed none.
        """
        await self.refresh()

        def at_share(share: float) -> Plan:
            slower = self.settings(share)
            return make(*arguments, **settings, **({} if slower is None else {"settings": slower}))

        def in_waves(most: int, share: float) -> Plan:
            slower = self.settings(share)
            return plan_in_waves(*arguments, most=most, make=make, **settings, settings=slower)

        waves = in_waves if make in (plan, plan_corrections) else None
        made = await asyncio.to_thread(plan_within_supply, self.instrument, at_share, waves)
        counted = verify_supply(self.plane, made)
        if not counted.ok:
            raise InputError(f"the plan does not keep what the supply gives: {counted}; please report this")
        return made

    def wait_s(self, ids: Iterable[int]) -> float:
        """How long to wait until each of these may begin a move, s."""
        most = self.instrument.care.moves_max
        window_s = self.instrument.care.moves_window_s
        if most is None:
            return 0.0
        full = [b for i in ids if len(b := self._begun_s.get(i, deque())) >= most]
        return max((b[-most] + window_s - self.client.time_s for b in full), default=0.0)

    async def begin(self, ids: Sequence[int], say: Callable[[str], None] = lambda _: None) -> None:
        """Waits until all of these may begin a move, and books it. `say` is told of a wait."""
        most = self.instrument.care.moves_max
        if most is None:
            return
        wait_s = self.wait_s(ids)
        if wait_s > 0.0:
            say(f"waiting {wait_s:.0f} s: at most {most} moves in {self.instrument.care.moves_window_s:g} s")
            await self.client.sleep(wait_s)
        for i in ids:
            self._begun_s.setdefault(i, deque(maxlen=most)).append(self.client.time_s)
