"""Adaptive calibration: what it learns, what it must not learn, and how well it knows."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wearing import Wearing, random_goals

from fiberloom.calibration.adaptive import knots as lines
from fiberloom.calibration.adaptive.calibration import AdaptiveCalibration, AdaptiveSettings
from fiberloom.calibration.adaptive.nearest_knot import CommandSigmas, command_covariance, most_probable
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument

PLANE = generate(load_instrument("sdssv"), seed=0, n_positioners=12)
PAPER = AdaptiveSettings(method="paper")


def visit(world, learner, rng, update=True):
    """One random field: true miss (N, 2) in um."""
    goal = random_goals(world.plane, rng)
    wanted = world.plane.forward(*goal.T)
    found = learner.plane.inverse(wanted)
    angles = np.column_stack([found.alpha_deg, found.beta_deg])
    wire = learner.to_wire(angles)
    true, seen = world.arrive(wire)
    if update:
        learner.update(wire, np.where(found.reachable[:, None], seen, np.nan))
    return 1e3 * (true - wanted)[found.reachable]


def rms(misses):
    return np.sqrt((np.concatenate(misses) ** 2).sum(axis=1).mean())


def lifetime(settings_, fields=120, cycles=(0, 5, 10, 20), seed=3):
    """Blind error of the last cycle: learner, the first map kept, maps of every cycle, linear."""
    world = Wearing(PLANE.select(range(6)), seed=seed)
    first = world.calibrated()
    learner = AdaptiveCalibration(world.plane, first, settings_)
    for cycle in cycles:
        world.wear(cycle)
        rng = np.random.default_rng(cycle)
        misses = [visit(world, learner, rng) for _ in range(fields)]
    others = []
    for maps in (first, world.calibrated(), first.linear()):
        rng = np.random.default_rng(cycle)
        frozen = AdaptiveCalibration(world.plane, maps, PAPER)
        others.append(rms([visit(world, frozen, rng, update=False) for _ in range(fields)]))
    return rms(misses), *others


def test_the_filter_is_at_least_as_good_as_calibrating_again():
    learnt, fixed, again, linear = lifetime(AdaptiveSettings())
    print(f"\nimproved {learnt:.2f}, fixed {fixed:.2f}, recalibrated {again:.2f}, linear {linear:.2f} um")
    assert learnt < 1.05 * again
    # it knows some of what 200 points cannot see: 480 fields are 0.6 for each fine knot of alpha
    assert learnt < 0.95 * again
    assert linear > 3.0 * again


def test_the_printed_method_follows_wear_too():
    learnt, fixed, again, _ = lifetime(PAPER)
    print(f"\npaper {learnt:.2f}, fixed {fixed:.2f}, recalibrated {again:.2f} um")
    assert learnt < 1.1 * again


def test_pulls_are_those_of_a_standard_normal():
    """Gears drawn from the prior, so that the filter's own errors must be its standard errors."""
    pulls = []
    for seed in range(4):
        world, learner = prior_world(seed)
        rng = np.random.default_rng([seed, 9])
        for _ in range(60):
            goal = random_goals(PLANE, rng)
            wire = learner.to_wire(goal)
            learner.update(wire, world(wire))
        at = rng.uniform([5.0, 5.0], [355.0, 175.0], (200, PLANE.n, 2))
        for wire in at:
            error = learner.to_output(wire) - world.output(wire)
            pulls.append(error / learner.sigma_deg(wire))
    pull = np.sqrt(np.mean(np.square(pulls), axis=(0, 1)))
    print("\npull rms", pull)
    # 48 maps of some hundred independent values: known to about 1 %; the variances of the ripple
    # are kept without their covariances, which errs on the safe side
    assert (pull > 0.93).all()
    assert (pull < 1.05).all()


