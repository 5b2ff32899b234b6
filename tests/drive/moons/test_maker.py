"""Waveforms of a field: those that take too long are named, and are in no leg."""

from dataclasses import replace

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.drive.moons import WaveformMaker, maker
from fiberloom.drive.port import Wanted
from fiberloom.drive.steppers import AxisSteps, KnownUnits
from fiberloom.drive.steppers.found_arms import FoundArms
from fiberloom.planning import Trajectory
from fiberloom.planning.bodies import travel_rad, travels_rad


@pytest.mark.parametrize("most", [0, 100, 256])
def test_ways_that_are_too_long_are_not_loaded(most, monkeypatch):
    """A controller refuses one that is too long, and nothing starts where one is refused."""
    monkeypatch.setattr(maker, "MOST_SEGMENTS", most)
    plane, n = fl.FocalPlane.of("moons", seed=0, n=8), 8
    here = np.tile(plane.instrument.positioner.park_deg, (n, 1))
    goal = np.column_stack([np.linspace(-150.0, 150.0, n), np.full(n, 170.0)])
    known = KnownUnits.nominal(AxisSteps.of(plane.instrument), n)
    wanted = Wanted(plane, here, goal, np.zeros(n))
    legs, refused = WaveformMaker(3400).legs(wanted, np.ones(n, dtype=bool), np.zeros((n, 2)), known)
    gone = [row for leg in legs for row in leg.rows.tolist()]
    assert sorted([*gone, *refused]) == list(range(n))
    assert {0: 0, 100: 3, 256: n}[most] == len(gone)
    assert all(len(leg.counts) - 1 <= most for leg in legs)
    assert all(why == f"its way takes more than {most} segments" for why in refused.values())


def test_a_goal_beyond_the_units_own_switches_is_named_and_not_loaded():
    """Its zero is 0.3 deg off: what the layout has within the range is for its switch beyond -180.2."""
    plane = fl.FocalPlane.of("moons", seed=0, n=2)
    steps = AxisSteps.of(plane.instrument)
    zeros = np.zeros((2, 2, 2, 1))
    zeros[0, 0] = 0.3
    known = KnownUnits(steps, steps.home_deg[:, None], zeros)
    here = np.tile(plane.instrument.positioner.park_deg, (2, 1))
    wanted = Wanted(plane, here, np.array([[-180.0, 150.0], [-180.0, 150.0]]), np.zeros(2))
    legs, refused = WaveformMaker(3400).legs(wanted, np.ones(2, dtype=bool), np.zeros((2, 2)), known)
    assert refused == {0: "its way is beyond a limit by the unit's own switches"}
    assert [leg.rows.tolist() for leg in legs] == [[1]]


SEVEN = fl.FocalPlane.of("moons", seed=0, n=7)


def legs_of_seven():
    """Of units that all unfold."""
    here = np.tile(SEVEN.instrument.positioner.park_deg, (7, 1))
    goal = np.column_stack([np.linspace(-150.0, 150.0, 7), np.full(7, 170.0)])
    known = KnownUnits.nominal(AxisSteps.of(SEVEN.instrument), 7)
    wanted = Wanted(SEVEN, here, goal, np.zeros(7))
    return WaveformMaker(3400).legs(wanted, np.ones(7, dtype=bool), np.zeros((7, 2)), known)


def test_one_that_cannot_run_its_waveform_stands_in_the_plan_of_the_others(monkeypatch):
    """They were planned as if it moved, and would run into it."""
    real, stood = maker._planned, []

    def planned(wanted, moves):
        stood.append(np.flatnonzero(~moves).tolist())
        return real(wanted, moves)

    def unfit(instrument, steps, before, waves):
        return {3: "a reason"} if len(stood) == 1 else {}

    monkeypatch.setattr(maker, "_planned", planned)
    monkeypatch.setattr(maker, "_unfit", unfit)
    legs, refused = legs_of_seven()
    assert stood == [[], [3]]
    assert refused == {3: "a reason"}
    assert [leg.rows.tolist() for leg in legs] == [[0, 1, 2, 4, 5, 6]]


