"""MOONS' interlocks: arms that touch or leave their range stop there, say so, and are freed step by step."""

import asyncio

import numpy as np
import pytest

import fiberloom as fl
from fiberloom._core.geometry import segment_distance
from fiberloom.bus.outcome import Outcome
from fiberloom.drive.moons import MoonsLink
from fiberloom.drive.moons.frames import (
    MoonsCommand,
    MoonsError,
    MoonsState,
    PacketReader,
    Segment,
    UnitPlace,
    command_frame,
    decode_answer,
    packed,
    segment_data,
)
from fiberloom.drive.moons.maker import leg_of
from fiberloom.drive.moons.waveform import waveform
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.steppers.array import StepperArray
from fiberloom.twin.steppers.moons import MoonsBus, VirtualGateways

FIELD = fl.FocalPlane.of("moons", seed=0, n=30)
FAR = int(np.argmax(np.hypot(*FIELD.centres_mm.T)))
NEAR = int(np.argsort(np.hypot(*(FIELD.centres_mm - FIELD.centres_mm[0]).T))[1])
PLANE = FIELD.select([0, NEAR, FAR])
IDS = PLANE.positioner_id.tolist()


class Rig:
    """Three units at their datum; those in rows 0 and 1 can meet."""

    def __init__(self):
        self.bus = MoonsBus(StepperArray(PLANE, seed=0))
        self.gateways = VirtualGateways(self.bus, FaultClock(self.bus, [], 0))
        self.link = MoonsLink(self.gateways)
        asyncio.run(self.link.home(IDS))

    def go(self, rows, counts):
        """Outcomes of a waveform of these rows straight to counts (m, 2)."""
        now = self.bus.array.counts[rows]
        ways = [
            [
                waveform(np.array([0.0, 5.0]), np.array([a, b], dtype=float), int(a))
                for a, b in zip(*pair, strict=True)
            ]
            for pair in zip(now, np.array(counts), strict=True)
        ]
        waves = np.zeros((max(len(w) for pair in ways for w in pair), len(rows), 2), dtype=np.int64)
        for k, pair in enumerate(ways):
            for axis, steps in enumerate(pair):
                waves[: len(steps), k, axis] = steps
        leg = leg_of(np.array(rows), now, waves)
        return list(asyncio.run(self.link.run([IDS[row] for row in rows], leg)).values())

    def told(self, row, command, data=b""):
        """The answer of a unit to a command."""
        place = UnitPlace.of(IDS[row])
        out = self.bus.take(place.gateway, packed(command_frame(place, 1, command, data)))
        return decode_answer(next(f for _, stream in out for f in PacketReader().feed(stream)))

    def gap_mm(self):
        """Between the true arms of rows 0 and 1."""
        bodies, at = self.bus.array._bodies, self.bus.array.truth()
        one, other = (bodies.segments_mm(np.array([k]), at[[k]]) for k in (0, 1))
        return float(segment_distance(one, other)[0] - bodies.radius_mm[:2].sum())


def towards(row, other, beta=80.0):
    """Counts that bring an arm, half stretched, towards a neighbour and beside it."""
    way = PLANE.centres_mm[other] - PLANE.centres_mm[row]
    alpha = np.rad2deg(np.arctan2(way[1], way[0]) - PLANE.alpha_off_rad[row]) - 40.0
    alpha = (alpha + 180.0) % 360.0 - 180.0
    return np.rint(
        [(alpha + 180.0) / (360 / 20 / 2050.175633), (beta - 180.0) / (360 / 20 / 1517.662482)]
    ).astype(int)


@pytest.fixture
def met():
    """Two arms that were driven into each other."""
    rig = Rig()
    rig.outcomes = rig.go([0, 1], [towards(0, 1), towards(1, 0)])
    return rig


def test_arms_that_touch_stop_there_and_both_say_so(met):
    assert met.outcomes == [Outcome.COLLIDED, Outcome.COLLIDED]
    assert met.bus.array.contacts() == 1