class PriorWorld:
    """A gear that is exactly what the filter believes beforehand."""

    def __init__(self, learner, rng):
        self.rng, self.learner = rng, learner
        state = learner.state().filter
        scale = np.sqrt(np.einsum("nii->ni", state.covariance))
        truth = learner.state()
        truth.filter.mean[:] = rng.normal(size=scale.shape) * scale
        truth.filter.ripple_deg[:] = rng.normal(size=state.ripple_deg.shape) * np.sqrt(state.ripple_variance)
        before = learner.state()
        learner.restore(truth)
        self.knots, self.plane = learner.output_deg.copy(), learner.plane
        learner.restore(before)

    def output(self, wire):
        return lines.evaluate(self.learner.wire_deg, self.knots, wire[..., None])[..., 0]

    def __call__(self, wire):
        s = self.learner.settings
        scatter = np.hypot(s.arrival_deg, s.finest_deg)
        theta = self.output(wire) + self.rng.normal(size=wire.shape) * scatter
        xy = self.plane.forward(*theta.T)
        return xy + self.rng.normal(0, 0.669e-3 / np.sqrt(2), xy.shape)


def prior_world(seed):
    # no growth of variances, and ripple small enough that no slope comes near the projection
    given = AdaptiveSettings(wear_deg=0.0, ripple_wear_deg=0.0, arms_wear_um=0.0, ripple_deg=(0.01, 0.01))
    learner = AdaptiveCalibration(PLANE, Wearing(PLANE, seed=seed).calibrated(), given)
    return PriorWorld(learner, np.random.default_rng([seed, 77])), learner


@pytest.mark.parametrize("bend_deg", [0.0, 180.0])
def test_at_a_singular_place_only_what_is_observable_is_learnt(bend_deg):
    world = Wearing(PLANE, seed=1, arms_um=0.0)
    learner = AdaptiveCalibration(PLANE, world.calibrated(), AdaptiveSettings(arms_um=1e-6))
    shape = learner.plane.points["metrology"]
    straight = bend_deg - np.rad2deg(PLANE.arms[:, 4] + np.arctan2(shape[:, 1], shape[:, 0]))
    wire = learner.to_wire(np.column_stack([np.full(PLANE.n, 100.0), straight]))
    theta = learner.to_output(wire)
    before = learner.sigma_deg(wire)
    # the fibre is seen 3 um too far along the radius: no angle explains that
    jacobian = PLANE.jacobian(*theta.T)
    tangent = jacobian[:, :, 0] / np.linalg.norm(jacobian[:, :, 0], axis=1, keepdims=True)
    radial = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    xy = PLANE.forward(*theta.T)
    done = learner.update(wire, xy + 3e-3 * radial)
    np.testing.assert_allclose(done.shift_deg, 0.0, atol=1e-6)
    # across it, both angles share the blame by their variances, and both stay uncertain
    done = learner.update(wire, xy + 3e-3 * tangent)
    assert (np.abs(done.shift_deg) > 1e-4).all()
    moved = PLANE.forward(*learner.to_output(wire).T)
    assert (np.linalg.norm(moved - xy, axis=1) < 3.1e-3).all()
    assert (learner.sigma_deg(wire) > 0.3 * before).all()


def test_dark_fibres_and_wrong_spots_teach_nothing():
    world = Wearing(PLANE, seed=2)
    learner = AdaptiveCalibration(PLANE, world.calibrated())
    goal = random_goals(PLANE, np.random.default_rng(0))
    wire = learner.to_wire(goal)
    _, seen = world.arrive(wire)
    seen[0] = np.nan
    seen[1] += 0.2  # somebody else's spot, within reach
    seen[2] += 5.0  # and one far away
    before = learner.output_deg.copy()
    done = learner.update(wire, seen)
    assert done.used[:, 0].tolist() == [False, False, False] + [True] * (PLANE.n - 3)
    np.testing.assert_array_equal(learner.output_deg[:3], before[:3])
    assert (learner.output_deg[3:] != before[3:]).any(axis=(1, 2)).all()
    assert np.isnan(done.miss_um[0, 0])
    assert done.miss_um[2, 0] == pytest.approx(7071, rel=0.01)


