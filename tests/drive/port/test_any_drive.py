"""Operation with a drive that is not SDSS-V's: nothing reports, motors fall short, one is stuck."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest
from plain_drive import plain_hardware

import fiberloom as fl
from fiberloom.assignment import assign
from fiberloom.calibration.transmission.nominal import nominal_maps
from fiberloom.drive.port import Programme, with_tube
from fiberloom.health.status import FibreStatus
from fiberloom.operation.loop import Loop, LoopSettings
from fiberloom.operation.motion import FieldMotion, UnsafePlanError
from fiberloom.operation.move import Goals
from fiberloom.planning import plan
from fiberloom.studies.paper.no_record import NoRecord
from fiberloom.targets.generate import random_targets

PLANE = fl.FocalPlane.of("sdssv", n=19)


def observed(moves, noise_um=0.0, plane=PLANE, **drive):
    """Loop of so many moves over 19 positioners."""
    hardware = plain_hardware(plane, noise_um, **drive)
    assignment = assign(plane, random_targets(plane, 60, seed=1), seed=1)
    motion = FieldMotion(plane, nominal_maps(plane), hardware, NoRecord())

    async def scenario():
        await motion.connect()
        loop = Loop(motion, assignment, LoopSettings(moves=moves))
        await loop.run()
        await motion.close()
        return loop

    return asyncio.run(scenario()), hardware.drive


def errors_um(loop, drive):
    goal_mm = PLANE.forward(*loop.goal_deg.T)
    at_mm = PLANE.forward(*drive.true_deg.T)
    return 1e3 * np.hypot(*(at_mm - goal_mm).T)[loop.goals.has_target]


@pytest.mark.parametrize("believes", [False, True])
def test_motors_that_fall_short_arrive_by_corrections(believes):
    """By a filter of offsets, or since the drive believes the image: 0.4 % of a long way is 0.2 mm."""
    how = {"short": 0.004, "believes": believes, "blind_um": 300.0}
    blind, drive = observed(1, **how)
    assert np.median(errors_um(blind, drive)) > 50.0
    loop, drive = observed(5, **how)
    assert errors_um(loop, drive).max() < 2.0


def test_one_that_believes_what_it_sees_is_told_the_goal_again():
    loop, drive = observed(3, short=0.1, believes=True)
    last = drive.ran[-1].plan
    asked = loop.goals.has_target
    np.testing.assert_allclose(last.end_deg[asked], loop.goal_deg[asked], atol=1e-6)
    # and the filter of offsets goes beyond it
    loop, drive = observed(3, short=0.1, blind_um=5000.0)
    assert np.abs(drive.ran[-1].plan.end_deg[asked] - loop.goal_deg[asked]).max() > 1.0


def test_a_stuck_one_is_flagged_and_the_others_arrive():
    stuck = int(PLANE.positioner_id[4])
    loop, _ = observed(5, short=0.004, blind_um=300.0, stuck=[stuck])
    status = loop.moves[-1].status
    assert status[4] is FibreStatus.LYING
    others = loop.goals.has_target & (np.arange(19) != 4)
    assert all(status[i] is FibreStatus.ON_TARGET for i in np.flatnonzero(others))


def test_what_is_verified_is_the_programme_with_its_tube():
    """A way that is clear for arms on it is not for arms that may be 2 mm off it."""
    hardware = plain_hardware(PLANE)
    motion = FieldMotion(PLANE, nominal_maps(PLANE), hardware, NoRecord())
    goal = PLANE.park_deg - [0.0, 150.0]
    made = plan(PLANE, PLANE.park_deg, goal)
    goals = Goals.without_targets(PLANE, made.end_deg)

    async def moved(tube_mm):
        await motion.connect()
        await motion.move(1, "blind", Programme(made, tube_mm), goals)

    asyncio.run(moved(None))
    hardware.drive.ran.clear()
    with pytest.raises(UnsafePlanError, match="the verifier refused"):
        motion._verify(Programme(made, np.full(19, 2.0)))
    assert hardware.drive.ran == []
    wide = with_tube(PLANE, np.full(19, 2.0))
    assert wide.handicaps.wider_mm.tolist() == [2.0] * 19
    assert with_tube(PLANE, None) is PLANE


def test_commands_of_sdssv_are_refused():
    hardware = plain_hardware(PLANE)
    motion = FieldMotion(PLANE, nominal_maps(PLANE), hardware, NoRecord())
    with pytest.raises(fl.InputError, match="do not take SDSS-V's commands"):
        _ = motion.client
    with pytest.raises(fl.InputError, match="do not take SDSS-V's commands"):
        _ = hardware.bus


def test_an_error_in_a_move_stops_all():
    hardware = plain_hardware(PLANE)
    drive = hardware.drive
    motion = FieldMotion(PLANE, nominal_maps(PLANE), replace(hardware, drive=drive), NoRecord())

    async def fails(*_):
        raise OSError("no bus")

    async def scenario():
        await motion.connect()
        drive.run = fails
        await motion.go(Goals.without_targets(PLANE, PLANE.park_deg - [0.0, 30.0]))

    with pytest.raises(OSError, match="no bus"):
        asyncio.run(scenario())
    assert drive.stops == 1


class Touching:
    """A truth in which arms have touched three times before, and touch once more in each move."""

    def __init__(self, drive):
        self.drive = drive

    def contacts(self):
        return 3 + len(self.drive.ran)

    def fibre_xy(self, fibre):
        return PLANE.forward(*self.drive.true_deg.T)


def test_contacts_in_the_truth_are_counted_from_the_begin_on():
    hardware = plain_hardware(PLANE)
    hardware = replace(hardware, truth=Touching(hardware.drive))
    motion = FieldMotion(PLANE, nominal_maps(PLANE), hardware, NoRecord())

    async def scenario():
        await motion.connect()
        for beta_deg in (30.0, 60.0):
            await motion.go(Goals.without_targets(PLANE, PLANE.park_deg - [0.0, beta_deg]))

    assert motion.contacts_true == 0
    asyncio.run(scenario())
    assert motion.contacts_true == 2
