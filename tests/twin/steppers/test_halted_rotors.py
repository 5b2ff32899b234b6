"""Motors that are halted on their way stand where they are, from that moment on."""

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.drive.megara.frames import MegaraCommand, MegaraFrame, goal_frames
from fiberloom.twin.steppers.array import StepperArray
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
