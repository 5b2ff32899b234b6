"""Motors that are halted on their way stand where they are, from that moment on."""

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.drive.megara.frames import MegaraCommand, MegaraFrame, goal_frames
from fiberloom.twin.steppers.array import CountPath, StepperArray
from fiberloom.twin.steppers.interlocks import Interlocks
from fiberloom.twin.steppers.megara import MegaraBus

PLANE = fl.FocalPlane.of("megara", seed=0, n=3)
GOALS = dict.fromkeys(PLANE.positioner_id.tolist(), (20000, -10000))


def going():
    """A bus whose three robots are at home, and set out."""
    bus = MegaraBus(StepperArray(PLANE, seed=0))
    for rotor in (2, 1):
        bus.send([MegaraFrame.of(0, rotor, MegaraCommand.HOME)])
        bus.run(100.0)
    start(bus)
    return bus


def start(bus):
    bus.send([*goal_frames(GOALS), MegaraFrame.of(0, 0, MegaraCommand.START)])


@pytest.mark.parametrize("after_s", [0.3, 1.7, 4.0])
def test_they_stand_at_once(after_s):
    bus = going()
    bus.run(after_s)
    before_deg = bus.array.truth()
    bus.send([MegaraFrame.of(0, 0, MegaraCommand.STOP)])
    np.testing.assert_allclose(bus.array.truth(), before_deg, atol=1e-9)
    for _ in range(3):
        bus.run(1.3)
        np.testing.assert_allclose(bus.array.truth(), before_deg, atol=1e-9)


def test_what_is_started_again_at_once_comes_to_the_same_place():
    smooth, halted = going(), going()
    halted.run(2.0)
    halted.send([MegaraFrame.of(0, 0, MegaraCommand.STOP)])
    start(halted)
    for bus in (smooth, halted):
        bus.run(100.0)
        assert (bus.array.counts == [20000, -10000]).all()
    one_step_deg = np.abs(smooth.array.units.steps.step_deg)
    off_deg = np.abs(smooth.array.truth() - halted.array.truth())
    assert (off_deg <= one_step_deg).all()  # counts are whole, where a rotor stops need not be


@pytest.mark.parametrize("after_s", [0.0, 1.7])
def test_one_after_the_other_at_one_moment(after_s):
    bus = going()
    bus.run(after_s)
    before_deg = bus.array.truth()
    first, *others = PLANE.positioner_id.tolist()
    for address in (first, *others, first):
        bus.send([MegaraFrame.of(address, 0, MegaraCommand.STOP)])
    bus.run(100.0)
    np.testing.assert_allclose(bus.array.truth(), before_deg, atol=1e-9)


def passing(array):
    """The second arm comes to where the first has just left. All numbers in s, deg and counts."""
    array.now = 0.0
    array.clock = lambda: array.now
    corners_deg = np.array(
        [[[0, 180], [0, 0]], [[90, 180], [0, 0]], [[120, 180], [180, 0]], [[120, 180], [180, 180]]]
    )
    counts = np.rint(corners_deg / array.units.steps.step_deg)
    home = np.zeros((1, 1, 2))
    array.go(CountPath(np.array([0]), np.array([[0.0], [100.0]]), np.vstack([home, counts[:1, :1]])))
    array.now = 100.0
    time_s = np.repeat([[0.0], [30.0], [60.0], [100.0]], 2, axis=1)
    array.go(CountPath(np.array([0, 1]), time_s, counts))
    return array


def test_those_that_go_on_touch_what_was_halted_before_them():
    plane = fl.FocalPlane.of("megara", seed=0, n=7)
    array = passing(StepperArray(plane, seed=0))
    assert array.contacts() == 0
    array.now = 105.0
    array.halt(np.array([0]))
    (touch,) = array.touches()
    first, second = plane.positioner_id[:2].tolist()
    assert (touch.time_s, touch.positioner_id, touch.other) == (100.0, first, second)
    array.now = 110.0
    array.halt(np.array([0]))
    assert (array.touches(), array.contacts()) == ([], 1)  # told once


def test_what_is_halted_before_it_touches_has_not_touched():
    array = passing(StepperArray(fl.FocalPlane.of("megara", seed=0, n=7), seed=0))
    array.now = 105.0
    array.halt(np.array([0]))
    assert array.contacts() == 1
    array.halt(np.array([1]))
    assert array.contacts() == 0


def test_an_interlock_stops_those_that_run_into_what_was_halted():
    array = StepperArray(fl.FocalPlane.of("megara", seed=0, n=7), seed=0)
    array.interlocks = Interlocks(array._bodies, array._pairs, np.array([[-1e3, 1e3]] * 2))
    passing(array)
    assert array.stops() == []
    array.now = 105.0
    array.halt(np.array([0]))
    (stop,) = array.stops()
    assert stop.rows == (0, 1)
    assert 160.0 < stop.time_s < 200.0
    array.now = stop.time_s
    there_deg = array.truth()[:2]
    array.now = 250.0
    np.testing.assert_allclose(array.truth()[:2], there_deg, atol=1e-9)
    array.halt(np.array([0]))
    assert array.stops() == []
