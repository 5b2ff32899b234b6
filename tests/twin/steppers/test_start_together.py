"""Units that start together: a gateway that is lost between loading and the start moves nobody alone."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.bus.links import PATIENCE_S, Link
from fiberloom.bus.outcome import Outcome
from fiberloom.drive.megara.frames import MegaraCommand
from fiberloom.drive.moons.frames import MoonsCommand, PacketReader, UnitPlace
from fiberloom.drive.moons.maker import leg_of
from fiberloom.drive.moons.waveform import waveform
from fiberloom.drive.steppers import Leg
from fiberloom.drive.steppers.together import line_of
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.steppers.array import StepperArray
from fiberloom.twin.steppers.kinds import KINDS

IDS = [1, 400, 800]
"""One behind each gateway of MOONS."""
FAR = 12000


class Links:
    """A wire over one that breaks where it is told to: `lost` words are not carried, of all or of a line."""

    def __init__(self, wire, line):
        self.wire, self.line = wire, line
        self.links = [Link(f"host:{4700 + k}") for k in range(3)]
        self.down_at = self.deaf_at = None
        """What is sent when a link breaks, or when a line loses a word."""
        self.back_s = np.inf

    @property
    def time_s(self):
        return self.wire.time_s

    def link_of(self, number):
        return self.links[self.line(number)]

    async def receive(self, timeout_s):
        if not self.links[1].up and self.time_s > self.back_s:
            self.links[1].comes_up(self.time_s)
        return await self.wire.receive(timeout_s)

    async def close(self):
        await self.wire.close()

    def carries(self, line, command):
        """Whether a word of this kind comes through; the link breaks by its kind."""
        if command == self.down_at:
            self.links[1].goes_down("pulled out", self.time_s)
        return self.links[line].up and not (line == 1 and command == self.deaf_at)


class GatewayLinks(Links):
    """Three connections, one to each gateway."""

    async def send(self, gateway, data):
        kinds = {frame.data[1] & 0x1F for frame in PacketReader().feed(data)}
        if all(self.carries(gateway, kind) for kind in kinds):
            await self.wire.send(gateway, data)


class BusLinks(Links):
    """Three channels of CAN frames, a robot at each."""

    async def send(self, frames):
        for frame in frames:
            numbers = [frame[0] >> 2] if frame[0] >> 2 else IDS
            for number in numbers:
                if self.carries(self.line(number), frame[1][0]):
                    await self.wire.send([(number << 2 | frame[0] & 3, frame[1])])


class Rig:
    """A unit at each of three lines, homed."""

    def __init__(self, name):
        plane = replace(fl.FocalPlane.of(name, seed=0, n=3), positioner_id=np.array(IDS))
        kind = KINDS[name]
        self.bus, self.name = kind.bus(StepperArray(plane, seed=0, contacts=False)), name
        self.link = kind.link(self.bus, FaultClock(self.bus, (), 0))
        if name == "moons":
            self.wire = GatewayLinks(self.link.gateways, lambda number: UnitPlace.of(number).gateway)
            self.link = type(self.link)(self.wire)
        else:
            self.wire = BusLinks(self.link.transport, IDS.index)
            self.link = type(self.link)(self.wire)
        asyncio.run(self.link.home(IDS))
        self.said = []

    def run(self):
        """All turn alpha far."""
        rows, now = np.arange(3), self.bus.array.counts
        if self.name == "moons":
            steps = waveform(np.array([0.0, 0.125]), np.array([0, FAR]), 0)
            waves = np.zeros((len(steps), 3, 2), dtype=np.int64)
            waves[..., 0] = steps[:, None]
            leg = leg_of(rows, now, waves)
        else:
            goal = now + np.array([FAR, 0])
            leg = Leg(rows, np.array([[0.0] * 3, [40.0] * 3]), np.stack([now, goal]))
        return asyncio.run(self.link.run(IDS, leg, self.said.append))

    @property
    def alpha(self):
        return self.bus.array.counts[:, 0].tolist()


LOAD = {"moons": MoonsCommand.CONFIG_MOTION, "megara": MegaraCommand.GOAL}
START = {"moons": MoonsCommand.EXECUTE, "megara": MegaraCommand.START}
ASKED = {"moons": MoonsCommand.PING, "megara": MegaraCommand.STATE}
BOTH = pytest.mark.parametrize("name", ["moons", "megara"])


@BOTH
def test_with_every_link_up_all_go(name):
    rig = Rig(name)
    assert set(rig.run().values()) == {Outcome.DONE}
    assert rig.alpha == [FAR] * 3
    assert rig.said == []


@BOTH
def test_nobody_starts_where_a_link_is_down_and_it_is_waited_for(name):
    rig = Rig(name)
    begun_s, send = rig.bus.time_s, rig.wire.carries

    def breaks_after_loading(line, command):
        carried = send(line, command)
        if command == LOAD[name] and line == 2:
            rig.wire.links[1].goes_down("pulled out", rig.bus.time_s)
            rig.wire.back_s = rig.bus.time_s + 3.0
        return carried

    rig.wire.carries = breaks_after_loading
    assert list(rig.run().values()) == [Outcome.STOPPED] * 3
    assert rig.alpha == [0] * 3
    assert 3.0 < rig.bus.time_s - begun_s < 5.0
    (text,) = rig.said
    assert "host:4701: down, pulled out" in text
    assert text.endswith("is started")
    rig.wire.carries = send
    assert set(rig.run().values()) == {Outcome.DONE}
    assert rig.alpha == [FAR] * 3


@BOTH
def test_one_that_stays_away_is_named_and_the_others_may_go(name):
    rig = Rig(name)
    begun_s, rig.wire.down_at = rig.bus.time_s, START[name]
    told = rig.run()
    assert [told[n] for n in IDS] == [Outcome.STOPPED, Outcome.DISCONNECTED, Outcome.STOPPED]
    assert rig.bus.time_s - begun_s > PATIENCE_S
    assert all(alpha < FAR for alpha in rig.alpha)
    assert "host:4701" in rig.said[0]
    assert rig.said[0].endswith("has not confirmed its start: all are stopped")


@BOTH
def test_where_the_start_is_lost_at_one_line_the_others_are_held(name):
    """The link is up all the time: units that stand say so themselves."""
    rig = Rig(name)
    rig.wire.deaf_at = START[name]
    told = rig.run()
    assert [told[n] for n in IDS] == [Outcome.STOPPED, Outcome.NOT_STARTED, Outcome.STOPPED]
    assert rig.alpha[1] == 0
    assert 0 <= rig.alpha[0] == rig.alpha[2] < FAR / 4
    assert "host:4701" in rig.said[0]
    rig.wire.deaf_at = None
    rig.said.clear()
    asyncio.run(rig.link.home(IDS))
    assert set(rig.run().values()) == {Outcome.DONE}


@BOTH
def test_a_line_without_a_word_after_the_start_is_one_that_has_not_confirmed_it(name):
    rig = Rig(name)
    begun_s, rig.wire.deaf_at = rig.bus.time_s, ASKED[name]
    told = rig.run()
    assert told[IDS[1]] is Outcome.DISCONNECTED
    assert told[IDS[0]] is Outcome.STOPPED
    assert rig.bus.time_s - begun_s < 5.0  # a way takes longer
    assert all(alpha < FAR for alpha in rig.alpha)


def test_a_line_is_named_by_its_port_or_its_link():
    class Ports:
        def line_of(self, number):
            return "CAN port 2 of host" if number == 1 else ""

        def link_of(self, number):
            return Link("host") if number == 2 else None

    assert [line_of(Ports(), n) for n in (1, 2, 3)] == ["CAN port 2 of host", "host", "the bus"]