def test_one_that_a_plan_refuses_and_the_next_does_not_is_not_named(monkeypatch):
    """In the first plan it has no way past one that then stands."""
    real, number, plans = maker._planned, int(SEVEN.positioner_id[2]), []

    def planned(wanted, moves):
        plans.append(real(wanted, moves & (np.arange(7) != 2) if not plans else moves))
        return plans[-1] if len(plans) > 1 else replace(plans[-1], refused={number: "no way"})

    def unfit(instrument, steps, before, waves):
        return {3: "a reason"} if len(plans) == 1 else {}

    monkeypatch.setattr(maker, "_planned", planned)
    monkeypatch.setattr(maker, "_unfit", unfit)
    legs, refused = legs_of_seven()
    gone = [row for leg in legs for row in leg.rows.tolist()]
    assert 2 in gone
    assert sorted([*gone, *refused]) == list(range(7))


def longer_by(more_mm):
    """A unit whose arms were found so much longer than the layout has them."""
    plane = fl.FocalPlane.of("moons", seed=0, n=1)
    steps = AxisSteps.of(plane.instrument)
    arms = FoundArms.of(plane, np.column_stack([plane.arms[:, :3], plane.l_beta_mm]) + more_mm)
    return plane, KnownUnits(steps, steps.home_deg[:, None], np.zeros((1, 2, 2, 1)), arms=arms)


def test_ways_of_alpha_end_at_the_units_own_switches():
    alpha_deg, beta_deg = np.rad2deg(travels_rad(maker._kept_within_limits(SEVEN)))[0]
    np.testing.assert_allclose(alpha_deg, maker.limits_deg(SEVEN.instrument)[0])
    np.testing.assert_allclose(beta_deg, np.rad2deg(travel_rad(SEVEN))[1])


@pytest.mark.parametrize("more_mm", [-0.01, -0.02])
def test_an_arm_that_unfolds_beside_its_limit_keeps_within_it(more_mm):
    """Folded, its fibre is where the layout has it by another alpha, beyond what the unit lets it go to."""
    plane, unit = longer_by(more_mm)
    within = maker._limit_counts(plane.instrument, unit.steps)
    time_s, alpha = np.array([0.0, 4.0, 8.0, 16.0]), np.array([-180.0, -180.0, -180.0, -120.0])
    way = Trajectory(1, time_s, alpha, np.array([180.0, 183.0, 210.0, 240.0]))
    beside = unit.steps.angles_deg(maker._counted(way, unit))[:, 0]
    pair = maker._wave(way, np.zeros(2, dtype=np.int64), unit, within)
    waves = np.stack([np.pad(w, (0, max(map(len, pair)) - len(w))) for w in pair], axis=1)[:, None]
    assert maker._unfit(plane.instrument, unit.steps, np.zeros((1, 2), dtype=np.int64), waves) == {}
    assert beside.min() < -180.2  # it would have been


def test_an_axis_that_is_at_its_goal_waits_there_for_the_other():
    """Arms that were found 0.1 mm longer need other angles of beta wherever alpha is on its way."""
    plane, unit = longer_by(0.1)
    park = plane.instrument.positioner.park_deg
    time_s, alpha = np.array([0.0, 5.0, 10.0, 15.0]), np.array([park[0], -150.0, -80.0, -20.0])
    beta = np.array([park[1], 130.0, 100.0, 100.0])
    within = maker._limit_counts(plane.instrument, unit.steps)
    pair = maker._wave(Trajectory(1, time_s, alpha, beta), np.zeros(2, dtype=np.int64), unit, within)
    assert (pair[0] >= 0).all()
    assert (pair[1] <= 0).all()
    end = np.array([[wave.sum() for wave in pair]])
    off_um = 1e3 * np.hypot(
        *(plane.forward(*unit.true_deg(end, np.ones((1, 2))).T) - plane.forward(-20.0, 100.0)).T
    )
    assert off_um.max() < 4.0  # half a step of each axis, 1.9 and 1.8 um, and the square of 0.1 mm
