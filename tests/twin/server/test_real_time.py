"""The twin against the wall clock: the same bytes as without one, and an honest count of lateness."""

import struct
import threading
import time

import numpy as np
import pytest
from wire import GOTO, STATUS, counts

from fiberloom.bus.identifier import decode, encode
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Fault, Twin, draw_units
from fiberloom.twin.real_time import RealTimeTwin
from fiberloom.units import TICK_S

PLANE = generate(load_instrument("sdssv"), seed=8, n_positioners=3)
UNITS = draw_units(PLANE, seed=2)
IDS = [int(i) for i in PLANE.positioner_id]
GO = [(encode(i, GOTO, 1), struct.pack("<ii", counts(14.0), counts(166.0))) for i in IDS]


def twin():
    return Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False)


class Run:
    """A paced twin for the length of a `with`."""

    def __init__(self, speed, of=None, **kwargs):
        self.real = RealTimeTwin(of or twin(), speed, **kwargs)

    def __enter__(self):
        return self.real

    def __exit__(self, *error):
        self.real.close()

    def wait(self, time_s):
        while self.real.time_s < time_s:
            time.sleep(0.002)


def replies_until(paced, time_s):
    paced.wait(time_s)
    return paced.real.take()


@pytest.mark.clock
def test_the_same_motion_as_in_virtual_time():
    plain = twin()
    plain.run(0.4)
    plain.send(GO)
    expected = plain.run(1.6)
    paced = Run(speed=20.0)
    with paced as real:
        real.post([(identifier, data, 0, 0.4) for identifier, data in GO])
        replies = replies_until(paced, 2.1)
        with real.held() as held:
            truth = held.truth()
    # posted before tick 800 was computed: carried out in that tick, to the last bit
    assert [r.time_s for r in replies] == [r.time_s for r in expected]
    np.testing.assert_array_equal(truth, plain.truth())


def test_each_tick_is_counted_once():
    with (paced := Run(speed=10.0)) as real:
        real.post([(*frame, 0, 0.0) for frame in GO])
        paced.wait(2.0)
        with real.held() as held:
            ticks = round(held.time_s / TICK_S)
            late = real.lateness()
    assert late.ticks + late.resting == ticks
    assert late.ticks > 500  # the moves: 0.5 s each
    assert 0 <= late.kept <= late.ticks
    assert 0.0 < late.p50_ms <= late.p99_ms <= late.worst_ms
    assert sum(late.late_by_cause.values()) == late.ticks - late.kept
    assert all(late.first_by_cause[cause] <= n for cause, n in late.late_by_cause.items())
    assert len(late.late_ticks) == min(sum(late.first_by_cause.values()), 200)
    assert all(tick.late_ms > 0.05 for tick in late.late_ticks)  # a tick lasts so long at ten times the speed


def test_a_clock_that_is_too_quick_for_the_computation_is_late_by_that():
    plane = generate(load_instrument("sdssv"), seed=8, n_positioners=300)
    many = Twin(plane, draw_units(plane, seed=2), seed=1, threads=1, neighbours=False)
    with (paced := Run(speed=100.0, of=many)) as real:  # a tick of 5 us, for 600 axes
        real.post([(encode(int(i), GOTO, 1), GO[0][1], 0, 0.0) for i in plane.positioner_id])
        paced.wait(3.0)
        with real.held():
            late = real.lateness()
    assert late.kept < 0.1 * late.ticks
    assert late.late_by_cause["computed"] + late.late_by_cause["taken"] > 0.8 * late.ticks


def test_while_a_tick_is_held_the_clock_goes_on_and_ticks_are_late():
    with Run(speed=1.0) as real:
        real.post([(*frame, 0, 0.0) for frame in GO])
        time.sleep(0.05)
        with real.held() as held:
            before_s = held.time_s
            time.sleep(0.05)
            assert held.time_s == before_s
        time.sleep(0.05)
        late = real.lateness()
    # the first tick that had to wait waited for the whole hold
    assert late.worst_ms > 45.0
    assert late.kept < late.ticks
    # and so did the others of these 50 ms, which are told apart from it
    assert late.late_by_cause["held"] >= 50
    assert late.first_by_cause["held"] == 1


