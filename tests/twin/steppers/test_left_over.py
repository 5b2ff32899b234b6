"""Steppers as hosts leave them that were killed or lost a unit: goals that wait, searches, a trial."""

import asyncio

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.drive.megara.frames import MegaraCommand, MegaraFrame, goal_frames
from fiberloom.drive.steppers import AxisSteps, KnownUnits, Leg, StepperDrive
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.steppers.array import StepperArray
from fiberloom.twin.steppers.kinds import KINDS


class Rig:
    """A few units, a link and a drive."""

    def __init__(self, name, n=4):
        plane, kind = fl.FocalPlane.of(name, seed=0, n=n), KINDS[name]
        self.ids = plane.positioner_id.tolist()
        self.bus = kind.bus(StepperArray(plane, seed=0, contacts=False))
        self.link = kind.link(self.bus, FaultClock(self.bus, (), 0))
        known = KnownUnits.nominal(AxisSteps.of(plane.instrument), n)
        self.drive = StepperDrive(plane, self.link, known, kind.maker(plane.instrument))

    def alpha(self, row, to):
        """Alpha of a unit goes to so many counts."""
        now = self.bus.array.counts[row]
        time_s = np.array([[0.0], [10.0]])
        leg = Leg(np.array([row]), time_s, np.array([[now], [[to, now[1]]]]))
        return asyncio.run(self.link.run([self.ids[row]], leg))


def test_a_goal_that_was_never_started_does_not_go_with_the_next_one():
    rig = Rig("megara")
    asyncio.run(rig.drive.connect())
    rig.bus.send(goal_frames({rig.ids[1]: (5000, 0)}))
    rig.alpha(0, 3000)
    assert rig.bus.array.counts[:, 0].tolist() == [3000, 0, 0, 0]


def test_a_host_that_finds_searches_going_on_stops_them_and_searches_again():
    rig, said = Rig("megara"), []
    asyncio.run(rig.drive.connect())
    rig.alpha(1, 30000)
    rig.bus.send([MegaraFrame.of(rig.ids[1], 1, MegaraCommand.HOME)])
    rig.bus.run(1.0)
    asyncio.run(rig.drive.rest(said.append))
    assert said == ["1 positioners were still moving at the begin; all are stopped"]
    told = asyncio.run(rig.link.ask(rig.ids))
    assert [(told[number].homed, told[number].counts) for number in rig.ids] == [(True, (0, 0))] * 4
    assert np.abs(rig.bus.array.truth()[:, 0]).max() < 1.5  # at the switches


@pytest.mark.parametrize("name", ["megara", "moons"])
def test_the_trial_finds_weak_motors_though_another_unit_falls_silent_before_it(name, monkeypatch):
    rig = Rig(name)
    rig.bus.inject(Fault("slipping", rig.ids[1]))
    home = rig.drive.home

    async def then_one_is_silent(ids):
        results = await home(ids)
        rig.bus.unheard.add(rig.ids[3])
        return results

    monkeypatch.setattr(rig.drive, "home", then_one_is_silent)
    asyncio.run(rig.drive.connect())
    assert set(rig.drive.suspects()) == {rig.ids[1], rig.ids[3]}
    assert "loses steps" in rig.drive.suspects()[rig.ids[1]].why


def test_one_that_still_moves_after_a_move_that_went_wrong_is_stopped():
    rig = Rig("megara")
    asyncio.run(rig.drive.connect())
    rig.bus.send(goal_frames({rig.ids[2]: (40000, 0)}))
    rig.bus.send([MegaraFrame.of(0, 0, MegaraCommand.START)])
    rig.bus.run(2.0)
    asyncio.run(rig.drive.settle(rig.ids))
    at = rig.bus.array.counts[2, 0]
    assert 0 < at < 40000
    assert rig.drive.counts[2, 0] == at
    assert not rig.bus.moving(2, 0)
