"""A start that comes late over the network: whoever is on its way has not arrived, whatever it counts."""

import asyncio

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.bus.outcome import Outcome
from fiberloom.drive.megara.frames import MegaraCommand, MegaraFrame, command_of
from fiberloom.drive.megara.link import MegaraLink
from fiberloom.drive.steppers.square import SquareMaker
from fiberloom.twin.desi.transport import DesiTransport
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.steppers.array import StepperArray
from fiberloom.twin.steppers.megara import MegaraBus

PLANE = fl.FocalPlane.of("megara", seed=0, n=3)


class LateStart(DesiTransport):
    """Holds the start back for so long, s."""

    late_s = 0.0

    async def send(self, frames):
        if any(command_of(MegaraFrame(*frame)) is MegaraCommand.START for frame in frames):
            self._twin.run(self.late_s)
        await super().send(frames)


@pytest.mark.parametrize("late_s", [0.0, 2.0])
def test_a_move_is_over_when_all_are_still(late_s):
    bus = MegaraBus(StepperArray(PLANE, seed=0))
    transport = LateStart(bus, FaultClock(bus, (), 0))
    link, ids, rows = MegaraLink(transport), PLANE.positioner_id.tolist(), np.arange(3)

    async def move():
        await link.home(ids)
        transport.late_s = late_s
        leg = SquareMaker.of(PLANE.instrument, 0.0).leg(
            rows, np.zeros((3, 2), dtype=np.int64), np.tile([20000, -10000], (3, 1))
        )
        begun_s = link.time_s
        return await link.run(ids, leg), link.time_s - begun_s - leg.duration_s

    told, beyond_s = asyncio.run(move())
    assert set(told.values()) == {Outcome.DONE}
    assert not any(bus.moving(row, axis) for row in rows for axis in (0, 1))
    assert late_s <= beyond_s < late_s + 1.5
