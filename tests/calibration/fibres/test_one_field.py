"""Offsets from one dithered field: right, with right errors, near the bound; none where nothing is told."""

from dataclasses import replace

import numpy as np
import pytest
from stars import (
    CORE_UM,
    GAUSSIAN,
    Conditions,
    drawn_field,
    drawn_offsets,
    formal,
    rms,
    share,
    turned,
    without_modes,
)

from fiberloom.calibration.fibres.descent import settled
from fiberloom.calibration.fibres.dithered import hexagon
from fiberloom.calibration.fibres.estimate import estimate
from fiberloom.calibration.fibres.model import FieldModel, Unknowns
from fiberloom.errors import InputError
from fiberloom.twin.sky.sky import Believed, Sky


def found_of(seed, n=60, conditions=None, rms_um=12.0):
    rng = np.random.default_rng(seed)
    offset = drawn_offsets(rng, n, rms_um)
    field = drawn_field(rng, offset, conditions)
    return field, estimate(field, GAUSSIAN), offset


# right


def test_bright_stars_tell_offsets_and_the_exposures():
    _, found, offset = found_of(0, conditions=Conditions(sn=1000.0, guide_um=1.0))
    assert found.ok.all()
    assert rms(without_modes(found, found.offset_um - offset)) < 0.3
    # the patterns that the guider shares are taken out, and are all that is missing
    assert np.abs(np.einsum("nij,nik->jk", found.modes, found.offset_um[..., None])).max() < 1e-6
    assert rms(found.offset_um - offset) < 2.5
    assert np.exp(found.exposures[:, 1]).mean() == pytest.approx(85.0, rel=0.1)


def test_errors_are_those_that_are_told():
    """Over eight fields; what turns or stretches all offsets alike scatters from field to field."""
    square, count = 0.0, 0
    for seed in range(6):
        _, found, offset = found_of(seed + 10, conditions=Conditions(sn=40.0))
        error = without_modes(found, found.offset_um - offset)
        square += np.einsum("ni,nij,nj->", error, np.linalg.inv(found.covariance_um2[found.ok]), error)
        count += error.size
    assert 0.87 < np.sqrt(square / count) < 1.15


def bound_um(offset, field, conditions):
    """Cramer and Rao's: Fisher's information by differences of an independent model, inverted as a whole."""
    n, n_e = len(offset), field.n_exposures
    place = field.star_mm - field.star_mm.mean(axis=0)
    place /= np.sqrt((place**2).sum(axis=1).mean())
    cross = np.column_stack([-place[:, 1], place[:, 0]])

    def fluxes(unknown):
        star, e = unknown[: 3 * n].reshape(n, 3), unknown[3 * n :].reshape(n_e, 6)
        s = field.dither_um[:, None] + e[:, None, 2:4] - star[:, 1:]
        s = s + e[:, None, 4:5] * cross + e[:, None, 5:6] * place
        flux = np.exp(star[:, 0] + e[:, :1]) * share(np.hypot(s[..., 0], s[..., 1]), np.exp(e[:, 1:2]))
        return flux.ravel()

    bright = 2 * np.log(conditions.sn) - np.log(share(0.0, conditions.seeing_um))
    v = np.einsum("nij,nj->ni", turned(field.arm_deg), offset)
    exposure = np.tile([0.0, np.log(conditions.seeing_um), 0, 0, 0, 0], (n_e, 1))
    at = np.concatenate([np.column_stack([np.full(n, bright), v]).ravel(), exposure.ravel()])
    step = 1e-4 * np.eye(len(at))
    slope = np.array([(fluxes(at + h) - fluxes(at - h)) / 2e-4 for h in step])
    information = (slope / np.maximum(fluxes(at), 1.0)) @ slope.T
    # known before: spreads about means that are free, and these held as the estimate holds them
    alike = np.full((n_e, n_e), 1.0 / n_e)
    known = np.zeros((n_e, 6, n_e, 6))
    spread = conditions.spread
    sizes = [(spread, 1e-3), (spread, 0.7), *[(conditions.guide_um, 1e-3)] * 2, *[(0.3, 1e-3)] * 2]
    for k, (apart, mean) in enumerate(sizes):
        known[:, k, :, k] = (np.eye(n_e) - alike) / apart**2 + alike / (n_e * mean**2)
    information[3 * n :, 3 * n :] += known.reshape(6 * n_e, 6 * n_e)
    covariance = np.linalg.inv(information)
    rows = (3 * np.arange(n)[:, None] + [1, 2]).ravel()
    modes = np.concatenate([np.broadcast_to(np.eye(2), (n, 2, 2)), np.stack([cross, place], -1)], -1).reshape(
        -1, 4
    )
    away = np.eye(2 * n) - modes @ np.linalg.pinv(modes)
    return np.sqrt(np.trace(away @ covariance[np.ix_(rows, rows)] @ away.T) / n)


