"""Arms that grow: seen in one image, learnt from nights, and never claimed without information."""

import dataclasses

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.calibration.adaptive.expansion import (
    KnownExpansion,
    NightGrowth,
    grown,
    growth_seen,
    learnt_expansion,
    ungrown_mm,
)
from fiberloom.instruments import METROLOGY

PLANE = fl.FocalPlane.of("sdssv", n=217)
EVERY = np.ones(len(PLANE), dtype=bool)
NOMINAL = KnownExpansion(11e-6, 6e-6)
TRUE = 14e-6
SIGMA = 15e-6


def at_random(seed):
    """(N, 2) deg: angles anywhere in the workspace."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(0.0, 360.0, len(PLANE)), rng.uniform(0.0, 180.0, len(PLANE))])


# one image


def test_longer_arms_move_fibres_straight_away_from_the_centre():
    angles = at_random(0)
    for fibre in (METROLOGY, "BOSS"):
        before, after = (plane.forward(*angles.T, fibre) for plane in (PLANE, grown(PLANE, 2e-4)))
        np.testing.assert_allclose(after - PLANE.centres_mm, 1.0002 * (before - PLANE.centres_mm), rtol=1e-12)
        np.testing.assert_allclose(ungrown_mm(after, PLANE.centres_mm, 2e-4), before, rtol=1e-12)
    assert grown(PLANE, 0.0) is PLANE


def test_one_image_tells_how_much_they_have_grown_and_how_well_it_knows():
    off = []
    for seed in range(60):
        angles, rng = at_random(seed), np.random.default_rng([seed, 1])
        xy_mm = grown(PLANE, 3e-4).forward(*angles.T, METROLOGY) + rng.normal(0.0, 6e-3, (len(PLANE), 2))
        found, sigma = growth_seen(PLANE, angles, xy_mm, EVERY)
        off.append((found - 3e-4) / sigma)
    # 6 um over levers of 16 mm and 217 fibres
    assert sigma == pytest.approx(6e-3 / 16.1 / np.sqrt(217), rel=0.15)
    assert np.mean(off) == pytest.approx(0.0, abs=0.4)
    assert np.std(off) == pytest.approx(1.0, abs=0.3)


def test_wrong_spots_and_fibres_that_do_not_count_do_not_move_it():
    angles, rng = at_random(2), np.random.default_rng(2)
    xy_mm = grown(PLANE, 3e-4).forward(*angles.T, METROLOGY) + rng.normal(0.0, 6e-3, (len(PLANE), 2))
    right, sigma = growth_seen(PLANE, angles, xy_mm, EVERY)
    wrong = xy_mm.copy()
    wrong[:6] += 0.02 * (wrong - PLANE.centres_mm)[:6]
    wrong[6] = np.nan
    assert growth_seen(PLANE, angles, wrong, EVERY) == pytest.approx((right, sigma), abs=sigma)
    counted = EVERY.copy()
    counted[:100] = False
    xy_mm[:100] += 5.0
    assert growth_seen(PLANE, angles, xy_mm, counted)[0] == pytest.approx(right, abs=3 * sigma)
    assert np.isnan(growth_seen(PLANE, angles, xy_mm, EVERY & False)).all()


# nights


def nights(at_C, seed=0, true=TRUE, offset=0.0, mark="a"):
    """What observations at these temperatures show of arms that are all too long by `offset`."""
    scatter = np.random.default_rng(seed).normal(0.0, SIGMA, len(at_C))
    return [
        NightGrowth(float(t), offset + true * (t - 20.0) + float(s), SIGMA, mark)
        for t, s in zip(at_C, scatter, strict=True)
    ]


def test_nights_tell_the_expansion_within_its_own_sigma():
    at_C = np.random.default_rng(1).normal(10.0, 8.0, 12)
    found = [learnt_expansion(NOMINAL, nights(at_C, seed, offset=1e-4)) for seed in range(200)]
    off = np.array([(one.per_K - TRUE) / one.sd_per_K for one in found])
    assert abs(off.mean()) < 0.25
    assert off.std() == pytest.approx(1.0, abs=0.2)
    # the error of a slope
    assert np.median([one.sd_per_K for one in found]) == pytest.approx(
        SIGMA / np.sqrt(((at_C - at_C.mean()) ** 2).sum()), rel=0.1
    )
    assert {one.nights for one in found} == {12}


def test_calibrations_may_be_off_each_by_its_own():
    at_C = np.array([0.0, 4.0, 8.0, 12.0, 16.0])
    found = learnt_expansion(
        NOMINAL, nights(at_C, 1, offset=3e-4) + nights(at_C + 9.0, 2, offset=-4e-4, mark="b")
    )
    assert found.per_K == pytest.approx(TRUE, abs=3 * found.sd_per_K)
    assert found.sd_per_K < 1.5e-6


@pytest.mark.parametrize(
    "shown",
    [
        [],
        nights([5.0] * 20),
        nights([5.0, 19.0]),
        [night for k in range(9) for night in nights([3.0 * k], k, mark=str(k))],
        nights([9.8, 10.0, 10.2, 9.9]),
    ],
    ids=["none", "one temperature", "two nights", "one a calibration", "hardly apart"],
)
def test_nights_without_information_claim_nothing(shown):
    assert learnt_expansion(NOMINAL, shown) is NOMINAL


def test_nights_that_scatter_more_than_they_say_are_believed_less():
    at_C = np.linspace(-5.0, 25.0, 12)
    calm = learnt_expansion(NOMINAL, nights(at_C, 3))
    rough = [dataclasses.replace(night, sigma=SIGMA / 5.0) for night in nights(at_C, 3)]
    assert learnt_expansion(NOMINAL, rough).sd_per_K > 0.6 * calm.sd_per_K


def test_thermometers_that_tell_nothing_true_are_learnt_not_to_matter():
    """What they say has nothing to do with the arms: the expansion by it becomes none."""
    rng = np.random.default_rng(5)
    shown = [NightGrowth(rng.normal(10.0, 9.0), rng.normal(0.0, SIGMA), SIGMA, "a") for _ in range(30)]
    found = learnt_expansion(NOMINAL, shown)
    assert found.nights == 30
    assert abs(found.per_K) < 3 * found.sd_per_K < 2e-6
