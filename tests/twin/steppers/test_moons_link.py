"""The host's side of MOONS' gateways against the controllers of the twin: what is lost, late or left over."""

import asyncio

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.bus.outcome import Outcome
from fiberloom.drive.moons import MoonsLink
from fiberloom.drive.moons.frames import MoonsCommand, UnitPlace, command_frame, packed
from fiberloom.drive.moons.maker import leg_of
from fiberloom.drive.moons.waveform import waveform
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.faults.grammar import parse_faults
from fiberloom.twin.faults.kinds import ServiceKind
from fiberloom.twin.faults.schedule import schedule_faults
from fiberloom.twin.steppers.array import StepperArray
from fiberloom.twin.steppers.bus import FAULTS
from fiberloom.twin.steppers.moons import MoonsBus, VirtualGateways


class Rig:
    """A few units and a link to them."""

    def __init__(self, n=3, faults=""):
        plane = fl.FocalPlane.of("moons", seed=0, n=n)
        self.ids = plane.positioner_id.tolist()
        self.bus = MoonsBus(StepperArray(plane, seed=0, contacts=False))
        due = schedule_faults(parse_faults(faults, FAULTS), self.ids, [], 0)
        self.gateways = VirtualGateways(self.bus, FaultClock(self.bus, due, 0))
        self.link = MoonsLink(self.gateways)

    def home(self):
        return asyncio.run(self.link.home(self.ids))

    def run(self, rows, alpha, link=None):
        """Alpha of units `rows` goes to so many counts."""
        rows = np.array(rows)
        now = self.bus.array.counts[rows]
        steps = waveform(np.array([0.0, 0.125]), np.array([now[0, 0], alpha]), int(now[0, 0]))
        waves = np.zeros((len(steps), len(rows), 2), dtype=np.int64)
        waves[..., 0] = steps[:, None]
        ids = [self.ids[row] for row in rows]
        return asyncio.run((link or self.link).run(ids, leg_of(rows, now, waves)))


def test_a_waveform_that_never_ran_does_not_start_with_the_next_one():
    """Nothing starts where one is silent; the start of the next leg is for all again."""
    rig = Rig()
    rig.home()
    rig.bus.unheard.add(rig.ids[2])
    told = rig.run([0, 1, 2], 2000)
    assert list(told.values()) == [Outcome.STOPPED, Outcome.STOPPED, Outcome.DISCONNECTED]
    assert list(rig.run([0], 1000).values()) == [Outcome.DONE]
    assert rig.bus.array.counts[:, 0].tolist() == [1000, 0, 0]


@pytest.mark.parametrize("alpha", [32000, 38600])
def test_a_new_host_reads_counters_wherever_arms_are(alpha):
    """The end of alpha's range is 38610 counts from its datum: more than 15 bits."""
    rig = Rig()
    rig.home()
    for at in (20000, alpha):
        assert list(rig.run([0, 1], at).values()) == [Outcome.DONE] * 2
    told = asyncio.run(MoonsLink(rig.gateways).ask(rig.ids))
    assert [told[number].counts for number in rig.ids] == [(alpha, 0), (alpha, 0), (0, 0)]


def test_one_that_was_stopped_on_a_long_way_is_where_it_stopped():
    rig = Rig()
    rig.home()
    rig.run([0], 38000)
    rig.bus.array.counts[0, 0] = 700  # as if stopped there
    assert asyncio.run(rig.link.ask(rig.ids))[rig.ids[0]].counts == (700, 0)


def test_lost_words_of_a_search_lose_no_unit():
    rig = Rig(30, "lost=0.1")
    for _ in range(3):
        found = rig.home()
        assert sorted(found) == sorted(rig.ids)
        assert all(one.found for one in found.values())


def test_a_search_that_is_cut_short_leaves_no_datum():
    """Neither while it goes on, for a host that comes in then, nor once it has been stopped."""
    rig = Rig()
    rig.home()
    rig.run([0, 1, 2], 2000)
    for number in rig.ids:
        frame = command_frame(UnitPlace.of(number), 1, MoonsCommand.FIND_DATUM, b"\0")
        rig.bus.take(UnitPlace.of(number).gateway, packed(frame))
    rig.bus.run(0.1)  # beta is there, alpha has 4 s to go
    told = asyncio.run(rig.link.ask(rig.ids))
    assert not any(one.homed for one in told.values())
    asyncio.run(rig.link.stop())
    at_deg = rig.bus.array.truth()
    rig.bus.run(10.0)
    assert np.array_equal(rig.bus.array.truth(), at_deg)
    told = asyncio.run(rig.link.ask(rig.ids))
    assert not any(one.homed or one.moving for one in told.values())
    assert all(one.found for one in rig.home().values())


def test_a_unit_whose_power_comes_back_has_no_datum():
    rig = Rig(2)
    rig.home()
    off = Fault(ServiceKind.BUS_OFF, rig.ids[1])
    rig.bus.inject(off)
    rig.bus.clear(off)
    told = asyncio.run(rig.link.ask(rig.ids))
    assert [told[number].homed for number in rig.ids] == [True, False]