@pytest.mark.parametrize("sn", [30.0, 100.0])
def test_errors_are_near_the_bound(sn):
    """Fibres nearly on their stars: as in a second field, with the offsets of the first applied."""
    conditions = Conditions(sn=sn, guide_um=1.0)
    bounds, errors, told = [], [], []
    for seed in range(6):
        field, found, offset = found_of(seed + 40, 80, conditions, rms_um=3.0)
        bounds.append(bound_um(offset, field, conditions) ** 2)
        errors.append(rms(without_modes(found, found.offset_um - offset)) ** 2)
        told.append(formal(found.covariance_um2[found.ok]) ** 2)
    bound = np.sqrt(np.mean(bounds))
    assert np.sqrt(np.mean(errors)) == pytest.approx(bound, rel=0.15)
    # what six numbers a field, of guider and sky, are spread by is itself found from that field
    assert 0.9 < np.sqrt(np.mean(told)) / bound < 1.35


def test_derivatives_of_the_model_are_differences():
    rng = np.random.default_rng(3)
    model = FieldModel(drawn_field(rng, drawn_offsets(rng, 4)), GAUSSIAN)
    e = rng.normal(0.0, 1.0, (13, 6)) * [0.1, 0.1, 3, 3, 2, 2] + [0, np.log(85.0), 0, 0, 0, 0]
    at = Unknowns(rng.normal(0.0, 5.0, (4, 3)) * [0.1, 1, 1], e)
    _, by_star, by_exposure = model.fluxes(at)
    h = 1e-5
    for k in range(3):
        up, down = (model.fluxes(at.moved(s * h * np.eye(3)[k], 0.0 * e))[0] for s in (1, -1))
        assert by_star[..., k] == pytest.approx((up - down) / (2 * h), abs=1e-6)
    for k in range(6):
        up, down = (model.fluxes(at.moved(0.0 * at.star, s * h * np.eye(6)[k]))[0] for s in (1, -1))
        assert by_exposure[..., k] == pytest.approx((up - down) / (2 * h), abs=1e-6)


def test_no_star_gets_worse_by_steps_of_its_own():
    """From far off, where many steps are too long and the next one begins at the place before."""
    rng = np.random.default_rng(5)
    model = FieldModel(drawn_field(rng, drawn_offsets(rng, 60)), GAUSSIAN)
    star = rng.normal(0.0, 1.0, (60, 3)) * [1.0, 60.0, 60.0] + [9.0, 0.0, 0.0]
    at = Unknowns(star, np.tile([0.0, np.log(85.0), 0.0, 0.0, 0.0, 0.0], (13, 1)))
    cost = [
        (model.residuals(settled(model, at, model.seen.astype(float), steps)) ** 2).sum(axis=0)
        for steps in range(12)
    ]
    rises = np.diff(cost, axis=0)
    assert (rises <= 1e-9 * np.array(cost[:-1])).all()
    assert (rises == 0.0).any()  # steps that were not made
    assert np.median(cost[-1]) < 0.1 * np.median(cost[0])


def test_the_place_of_the_star_and_the_turn_of_the_arm_count():
    """A star 20 um to the right of the belief and a fibre 20 um to the right make the same fluxes."""
    field, found, _ = found_of(5)
    right = np.array([0.02, 0.0])
    moved = replace(field, star_mm=field.star_mm + right, fibre_mm=field.fibre_mm + right)
    assert estimate(moved, GAUSSIAN).offset_um == pytest.approx(found.offset_um, abs=1e-6)
    rows = np.arange(60)
    one = replace(field, fibre_mm=field.fibre_mm - 1e-3 * np.outer(rows == 7, [20.0, 0.0]))
    change = estimate(one, GAUSSIAN).offset_um[7] - found.offset_um[7]
    back = turned(field.arm_deg[7:8])[0].T @ [20.0, 0.0]
    assert change == pytest.approx(back, abs=1.5)


# what goes wrong


def test_outliers_clouds_and_dead_fibres_do_no_harm():
    rng = np.random.default_rng(7)
    offset = drawn_offsets(rng, 80)
    clean = drawn_field(rng, offset, Conditions(sn=100.0, guide_um=1.0))
    flux, error = clean.flux.copy(), clean.flux_error.copy()
    hit = rng.random(flux.shape) < 0.01
    flux[hit] += 30.0 * error[hit]  # cosmic rays
    flux[3] *= 0.3  # a cloud
    error[3] *= np.sqrt(0.3)
    flux[:, :10] = rng.normal(0.0, 30.0, (13, 10))  # dead fibres
    error[:, :10] = 30.0
    flux[5, 20:30] = np.nan  # not measured
    error[5, 20:30] = np.nan
    found = estimate(replace(clean, flux=flux, flux_error=error), GAUSSIAN)
    assert [bool(r) for r in found.reason] == [True] * 10 + [False] * 70
    assert all("no light" in r for r in found.reason[:10])
    assert (found.offset_um[:10] == 0.0).all()
    assert np.isnan(found.covariance_um2[:10]).all()
    assert found.n_outliers[10:].sum() == pytest.approx(hit[:, 10:].sum(), abs=6)
    calm = estimate(clean, GAUSSIAN)
    worse = rms(without_modes(found, found.offset_um - offset)) / rms(
        without_modes(calm, calm.offset_um - offset)
    )
    assert worse < 1.35


