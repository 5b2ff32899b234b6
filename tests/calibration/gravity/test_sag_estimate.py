"""The sag of arms from images of a still array: the truth comes back, and nothing from nothing."""

from dataclasses import replace

import numpy as np
import pytest
from tilted import MOMENT_KG_M, PLANE, Array, drawn_moments, true_sag_rad

from fiberloom.calibration.gravity.array import common_of
from fiberloom.calibration.gravity.estimate import ODD, UNSEEN, UNTOLD, estimate, weighed
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.pointing import Pointing

ALL = np.ones(len(PLANE), dtype=bool)
BENT = np.random.default_rng(5).uniform([5.0, 10.0], [355.0, 170.0], (37, 2))


def rms_um(rad, lever_mm=15.0):
    return 1e3 * lever_mm * np.sqrt((np.asarray(rad) ** 2).mean())


def test_without_noise_the_moments_come_back():
    array = Array(noise_um=1e-4)
    found = estimate(PLANE, array.images())
    assert found.ok.all()
    # of the stiffnesses' ratio, which is known, and of angles that bend: 1e-4 of 80 urad
    np.testing.assert_allclose(found.sag_rad, true_sag_rad(array.moment), atol=3e-8)


@pytest.mark.parametrize("pointing", [Pointing(90.0, 25.0), Pointing(30.0, -70.0)])
def test_turns_are_those_of_the_least_energy(pointing):
    array = Array(noise_um=1e-4)
    found = estimate(PLANE, array.images())
    turned = np.deg2rad(found.turns_deg(PLANE, BENT, pointing))
    np.testing.assert_allclose(turned, array.turned_rad(BENT, pointing), atol=3e-8)


def test_errors_are_as_large_as_told():
    misses, scores = [], []
    for seed in range(8):
        array = Array(moment=drawn_moments(seed), seed=seed, noise_um=0.7)
        found = estimate(PLANE, array.images())
        miss = found.sag_rad - true_sag_rad(array.moment)
        misses.append(miss)
        scores.append(np.einsum("np,npq,nq->n", miss, np.linalg.inv(found.covariance_rad2), miss))
    told = np.sqrt(np.einsum("npp->np", found.covariance_rad2).mean())
    assert np.sqrt(np.mean(np.square(misses))) == pytest.approx(told, rel=0.35)
    assert 2.0 < np.mean(scores) < 6.0  # four numbers


def test_units_are_drawn_towards_the_array_by_what_their_images_leave_open():
    array = Array(noise_um=1.5)
    rows = weighed(PLANE, array.images(), ALL)
    alone = np.linalg.solve(rows.matrix, rows.vector[..., None])[..., 0]
    true = true_sag_rad(array.moment)
    found = estimate(PLANE, array.images())
    assert rms_um(alone - true) > 2.0 * rms_um(found.sag_rad - true)
    sharp = replace(array, noise_um=0.05)
    # what differs from unit to unit is found where images tell it
    off = estimate(PLANE, sharp.images()).sag_rad - true
    assert rms_um(off) < 0.3 * rms_um(true - true.mean(axis=0))


def test_images_that_are_shifted_as_a_whole_are_no_gravity():
    for seed in range(4):
        array = Array(moment=drawn_moments(seed), seed=seed, noise_um=0.7, shift_um=2.0)
        common = common_of(weighed(PLANE, array.images(), ALL))
        true = true_sag_rad(array.moment).mean(axis=0)
        off = common.mean_rad - true
        assert off @ np.linalg.solve(common.mean_rad2, off) < 16.0  # four numbers; 18.5 is one in a thousand
        # from the mean of six images
        assert 1e3 * common.shift_mm.std() == pytest.approx(2.0 * np.sqrt(5.0 / 6.0), rel=0.25)
        assert np.sqrt(np.diag(common.mean_rad2)).max() < 12e-6  # of 80


def test_image_that_does_not_fit_weighs_little():
    images = Array().images()
    spoilt = images.xy_mm.copy()
    spoilt[::3, 4] += 0.03
    found = estimate(PLANE, replace(images, xy_mm=spoilt))
    assert found.ok.all()
    clean, true = estimate(PLANE, images), true_sag_rad(Array().moment)
    assert rms_um(found.sag_rad - true) < 1.5 * rms_um(clean.sag_rad - true)


def test_fibres_that_are_not_seen_have_a_reason_and_the_others_numbers():
    images = Array().images()
    xy = images.xy_mm.copy()
    xy[3] = np.nan
    xy[5, ::2] = np.nan
    found = estimate(PLANE, replace(images, xy_mm=xy))
    assert found.reason[3] == UNTOLD
    assert found.ok.sum() == len(PLANE) - 1
    assert found.n_images[[3, 5, 6]].tolist() == [0, 18, 36]
    assert not found.turns_deg(PLANE, BENT, Pointing(60.0))[3].any()


def test_an_arm_that_is_loose_is_named():
    moment = drawn_moments(0)
    moment[7, 1] *= 8.0
    found = estimate(PLANE, Array(moment=moment, noise_um=0.3).images())
    assert found.reason[7] == ODD
    assert found.ok.sum() == len(PLANE) - 1


def test_one_positioner_alone_is_told_by_its_own_images():
    one = FocalPlane.of("sdssv", n=1)
    array = Array(one, MOMENT_KG_M * np.ones((1, 2), dtype=complex), noise_um=0.1)
    found = estimate(one, array.images())
    assert found.ok.all()
    assert rms_um(found.sag_rad - true_sag_rad(array.moment)) < 0.2


# no information


@pytest.mark.parametrize(
    "turns",
    [
        [Pointing(0.0, float(turn)) for turn in range(0, 360, 60)],
        [Pointing(60.0, 30.0)] * 6,
    ],
    ids=["zenith", "one rotator angle"],
)
def test_images_in_which_gravity_does_not_turn_tell_nothing(turns):
    found = estimate(PLANE, Array().images(turns=turns))
    assert set(found.reason.tolist()) == {UNTOLD}
    assert not found.turns_deg(PLANE, BENT, Pointing(60.0)).any()
    assert found.size_um(PLANE) == found.formal_um(PLANE) == 0.0


@pytest.mark.parametrize("shift_um", [0.0, 1.5])
def test_noise_alone_is_not_taken_for_gravity(shift_um):
    for seed in range(10):
        array = Array(moment=np.zeros((37, 2), dtype=complex), seed=seed, noise_um=1.0, shift_um=shift_um)
        found = estimate(PLANE, array.images())
        assert set(found.reason.tolist()) == {UNSEEN}
        assert not found.sag_rad.any()


def test_images_of_another_array_are_refused():
    images = Array().images()
    others = replace(images, positioner_id=images.positioner_id + 1000)
    with pytest.raises(InputError, match="of none of the 37 positioners"):
        estimate(PLANE, others)
