"""Corrections settle where the arithmetic of their noise says, also where beta is singular."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom.instruments import generate, load_instrument
from fiberloom.operation.correction import CorrectionLoop, CorrectionNoise, Offsets, weigh
from fiberloom.operation.loop import Loop

CAMERA_UM, REPEAT_UM, BLIND_UM = 0.669, 0.2, 10.0
PLANE = generate(load_instrument("sdssv"), seed=0)


def isotropic(rng, rms_um, n):
    """Errors (n, 2) in mm of this 2-D rms."""
    return rng.normal(0.0, rms_um * 1e-3 / np.sqrt(2), (n, 2))


def observe(goal_deg, moves, filtered, seed, loop=None, jump=None):
    """True and measured errors (moves, N) in um of a field whose angles are off by an offset."""
    rng = np.random.default_rng(seed)
    # the gears of these fields are perfect: the offset is the same wherever the arms are
    loop = loop or CorrectionLoop(PLANE, goal_deg, filtered=filtered, noise=CorrectionNoise(slope=0.0))
    offset = rng.normal(size=(PLANE.n, 2)) * np.sqrt(np.einsum("nii->ni", loop._spread(BLIND_UM)))
    everyone = np.ones(PLANE.n, dtype=bool)
    command, true, measured = goal_deg, [], []
    for move in range(moves):
        if jump is not None and move == jump[0]:
            offset = offset + jump[1]
        xy = PLANE.forward(*(command + offset).T) + isotropic(rng, REPEAT_UM, PLANE.n)
        seen = xy + isotropic(rng, CAMERA_UM, PLANE.n)
        true.append(np.hypot(*(xy - loop.target_mm).T) * 1e3)
        measured.append(np.hypot(*(seen - loop.target_mm).T) * 1e3)
        command = loop.update(command, seen, everyone)
    return np.array(true), np.array(measured), command


def goals(seed=1):
    rng = np.random.default_rng(seed)
    return rng.uniform([10.0, 20.0], [350.0, 160.0], (PLANE.n, 2))


def rms(errors_um):
    return np.sqrt((errors_um**2).mean(axis=-1))


def several(filtered, moves=6, goal_deg=None):
    """rms over four fields of 500: known to 1.1 % (4000 Gaussian numbers)."""
    fields = [observe(goals(s) if goal_deg is None else goal_deg, moves, filtered, s) for s in range(4)]
    return [rms(np.concatenate([f[k] for f in fields], axis=1)) for k in (0, 1)]


def test_the_plain_update_settles_at_the_cameras_noise():
    true, measured = several(filtered=False)
    print("\nplain    true", true.round(3), "measured", measured.round(3))
    # r_true = target - (n_i + e_i) + e_(i+1): camera once, repeatability twice
    np.testing.assert_allclose(true[1:], np.hypot(CAMERA_UM, np.sqrt(2) * REPEAT_UM), rtol=0.04)
    np.testing.assert_allclose(measured[1:], np.sqrt(2) * np.hypot(CAMERA_UM, REPEAT_UM), rtol=0.04)
    assert true[0] == pytest.approx(BLIND_UM, rel=0.2)


def rippled(slope, size_deg, order=200):
    """True errors (N,) in um after two corrections with gears that ripple so many times a turn, steeply."""
    goal = goals(7)
    rng = np.random.default_rng(7)
    phase = rng.uniform(0, 2 * np.pi, (PLANE.n, 2))
    loop = CorrectionLoop(PLANE, goal, noise=CorrectionNoise(slope=slope))
    command = goal
    for move in range(3):
        xy = PLANE.forward(*(command + size_deg * np.sin(np.deg2rad(order * command) + phase)).T)
        if move < 2:
            seen = xy + isotropic(rng, CAMERA_UM, PLANE.n)
            command = loop.update(command, seen, np.ones(PLANE.n, dtype=bool))
    return np.hypot(*(xy - loop.target_mm).T) * 1e3


def test_a_gear_with_a_slope_is_met_by_trusting_old_images_less():
    # 0.06 deg * 200 = 0.21 rad/rad at its steepest: the way of a correction changes the offset
    assert rms(rippled(0.1, 0.06)) < 0.9 * rms(rippled(0.0, 0.06))


def test_the_slope_of_a_steep_gear_is_learnt_by_the_first_correction():
    # 0.08 deg * 204 = 0.28 rad/rad: a tenth of the first error would be left of two corrections without it
    errors_um, without_um = rippled(0.1, 0.08, order=204), rippled(0.0, 0.08, order=204)
    print(f"\nsteep gears: {rms(errors_um):.2f} um, worst {errors_um.max():.2f}; ", end="")
    print(f"slope not learnt: {rms(without_um):.2f} um, worst {without_um.max():.2f}")
    assert rms(errors_um) < 0.75
    assert errors_um.max() < min(3.0, without_um.max())


def test_the_filter_goes_below_the_cameras_noise():
    true, measured = several(filtered=True)
    print("\nfiltered true", true.round(3), "measured", measured.round(3))
    images = np.arange(1, 6)
    expected = np.sqrt((CAMERA_UM**2 + REPEAT_UM**2) / images + REPEAT_UM**2)
    np.testing.assert_allclose(true[1:], expected, rtol=0.04)
    assert true[5] == pytest.approx(0.371, rel=0.04)
    np.testing.assert_allclose(measured[5], np.hypot(true[5], CAMERA_UM), rtol=0.04)


@pytest.mark.parametrize("fold_deg", [0.0, 180.0])
def test_singular_arms_converge_and_do_not_run_away(fold_deg):
    goal = goals()
    goal[:, 1] = fold_deg - np.rad2deg(PLANE.arms[:, 4])  # straight, exactly
    true, _ = several(filtered=True, goal_deg=goal)
    # along the radius nothing can be done and nothing is: not worse than elsewhere
    assert true[5] < 0.371 * 1.04
    loop = CorrectionLoop(PLANE, goal)
    _, _, command = observe(goal, 30, True, 9, loop)
    sigma = np.sqrt(np.einsum("nii->ni", loop._spread(BLIND_UM)))
    assert (np.abs(command - goal) < 6 * sigma).all()
    spread = np.einsum("nii->ni", loop.offsets.covariance)
    assert (spread > 0).all()


@pytest.mark.parametrize(("place_um", "least_um", "most_um"), [(3.0, 0.0, 0.6), (0.0, 2.5, 3.0)])
@pytest.mark.parametrize("beta_deg", [8.0, 172.0])
def test_a_nearly_straight_arm_that_is_too_long_is_corrected(beta_deg, place_um, least_um, most_um):
    """Its fibre is 3 um farther out than known: no small offset of an angle moves it so (place_um = 0)."""
    rng = np.random.default_rng(3)
    goal = np.column_stack([rng.uniform(10.0, 350.0, PLANE.n), np.full(PLANE.n, beta_deg)])
    goal[:, 1] -= np.rad2deg(PLANE.arms[:, 4])
    loop = CorrectionLoop(PLANE, goal, noise=CorrectionNoise(slope=0.0, place_um=place_um))
    out = PLANE.forward(*goal.T) - PLANE.centres_mm
    longer = 0.003 * out / np.hypot(*out.T)[:, None]
    command, everyone = goal, np.ones(PLANE.n, dtype=bool)
    for _ in range(3):
        true = PLANE.forward(*command.T) + longer
        command = loop.update(command, true + isotropic(rng, CAMERA_UM, PLANE.n), everyone)
    left = rms(1e3 * np.hypot(*(true - loop.target_mm).T))
    print(
        f"\nbeta {beta_deg:.0f} deg, 3 um too long, place {place_um} um: {left:.2f} um after two corrections"
    )
    assert least_um < left < most_um
    assert np.abs(command - goal).max() < 1.0


@pytest.mark.parametrize("fold_deg", [0.0, 180.0])
def test_the_plain_update_survives_singular_arms(fold_deg):
    goal = goals()
    goal[:, 1] = np.clip(fold_deg - np.rad2deg(PLANE.arms[:, 4]), 0.0, 180.0)
    true, _, command = observe(goal, 6, False, 3)
    assert np.isfinite(command).all()
    assert rms(true[3:]).max() < 2 * BLIND_UM


@pytest.mark.parametrize(("fibre", "least_um", "most_um"), [("BOSS", 0.0, 1.0), ("", 3.0, 20.0)])
def test_the_science_fibre_is_aimed(fibre, least_um, most_um):
    """Arms 20 um too long: angles change by half a degree, and the way between the fibres turns with them."""
    goal, rng = goals(4), np.random.default_rng(4)
    goal[:, 1] = rng.choice([15.0, 165.0], PLANE.n)
    loop = CorrectionLoop(PLANE, goal, fibre=np.full(PLANE.n, fibre), noise=CorrectionNoise(slope=0.0))
    out = PLANE.forward(*goal.T) - PLANE.centres_mm
    longer = 0.02 * out / np.hypot(*out.T)[:, None]
    command, star = goal, PLANE.forward(*goal.T, "BOSS")
    for _ in range(5):
        science = PLANE.forward(*command.T, "BOSS") + longer
        seen = PLANE.forward(*command.T) + longer + isotropic(rng, CAMERA_UM, PLANE.n)
        command = loop.update(command, seen, np.ones(PLANE.n, dtype=bool))
    left = rms(1e3 * np.hypot(*(science - star).T))
    print(f"\naimed {fibre or 'metrology'}: science fibres {left:.2f} um off")
    assert least_um < left < most_um
    on_goal = 1e3 * np.hypot(*(loop.metrology_goal_mm - PLANE.forward(*command.T) - longer).T)
    assert rms(on_goal) < 1.5  # the camera's goal is where the metrology fibre will be


def left_um(rests, seed, camera_um=0.3, repeat_um=0.35):
    """True errors (6, N) in um, and the share that does not move, with four images of each place."""
    goal, rng = goals(seed), np.random.default_rng(seed)
    noise = CorrectionNoise(camera_um=camera_um, repeatability_um=repeat_um, slope=0.0)
    loop = CorrectionLoop(PLANE, goal, noise=noise)
    offset = rng.normal(size=(PLANE.n, 2)) * np.sqrt(np.einsum("nii->ni", loop._spread(BLIND_UM)))
    command, arrived, true = goal.copy(), isotropic(rng, repeat_um, PLANE.n), []
    for _ in range(6):
        xy = PLANE.forward(*(command + offset).T) + arrived
        true.append(1e3 * np.hypot(*(xy - loop.target_mm).T))
        wanted = loop.update(command, xy + isotropic(rng, camera_um, PLANE.n), np.ones(PLANE.n, bool))
        stay = loop.rests[:, None] & rests
        command = np.where(stay, command, wanted)
        arrived = np.where(stay, arrived, isotropic(rng, repeat_um, PLANE.n))
    return np.array(true), stay.mean()


def test_what_would_come_no_nearer_is_not_moved():
    """An arrival scatters by 0.35 um: a third and more stay, and the field is nearer for it."""
    rest, go = (np.concatenate([left_um(on, s)[0] for s in range(2)], axis=1) for on in (True, False))
    share = left_um(True, 0)[1]
    print(
        f"\nrests: {rms(rest)[5]:.3f} um after five corrections, {share:.0%} not moved; else {rms(go)[5]:.3f}"
    )
    assert rms(rest)[5] < 0.92 * rms(go)[5]
    assert share > 0.3


def test_a_slip_is_followed_at_once():
    goal = goals()
    jump = np.zeros((PLANE.n, 2))
    jump[::2] = [0.06, -0.02]  # about 15 um at the fibre, after five images
    true, _, _ = observe(goal, 9, True, 2, jump=(5, jump))
    assert rms(true[5, ::2]) > 10.0
    assert rms(true[6, ::2]) < 1.0
    # those that did not slip know nothing of it
    np.testing.assert_allclose(rms(true[6, 1::2]), 0.35, rtol=0.15)


def test_only_the_active_and_seen_learn():
    goal = goals()
    loop = CorrectionLoop(PLANE, goal)
    measured = PLANE.forward(*(goal + 0.05).T)
    measured[5] = np.nan
    active = np.arange(PLANE.n) < 10
    wanted = loop.update(goal, measured, active)
    untouched = (np.arange(PLANE.n) >= 10) | (np.arange(PLANE.n) == 5)
    np.testing.assert_array_equal(wanted[untouched], goal[untouched])
    np.testing.assert_allclose(wanted[:5], goal[:5] - 0.05, atol=0.005)  # the prior pulls


def test_what_the_positioner_reports_is_not_corrected_twice():
    # it stopped 0.1 deg short and says so: no offset, the next command is the goal
    goal = goals()
    believed = goal + np.array([0.1, -0.1])
    for filtered in (True, False):
        loop = CorrectionLoop(PLANE, goal, filtered=filtered)
        wanted = loop.update(believed, PLANE.forward(*believed.T), np.ones(PLANE.n, dtype=bool))
        np.testing.assert_allclose(wanted, goal, atol=1e-9)


def test_commands_keep_clear_of_the_stops():
    goal = np.tile([-3.9, 363.9], (PLANE.n, 1))
    loop = CorrectionLoop(PLANE, goal, noise=CorrectionNoise(blind_um=1e4))
    seen = PLANE.forward(*(goal + np.array([0.5, -0.9])).T)
    wanted = loop.update(goal, seen, np.ones(PLANE.n, dtype=bool))
    low, high = PLANE.hard_stops_deg.T
    assert (wanted >= low).all()
    assert (wanted <= high - 0.82).all()


def test_two_images_weigh_as_one_of_half_the_variance():
    rng = np.random.default_rng(0)
    prior = Offsets(np.zeros((20, 2)), np.tile(np.diag([2.0, 3.0]), (20, 1, 1)))
    h = rng.normal(size=(20, 2, 2))
    z = rng.normal(size=(2, 20, 2))
    after = prior
    for image in z:
        left = image - np.einsum("nij,nj->ni", h, after.mean)
        after, _ = weigh(after, left, h, 0.5)
    at_once, _ = weigh(prior, z.mean(axis=0), h, 0.25)
    np.testing.assert_allclose(after.mean, at_once.mean, atol=1e-12)
    np.testing.assert_allclose(after.covariance, at_once.covariance, atol=1e-12)


@settings(deadline=None)
@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(1e-6, 1.0))
def test_what_an_image_does_not_tell_is_left_alone(x, y, noise):
    # a Jacobian of rank one sees only alpha + beta
    h = np.array([[[1.0, 1.0], [0.0, 0.0]]])
    prior = Offsets(np.zeros((1, 2)), np.eye(2)[None])
    after, _ = weigh(prior, np.array([[x, y]]), h, noise)
    blind = np.array([1.0, -1.0])
    assert abs(after.mean[0] @ blind) < 1e-9
    assert blind @ after.covariance[0] @ blind == pytest.approx(2.0, abs=1e-9)


def test_the_surprise_of_plain_noise_is_two_on_average():
    rng = np.random.default_rng(1)
    n = 4000
    prior = Offsets(np.zeros((n, 2)), np.tile(np.eye(2), (n, 1, 1)))
    h = rng.normal(size=(n, 2, 2))
    z = np.einsum("nij,nj->ni", h, rng.normal(size=(n, 2))) + rng.normal(0, 0.7, (n, 2))
    _, surprise = weigh(prior, z, h, 0.49)
    assert surprise.mean() == pytest.approx(2.0, rel=0.07)  # 2.2 sigma of the mean


def test_a_camera_that_knows_its_covariance_is_believed_fibre_by_fibre():
    goal = goals()
    loop = CorrectionLoop(PLANE, goal, noise=CorrectionNoise(slope=0.0))
    seen = PLANE.forward(*(goal + 0.03).T)
    covariance = np.tile(1e-6 * np.eye(2), (PLANE.n, 1, 1))
    covariance[::2] *= 1e6  # a spot that tells nothing: 1 mm
    wanted = loop.update(goal, seen, np.ones(PLANE.n, dtype=bool), covariance)
    np.testing.assert_allclose(wanted[::2], goal[::2], atol=1e-4)
    # 1 um per coordinate against a prior of 10 um: nearly all of it is taken off; least where beta is small
    np.testing.assert_allclose(wanted[1::2], goal[1::2] - 0.03, atol=9e-3)


def settled(told_um, monkeypatch, camera_um=CAMERA_UM):
    """True rms after five corrections with a camera that tells `told_um`, and what is found of its noise."""
    monkeypatch.setitem(globals(), "CAMERA_UM", camera_um)
    goal = goals()
    loop = CorrectionLoop(PLANE, goal, noise=CorrectionNoise(camera_um=told_um, slope=0.0))
    true, _, _ = observe(goal, 6, True, 5, loop)
    return rms(true)[5], np.sqrt(loop.camera_factor)


@pytest.mark.parametrize(("told_um", "is_um"), [(0.669, 2.0), (0.223, 0.669), (2.0, 0.669), (0.05, 0.669)])
def test_what_the_camera_tells_of_its_noise_does_not_matter(told_um, is_um, monkeypatch):
    """Hundreds of predictions tell it: three times worse, or better, than told."""
    error_um, factor = settled(told_um, monkeypatch, is_um)
    assert factor == pytest.approx(is_um / told_um, rel=0.06)
    expected_um = np.sqrt((is_um**2 + REPEAT_UM**2) / 5 + REPEAT_UM**2)
    assert error_um == pytest.approx(expected_um, rel=0.08)


def test_a_camera_that_tells_the_truth_is_believed(monkeypatch):
    assert settled(CAMERA_UM, monkeypatch)[1] == pytest.approx(1.0, abs=0.06)


def test_with_what_it_tells_alone_a_noisy_camera_is_trusted_too_much(monkeypatch):
    """What it is for: 1.70 in place of 0.90 um."""
    right_um, _ = settled(0.669, monkeypatch, 2.0)
    monkeypatch.setattr(CorrectionLoop, "_found_factor", lambda loop: 1.0)
    assert settled(0.669, monkeypatch, 2.0)[0] > 1.7 * right_um


def test_a_noisy_camera_is_told_once():
    told = []
    recorder = SimpleNamespace(event=lambda kind, text: told.append((kind, text)))
    loop = SimpleNamespace(motion=SimpleNamespace(recorder=recorder), _noise_told=False)
    for factor in (1.5, 9.0, 9.5):
        Loop._tell_noise(loop, SimpleNamespace(camera_factor=factor))
    assert [kind for kind, _ in told] == ["camera_noise"]
    assert told[0][1].startswith("images scatter 3.0 times as much as the camera tells")


def test_few_predictions_tell_nothing_of_the_noise():
    goal = goals()
    loop = CorrectionLoop(PLANE, goal)
    few = np.arange(PLANE.n) < 9
    for k in range(3):
        loop.update(goal, PLANE.forward(*(goal + 0.01 * k).T), few)
    assert loop.camera_factor == 1.0


def test_gears_that_ripple_are_not_taken_for_a_noisy_camera():
    """What a long way changes is no noise: those predictions do not count for it."""
    goal, rng = goals(7), np.random.default_rng(7)
    phase = rng.uniform(0, 2 * np.pi, (PLANE.n, 2))
    loop, command = CorrectionLoop(PLANE, goal), goal
    for _ in range(3):
        xy = PLANE.forward(*(command + 0.06 * np.sin(np.deg2rad(100 * command) + phase)).T)
        seen = xy + isotropic(rng, CAMERA_UM, PLANE.n)
        command = loop.update(command, seen, np.ones(PLANE.n, dtype=bool))
    assert np.sqrt(loop.camera_factor) < 1.5


@pytest.mark.parametrize("stretched", [True, False])
def test_a_correction_beyond_the_arms_goes_as_far_as_they_reach(stretched):
    goal = goals()
    loop = CorrectionLoop(PLANE, goal, filtered=False)
    everyone = np.ones(PLANE.n, dtype=bool)
    l_alpha, l_beta = loop._levers()
    limit_mm = l_alpha + l_beta if stretched else np.abs(l_alpha - l_beta)
    out = loop.target_mm - PLANE.centres_mm
    reach_mm = np.hypot(*out.T)
    # the camera sees the fibre so far off that it should go 5 um farther than the arms allow
    miss_mm = limit_mm - reach_mm + (5e-3 if stretched else -5e-3)
    command = loop.update(goal, loop.target_mm - out * (miss_mm / reach_mm)[:, None], everyone)
    # the others stay where they are: only their stops are in the way
    went = (command != goal).any(axis=1)
    at_mm = np.hypot(*(PLANE.forward(*command.T) - PLANE.centres_mm).T)
    assert went.sum() > PLANE.n / 10
    np.testing.assert_allclose(at_mm[went], limit_mm[went], atol=2e-6)