def test_a_bright_double_star_is_refused():
    rng = np.random.default_rng(8)
    offset = drawn_offsets(rng, 100)
    field = drawn_field(rng, offset, Conditions(sn=100.0, guide_um=1.0))
    beside = np.hypot(*(hexagon() - [70.0, 20.0] - offset[4] @ turned(field.arm_deg[4:5])[0].T).T)
    flux = field.flux.copy()
    flux[:, 4] += 0.4 * 100.0**2 * share(beside, 85.0) / share(0.0, 85.0)
    found = estimate(replace(field, flux=flux), GAUSSIAN)
    assert "no star" in found.reason[4] or "do not fit a star" in found.reason[4]
    assert sum(map(bool, found.reason)) == 1


@pytest.mark.parametrize("far_um", [60.0, 90.0])
def test_a_fibre_that_is_far_off_is_found(far_um):
    rng = np.random.default_rng(9)
    offset = drawn_offsets(rng, 60)
    offset[5] = [0.0, far_um]
    found = estimate(drawn_field(rng, offset, Conditions(guide_um=1.0)), GAUSSIAN)
    assert found.offset_um[5] == pytest.approx(offset[5], abs=6.0)


# nothing is told


def blind(change):
    rng = np.random.default_rng(11)
    field = drawn_field(rng, drawn_offsets(rng, 60), Conditions(sn=50.0))
    return replace(field, **change(field, rng))


NOTHING = {
    "noise alone": lambda f, rng: {
        "flux": rng.normal(0.0, 10.0, f.flux.shape),
        "flux_error": np.full(f.flux.shape, 10.0),
    },
    "no flux": lambda f, rng: {"flux": np.full(f.flux.shape, np.nan)},
    "even light": lambda f, rng: {"flux": 2500.0 + 50.0 * rng.standard_normal(f.flux.shape)},
    "fluxes in any order": lambda f, rng: {"flux": rng.permuted(f.flux, axis=0)},
    "no dithers": lambda f, rng: {"dither_um": np.zeros((13, 2))},
    "dithers along a line": lambda f, rng: {"dither_um": f.dither_um * [1.0, 0.0]},
}


@pytest.mark.parametrize("what", NOTHING)
def test_what_tells_nothing_is_refused(what):
    with pytest.raises(InputError, match=r"^a field: "):
        estimate(blind(NOTHING[what]), GAUSSIAN)


def test_a_fibre_under_even_light_has_no_offset():
    rng = np.random.default_rng(12)
    field = drawn_field(rng, drawn_offsets(rng, 60))
    flux = field.flux.copy()
    flux[:, :5] = 400.0 + 20.0 * rng.standard_normal((13, 5))
    error = field.flux_error.copy()
    error[:, :5] = 20.0
    found = estimate(replace(field, flux=flux, flux_error=error), GAUSSIAN)
    assert all(found.reason[:5])
    assert (found.offset_um[:5] == 0.0).all()
    assert found.ok[5:].all()


def test_a_field_of_two_fibres_is_refused():
    rng = np.random.default_rng(13)
    with pytest.raises(InputError, match="2 of 2 are left, 3 are needed"):
        estimate(drawn_field(rng, drawn_offsets(rng, 2)), GAUSSIAN)


def test_three_exposures_are_refused():
    rng = np.random.default_rng(14)
    with pytest.raises(InputError, match="3 exposures"):
        estimate(drawn_field(rng, drawn_offsets(rng, 20), dither_um=hexagon(n=3)), GAUSSIAN)


@pytest.mark.parametrize(("rms_um", "least", "most"), [(12.0, 0.03, 0.12), (3.0, 0.001, 0.03)])
def test_a_core_that_is_wrong_scales_offsets(rms_um, least, most):
    """By 5 %: a tenth of offsets of 12 um, and less the nearer fibres are to their stars."""
    field, found, offset = found_of(15, 60, rms_um=rms_um)
    other = estimate(field, replace(GAUSSIAN, core_um=0.95 * CORE_UM))
    assert least < rms(other.offset_um - found.offset_um) / rms(offset) < most


def test_fibres_near_their_stars_do_not_make_the_seeing_wide():
    """Any seeing fits there with exposures that differ enough; offsets would be larger in proportion."""
    rng = np.random.default_rng(0)
    n = 500
    xy_mm, arm_deg = rng.uniform(-300.0, 300.0, (n, 2)), rng.uniform(0.0, 360.0, n)
    offset = drawn_offsets(rng, n, rms_um=1.0)
    true_mm = xy_mm + 1e-3 * np.einsum("nij,nj->ni", turned(arm_deg), offset)
    believed = Believed("a field", np.arange(1, n + 1), np.full(n, "BOSS"), xy_mm, xy_mm, arm_deg)
    found = estimate(Sky(0, 1).expose(believed, true_mm))
    assert np.exp(found.exposures[:, 1].mean()) == pytest.approx(85.0, rel=0.15)
    assert rms(without_modes(found, found.offset_um - offset)) < 1.4