def test_a_broken_tooth_is_followed_from_the_second_image_on():
    world = Wearing(PLANE, seed=2)
    learner = AdaptiveCalibration(PLANE, world.calibrated())
    world.broken[:, 1] = [90.0, 5.0, 0.15]  # over half a tooth pairing
    wire = learner.to_wire(np.tile([120.0, 90.0], (PLANE.n, 1)))
    misses = []
    for _ in range(4):
        _, seen = world.arrive(wire)
        misses.append(learner.update(wire, seen).miss_um[:, 0])
    assert np.median(misses[0]) > 25.0
    assert np.median(misses[2:]) < 3.0


def test_a_slip_moves_the_whole_map():
    world = Wearing(PLANE, seed=2)
    learner = AdaptiveCalibration(PLANE, world.calibrated())
    world.broken[:, 0] = [180.0, 1000.0, 0.2]  # alpha is off everywhere
    rng = np.random.default_rng(1)
    misses = [rms([visit(world, learner, rng)]) for _ in range(12)]
    assert misses[0] > 30.0
    assert np.median(misses[6:]) < 15.0


def test_moves_together_teach_what_they_teach_one_by_one():
    world = Wearing(PLANE, seed=5)
    start, rng = world.calibrated(), np.random.default_rng(0)
    together, apart = (AdaptiveCalibration(PLANE, start) for _ in range(2))
    goal = random_goals(PLANE, rng)
    wire = apart.to_wire(goal)[:, None] + rng.normal(0, 0.01, (PLANE.n, 8, 2))
    seen = np.stack([world.arrive(wire[:, m])[1] for m in range(8)], axis=1)
    seen[3, 4] = np.nan
    together.update(wire, seen)
    for m in range(8):
        apart.update(wire[:, m], seen[:, m])
    at = wire[:, -1]
    # variances without covariances, and one Jacobian for all, make the difference
    apart_by = np.abs(together.to_output(at) - apart.to_output(at))
    assert (apart_by < 2.0 * together.sigma_deg(at)).all()


def test_undo_brings_everything_back():
    world, rng = Wearing(PLANE, seed=5), np.random.default_rng(0)
    for method in (AdaptiveSettings(), PAPER):
        learner = AdaptiveCalibration(PLANE, world.calibrated(), method)
        visit(world, learner, rng)
        kept, maps, arms = learner.state(), learner.output_deg.copy(), learner.plane.arms.copy()
        visit(world, learner, rng)
        assert (learner.output_deg != maps).any()
        learner.restore(kept)
        np.testing.assert_array_equal(learner.output_deg, maps)
        np.testing.assert_array_equal(learner.plane.arms, arms)
        learner.restore(learner.state([3]))
        np.testing.assert_array_equal(learner.output_deg, maps)


def test_arms_are_learnt_with_the_map():
    world = Wearing(PLANE, seed=6)
    learner = AdaptiveCalibration(PLANE, world.calibrated())
    rng = np.random.default_rng(2)
    for _ in range(150):
        visit(world, learner, rng)
    before, after = (np.abs(p.arms[:, :3] - world.true_arms[:, :3]) for p in (PLANE, learner.plane))
    assert np.sqrt((after**2).mean()) < 0.5 * np.sqrt((before**2).mean())
    pull = (learner.plane.arms[:, :3] - world.true_arms[:, :3]) / np.sqrt(
        np.einsum("nii->ni", learner.arms_covariance_mm2)[:, :3]
    )
    assert np.sqrt((pull**2).mean()) < 1.5


