"""A bench finds what the twin has drawn: axes, arms, zeros and gears of each unit."""

from dataclasses import replace

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.drive.steppers.bench import BenchSettings, calibrate_units
from fiberloom.drive.steppers.found_arms import FoundArms
from fiberloom.instruments.model import METROLOGY
from fiberloom.twin.motors.arrays import source_of
from fiberloom.twin.steppers.array import StepperArray
from fiberloom.twin.steppers.source import TwinBench
from fiberloom.twin.steppers.units import draw_stepper_units

PLANE = fl.FocalPlane.of("moons", seed=3, n=12)


@pytest.fixture(scope="module")
def source():
    return source_of(PLANE, 3, "noise")


def test_the_circles_tell_axes_and_arms_to_a_fraction_of_what_they_are_off(source):
    found, true = source.known.arms.found, source.units
    off_um = 1e3 * (found.arms[:, :3] - true.arms[:, :3])
    layout_um = 1e3 * (PLANE.arms[:, :3] - true.arms[:, :3])
    assert layout_um.std() > 1.0  # drawn with 1.5 um
    # 146 points of 2 um in each of three sweeps; the play of the standing axis moves a circle by some 0.1 um
    assert np.abs(off_um).max() < 0.8
    longer_um = 1e3 * (found.points[METROLOGY] - PLANE.points[METROLOGY])[:, 0]
    assert np.abs(longer_um - 1e3 * true.beta_longer_mm).max() < 0.8


def test_counts_by_the_bench_bring_fibres_to_their_places(source):
    """The truth of the twin at counts of the host: switches of a datum are all that is left."""
    array = StepperArray(PLANE, source.units, seed=9, contacts=False)
    rng = np.random.default_rng(1)
    goal = np.column_stack([rng.uniform(-170, 150, 12), rng.uniform(30, 150, 12)])
    counts = source.known.counts(goal, np.ones((12, 2)))
    true_deg = source.units.output_deg(counts.astype(float), np.ones((12, 2)), array._datum_deg)
    true = source.true_plane.forward(*true_deg.T)
    off_um = 1e3 * np.hypot(*(true - PLANE.forward(*goal.T)).T)
    # 0.008 deg of each axis at 25 and 17 mm, half a step: 5 um rms; by the layout's arms 7
    assert np.sqrt(np.mean(off_um**2)) < 6.5
    told = PLANE.forward(*source.known.true_deg(counts, np.ones((12, 2))).T)
    assert 1e3 * np.hypot(*(told - PLANE.forward(*goal.T)).T).max() < 4.0  # half a step of either axis


@pytest.mark.parametrize(
    ("bench_um", "most_um"),
    [
        # straight lines between 73 points of the gears; by counts that are not whole steps it was 1.4 um
        (0.0, 0.4),
        # 1.4 um across the arm at a point, of alpha over the whole reach; by the alpha arm it was 4.3 um
        (2.0, 2.2),
    ],
)
def test_the_tables_are_off_by_what_the_camera_and_their_points_leave(monkeypatch, bench_um, most_um):
    instrument = PLANE.instrument
    steppers = {**instrument.twin["steppers"], "repeat_deg": 0.0}
    exact = instrument.model_copy(update={"twin": {**instrument.twin, "steppers": steppers}})
    plane = replace(fl.FocalPlane.of("moons", seed=3, n=40), instrument=exact)
    monkeypatch.setattr("fiberloom.twin.steppers.source.BENCH_UM", bench_um)
    units = draw_stepper_units(plane, 3)
    source = source_of(plane, 3, "noise")
    known = calibrate_units(plane, TwinBench(plane, units, 4), BenchSettings(knots=73, sweeps=1))
    rng, datum_deg = np.random.default_rng(2), np.column_stack([s.offset_deg for s in units.switches])
    off_um = []
    for _ in range(25):
        counts = known.counts(
            np.column_stack([rng.uniform(-175, 155, 40), rng.uniform(20, 300, 40)]), np.ones((40, 2))
        )
        true = source.true_plane.forward(
            *units.output_deg(counts.astype(float), np.ones((40, 2)), datum_deg).T
        )
        off_um.append(1e3 * (true - plane.forward(*known.true_deg(counts, np.ones((40, 2))).T)))
    assert np.sqrt(np.mean(np.square(off_um)) * 2.0) < most_um


def test_angles_of_found_arms_and_of_the_layout_are_of_one_place():
    circles = np.column_stack([PLANE.arms[:, :3], np.hypot(*PLANE.points[METROLOGY].T)])
    circles += 1e-3 * np.random.default_rng(5).normal(0.0, 5.0, circles.shape)
    arms = FoundArms.of(PLANE, circles)
    layout = np.column_stack([np.linspace(-170, 150, 12), np.linspace(25, 155, 12)])
    there = arms.arms_deg(layout)
    off_um = 1e3 * np.hypot(*(arms.found.forward(*there.T) - PLANE.forward(*layout.T)).T)
    # damped by (0.003 / 0.04)^2 at 25 deg from stretched, of some 10 um
    assert off_um.max() < 0.1
    plain_um = 1e3 * np.hypot(*(arms.found.forward(*layout.T) - PLANE.forward(*layout.T)).T)
    assert plain_um.max() > 5.0
    np.testing.assert_allclose(arms.layout_deg(there), layout, atol=2e-3)


def test_a_folded_arm_keeps_its_angles_nearly(source):
    """There no angle moves the fibre outwards: what is missing is not made up for by a wild turn."""
    folded = np.tile(PLANE.instrument.positioner.park_deg, (12, 1))
    assert np.abs(source.known.arms.layout_deg(folded) - folded).max() < 0.5


def test_one_that_does_not_turn_keeps_the_arms_of_the_layout_and_is_named():
    class Stuck:
        """A bench whose first unit stands still."""

        def __init__(self, array):
            self.array = array

        def home(self):
            """Nothing."""

        def go(self, counts):
            self.counts = counts

        def look(self):
            counts = self.counts.astype(float).copy()
            counts[0] = 0.0
            return PLANE.forward(*source.units.output_deg(counts, np.ones(counts.shape), 0.0).T)

    source = source_of(PLANE, 3, "noise")
    known = calibrate_units(PLANE, Stuck(source), source.kind.bench)
    assert list(known.why) == [0]
    np.testing.assert_array_equal(known.arms.found.arms[0], PLANE.arms[0])
