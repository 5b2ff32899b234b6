"""Rules of operation by themselves: the edge of the reach, what the verifier refuses, the survey's arms."""

import asyncio
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fiberloom.calibration.transmission.maps import identity
from fiberloom.drive.port import Programme, verified
from fiberloom.instruments import generate, load_instrument
from fiberloom.operation.correction import CorrectionLoop
from fiberloom.operation.motion import FieldMotion, UnsafePlanError
from fiberloom.operation.survey import FocalPlaneCalibration, SurveySettings, survey
from fiberloom.planning import Plan, Trajectory, plan
from fiberloom.studies.paper.no_record import NoRecord
from fiberloom.twin import draw_units, field_hardware

PLANE = generate(load_instrument("sdssv"), 0, n_positioners=7)
ROWS = np.arange(7)


@pytest.mark.parametrize("beyond_mm", [-5.0, -0.5, -0.01, 0.01, 3.0])
def test_a_command_is_kept_within_the_length_of_the_arms_and_no_farther_in(beyond_mm):
    loop = CorrectionLoop(PLANE, PLANE.park_deg)
    angle = np.linspace(0.0, 6.0, 7)
    out = np.column_stack([np.cos(angle), np.sin(angle)])
    longest_mm = PLANE.l_alpha_mm + PLANE.l_beta_mm
    asked = PLANE.centres_mm + (longest_mm + beyond_mm)[:, None] * out
    got = loop._within_reach(asked, ROWS)
    # a nanometre inside, so that the triangle of the arms can be solved
    wanted = PLANE.centres_mm + (longest_mm + min(beyond_mm, 0.0))[:, None] * out
    np.testing.assert_allclose(got, wanted, atol=2e-6)
    assert (np.hypot(*(got - PLANE.centres_mm).T) < longest_mm).all()


@pytest.mark.parametrize("alpha_deg", [-1.5, 0.5, 200.0, 359.9, 361.5])
def test_a_command_stays_in_the_turn_in_which_the_arm_is(alpha_deg):
    """An image tells angles from 0 to 360 deg only; a little beyond either end is not a turn away."""
    goal = np.tile([alpha_deg + 0.05, 90.0], (7, 1))
    believed = np.tile([alpha_deg, 90.0], (7, 1))
    loop = CorrectionLoop(PLANE, goal, filtered=False)
    next_deg = loop.update(believed, PLANE.forward(*believed.T), np.ones(7, dtype=bool))
    np.testing.assert_allclose(next_deg, goal, atol=1e-6)


def test_a_plan_that_collides_is_refused_and_counted():
    """The first arm straight over its neighbours and back."""
    here = PLANE.park_deg
    robots = [
        Trajectory(int(p), np.zeros(1), a[:1], a[1:]) for p, a in zip(PLANE.positioner_id, here, strict=True)
    ]
    row = int(np.argmin(np.hypot(*PLANE.centres_mm.T)))
    stretched = np.array([here[row], [here[row, 0], 0.0], [here[row, 0] + 350.0, 0.0]])
    robots[row] = Trajectory(robots[row].positioner_id, np.array([0.0, 60.0, 160.0]), *stretched.T)
    spread = here - [0.0, 90.0]
    robots = [r if k == row else Trajectory(r.positioner_id, np.zeros(1), spread[k, :1], spread[k, 1:])
              for k, r in enumerate(robots)]  # fmt: skip
    drive = SimpleNamespace(verify=verified)
    motion = SimpleNamespace(
        state=SimpleNamespace(obstacles=lambda: PLANE), drive=drive, collisions_verified=0
    )
    with pytest.raises(UnsafePlanError, match="the verifier refused"):
        FieldMotion._verify(motion, Programme(Plan("sdssv", PLANE.collision_buffer_mm, tuple(robots))))
    assert motion.collisions_verified > 0
    counted = motion.collisions_verified
    FieldMotion._verify(motion, Programme(plan(PLANE, here, here - [0.0, 20.0])))
    assert motion.collisions_verified == counted


class Stop(Exception):
    """Enough was seen."""


def test_a_survey_moves_arms_that_are_thicker_than_they_are():
    made = []

    def motion(plane, *how):
        made.append(plane)
        raise Stop

    with pytest.raises(Stop):
        asyncio.run(survey(PLANE, None, None, SurveySettings(safety_mm=0.5, motion=motion), None))
    assert made[0].collision_buffer_mm == pytest.approx(PLANE.collision_buffer_mm + 0.5)


def test_a_survey_leaves_none_out_for_a_layout_that_is_not_known_yet():
    """It measures what is wrong there: centres by 0.19 mm, where folded arms may show 0.17 mm else."""
    off = replace(PLANE, arms=PLANE.arms + np.array([0.19, 0.0, 0.0, 0.0, 0.0]))
    maps, hardware = identity(PLANE.positioner_id), field_hardware(PLANE, draw_units(PLANE, 0), 0)
    found = asyncio.run(survey(off, maps, hardware, SurveySettings(configurations=2), NoRecord()))
    assert (np.ptp(found.theta_deg, axis=1).max(axis=1) > 5.0).all()


def test_residuals_of_a_survey_are_summed_up_as_their_rms():
    fit = SimpleNamespace(
        positioner_id=ROWS[:3], reason=("", "", "dark"), ok=np.array([True, True, False]), rank=np.full(3, 9),
        parameters=np.zeros((3, 9)), n_outliers=np.zeros(3, int), rms_um=np.array([1.0, 7.0, 99.0]),
        angles_deg=(0.02, 0.01),
    )  # fmt: skip
    summary = FocalPlaneCalibration(SimpleNamespace(n=3), fit, [], {}, 0.7).summary()
    # of the two that are calibrated: sqrt((1 + 49) / 2)
    assert summary["residual_rms_um"] == pytest.approx(5.0)
    assert summary["refused"] == {2: "dark"}