def test_to_wire_and_to_output_undo_each_other_and_agree_with_the_maps():
    world, rng = Wearing(PLANE, seed=7), np.random.default_rng(3)
    learner = AdaptiveCalibration(PLANE, world.calibrated())
    visit(world, learner, rng)
    theta = rng.uniform([0.0, 0.0], [360.0, 180.0], (PLANE.n, 2))
    wire = learner.to_wire(theta)
    np.testing.assert_allclose(learner.to_output(wire), theta, atol=1e-10)
    np.testing.assert_allclose(learner.maps.to_wire(theta), wire, atol=1e-10)
    # the other contact is as far away as it was calibrated
    at = [90.0]
    apart = learner.maps.backlash_motor_deg(at) - world.calibrated().backlash_motor_deg(at)
    assert np.abs(apart).max() < 10.0


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["improved", "paper"]))
def test_maps_keep_rising_whatever_is_measured(seed, method):
    rng = np.random.default_rng(seed)
    plane = PLANE.select([0, 1])
    learner = AdaptiveCalibration(plane, Wearing(plane).calibrated(), AdaptiveSettings(method=method))
    for _ in range(6):
        wire = rng.uniform(0.0, [360.0, 180.0], (2, 2))
        xy = plane.forward(*learner.to_output(wire).T) + rng.normal(0, 0.2, (2, 2))
        learner.update(wire, xy)
    assert (np.diff(learner.output_deg, axis=-1) > 0).all()
    assert np.isfinite(learner.sigma_deg(wire)).all()
    _ = learner.maps  # which refuses maps that do not rise


def test_the_nearest_map_that_rises():
    wire = np.arange(6.0)[None, None]
    output = np.array([[[0.0, 1.0, 0.5, 3.0, 4.0, 5.0]]])
    made = lines.rising(output, wire)
    assert (np.diff(made) > 0.0499).all()
    np.testing.assert_allclose(made[0, 0, [0, 3, 4, 5]], [0, 3, 4, 5])
    assert made[0, 0, 1:3].mean() == pytest.approx(0.75)
    assert lines.rising(made, wire) is not made or (np.diff(made) > 0).all()


def test_the_jacobian_covariance_is_that_of_samples_and_the_printed_one_is_not():
    rows, sigmas = np.arange(PLANE.n), CommandSigmas(2.0, 3.0, 0.02, 0.03)
    angles = np.column_stack([np.linspace(0, 330, PLANE.n), np.linspace(10, 170, PLANE.n)])
    rng = np.random.default_rng(0)
    moved = angles[:, None] + rng.normal(size=(PLANE.n, 4000, 2)) * [0.02, 0.03]
    xy = np.stack([PLANE.forward(*moved[:, k].T) for k in range(4000)], axis=1)
    only_angles = CommandSigmas(0.0, 0.0, 0.02, 0.03)
    sampled = np.stack([np.cov(xy[i].T) for i in range(PLANE.n)])
    made = command_covariance(PLANE, angles, only_angles, rows)
    scale = np.einsum("nii->n", made)[:, None, None]
    np.testing.assert_allclose(sampled / scale, made / scale, atol=0.05)  # 4000 samples: 2.2 %
    paper = command_covariance(PLANE, angles, sigmas, rows, printed=True)
    assert np.abs(paper - command_covariance(PLANE, angles, sigmas, rows)).max() > 1e-6


def test_most_probable_is_between_by_the_weights():
    here, there = np.zeros((1, 2)), np.array([[3.0, 0.0]])
    place, spread = most_probable(here, 2.0 * np.eye(2)[None], there, np.eye(2)[None])
    np.testing.assert_allclose(place, [[2.0, 0.0]])
    np.testing.assert_allclose(spread[0], np.eye(2) * 2 / 3)


def test_shapes_that_do_not_fit_are_named():
    learner = AdaptiveCalibration(PLANE, Wearing(PLANE).calibrated())
    with pytest.raises(InputError, match="wire_deg has the shape"):
        learner.update(np.zeros((3, 2)), np.zeros((3, 2)))