def test_ticks_are_computed_between_those_who_hold_in_turn():
    """Four who hold for 10 ms each, and overlap all the time: each sees the twin further on."""
    with Run(speed=1.0) as real:
        real.post([(*frame, 0, 0.0) for frame in GO])
        seen, end_s = [], time.monotonic() + 0.5

        def hold_on():
            while time.monotonic() < end_s:
                with real.held() as held:
                    seen.append(held.time_s)
                    time.sleep(0.01)

        threads = [threading.Thread(target=hold_on) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(set(seen)) > 5
    assert len(seen) > 20


def test_one_that_holds_may_hold_once_more():
    with Run(speed=20.0) as real, real.held() as first:
        begin_s = first.time_s
        with real.held() as again:
            assert again.time_s == begin_s
        time.sleep(0.01)
        assert first.time_s == begin_s  # it is held still


@pytest.mark.parametrize("round_", range(4))
def test_who_waits_to_hold_while_the_clock_is_stopped_gets_a_twin_that_stands(round_):
    """The tick under way ends first; half of the rounds saw the twin go on before that was waited for."""
    plane = generate(load_instrument("sdssv"), seed=8, n_positioners=200)  # a tick takes a while
    many = Twin(plane, draw_units(plane, seed=2), seed=1, threads=1, neighbours=False)
    seen, begin = [], threading.Event()

    def hold_on():
        begin.wait()
        with real.held() as held:
            seen.append(held.time_s)
            time.sleep(0.003)
            seen.append(held.time_s)

    with Run(speed=100.0, of=many) as real:
        real.post([(encode(int(i), GOTO, 1), GO[0][1], 0, 0.0) for i in plane.positioner_id])
        thread = threading.Thread(target=hold_on)
        thread.start()
        time.sleep(0.03)
        begin.set()
    thread.join()
    assert seen[0] == seen[1]


def test_a_clock_that_falls_far_behind_is_set_back():
    with Run(speed=1.0) as real:
        with real.held():
            time.sleep(1.1)
        time.sleep(0.02)
        assert real.time_s < 0.9
        until_s = time.monotonic() + 5.0
        while real.lateness().given_up_s < 1.0:  # told some hundredths of a second later
            assert time.monotonic() < until_s
            time.sleep(0.01)


def test_frames_for_a_bus_are_heard_there_only():
    paced = Run(speed=10.0, buses=[0, 1, 1])
    with paced as real:
        real.post([(encode(0, STATUS), b"", 1, 0.0), (encode(IDS[0], STATUS, 5), b"", 1, 0.0)])
        heard = [decode(r.id).positioner for r in replies_until(paced, 0.5)]
    assert sorted(heard) == sorted(IDS[1:])


def test_frames_arrive_in_the_order_of_their_times():
    paced = Run(speed=10.0)
    with paced as real:
        uids = [4, 1, 3, 2]
        # 2 s: the first is due 0.2 s from now, also where a busy machine posts late
        real.post([(encode(IDS[0], STATUS, uid), b"", 0, 2.0 + 0.01 * uid) for uid in uids])
        replies = replies_until(paced, 2.5)
    assert [decode(r.id).uid for r in replies] == [1, 2, 3, 4]
    np.testing.assert_allclose([r.time_s for r in replies], [2.01, 2.02, 2.03, 2.04], atol=2 * TICK_S)


def test_a_fault_put_in_between_two_ticks():
    paced = Run(speed=10.0)
    with paced as real:
        with real.held() as held:
            held.inject(Fault("mute", IDS[0]))
        real.post([(encode(0, STATUS), b"", 0, 0.0)])
        heard = [decode(r.id).positioner for r in replies_until(paced, 0.5)]
    assert sorted(heard) == sorted(IDS[1:])


def test_speeds_out_of_range_are_an_input_error():
    for speed in (0.0, -1.0, 1e3, float("nan")):
        with pytest.raises(InputError, match="speed"):
            RealTimeTwin(twin(), speed)