def test_the_stop_is_where_they_touch_and_the_third_unit_ends_its_way():
    """By the truth of the twin: not before, and not later than 0.2 ms at some 3 mm/s and mm a segment."""
    rig = Rig()
    before = MoonsLink._free
    MoonsLink._free = lambda self, ids, leg: asyncio.sleep(0)  # leave them where they have stopped
    try:
        outcomes = rig.go([0, 1, 2], [towards(0, 1), towards(1, 0), [700, 0]])
    finally:
        MoonsLink._free = before
    assert outcomes == [Outcome.COLLIDED, Outcome.COLLIDED, Outcome.DONE]
    assert rig.bus.array.counts[2].tolist() == [700, 0]
    assert -0.05 < rig.gap_mm() < 0.0 + 1e-9
    for row in (0, 1):
        answer = rig.told(row, MoonsCommand.PING)
        assert (answer.state, answer.error) == (MoonsState.OBSTACLE, MoonsError.COLLISION)
        one = Segment.FIRST | Segment.LAST | Segment.REPLY
        assert (
            rig.told(row, MoonsCommand.CONFIG_MOTION, segment_data((62, 0), one)).error
            is MoonsError.NOT_READY
        )
        assert rig.told(row, MoonsCommand.PROTECT_BETA).error is MoonsError.COLLISION  # still there
        assert rig.told(row, MoonsCommand.FREE_ALPHA).error is MoonsError.NOT_READY  # it is not alpha's limit


def test_a_host_frees_what_has_met_and_the_next_way_leads_out(met):
    assert met.gap_mm() > 0.0
    for row in (0, 1):
        answer = met.told(row, MoonsCommand.PING)
        assert (answer.state, answer.error) == (MoonsState.RESTING, MoonsError.NONE)
    alpha, beta = met.bus.array.counts[0].tolist()  # beta was at its end: alpha has come against the other
    assert met.go([0], [[alpha - 3000, beta]]) == [Outcome.DONE]
    assert met.bus.array.contacts() == 1


def test_a_unit_that_is_met_while_it_stands_stops_too():
    rig = Rig()
    assert rig.go([0], [towards(0, 1, 140.0)]) == [Outcome.DONE]
    assert rig.go([1], [towards(1, 0)]) == [Outcome.COLLIDED]
    assert rig.bus.array.contacts() == 1
    assert rig.told(0, MoonsCommand.PING).error is MoonsError.COLLISION


@pytest.mark.parametrize(("counts", "command"), [((38900, 0), "ALPHA_LIMIT"), ((0, 12800), "BETA_COLLISION")])
def test_a_way_beyond_the_range_ends_at_its_limit(counts, command):
    """159 deg of alpha and 330.4 deg of beta, by the unit's own switches: 38611 and 12681 counts."""
    rig = Rig()
    words, carry = [], rig.bus.run

    def listened(duration_s):
        out = carry(duration_s)
        words.extend(frame.command for _, stream in out for frame in PacketReader().feed(stream))
        return out

    rig.bus.run = listened
    assert rig.go([2], [counts]) == [Outcome.COLLIDED]
    assert words.count(MoonsCommand[command]) == 1
    assert MoonsCommand.MOTION_FINISHED not in words
    # freed by 11 or 10 steps at a time
    low, high = ((38580, 38612), (12650, 12682))[int(counts[1] != 0)]
    assert low < rig.bus.array.counts[2].max() <= high
    assert rig.told(2, MoonsCommand.PING).state is MoonsState.RESTING


def test_a_field_goes_back_to_its_datum_by_the_same_waveform():
    rig = Rig()
    goal = [[9000, -3000], [5000, 2000], [700, -900]]
    assert rig.go([0, 1, 2], goal) == [Outcome.DONE] * 3
    out = rig.bus.array._path.rotor.copy()
    begun_s = rig.bus.time_s
    assert asyncio.run(rig.link.reverse(IDS)) == dict.fromkeys(IDS, Outcome.DONE)
    assert rig.bus.array.counts.tolist() == [[0, 0]] * 3
    np.testing.assert_array_equal(rig.bus.array._path.rotor, out[::-1])
    assert rig.bus.time_s - begun_s < 60.0
    assert rig.bus.array.contacts() == 0
    # and again
    assert rig.told(0, MoonsCommand.REPEAT).state is MoonsState.READY_FORWARD


def test_what_never_ran_cannot_be_reversed():
    rig = Rig()
    assert rig.told(0, MoonsCommand.REVERSE).error is MoonsError.NOT_READY
    assert asyncio.run(rig.link.reverse(IDS)) == dict.fromkeys(IDS, Outcome.REFUSED)
