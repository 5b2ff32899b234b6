"""Arc calibration of the twin's units: what was drawn comes back, and what points do not tell is refused."""

from dataclasses import replace

import numpy as np
import pytest

from fiberloom.drive.desi import move_tables
from fiberloom.drive.desi.arcs import OFFSET_P, OFFSET_T, R1, R2, Arcs, arc_goals, fit_arcs, ways_of
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin.desi import DesiSizes, DesiTwin, draw_desi_units

RANGE = np.array([[-150.0, 150.0], [20.0, 170.0]])
FIXED = (10.0, 95.0)
N = 200
START = np.tile([0.0, 120.0], (N, 1))


def units_of(sizes=None, waves=1.0):
    """A plane, its units, their gears' errors times `waves`."""
    plane = generate(load_instrument("desi"), seed=5, n_positioners=N)
    units = draw_desi_units(plane, 5, sizes or DesiSizes(centre_um=30.0, length_um=50.0))
    gears = replace(units.gears, amplitude_deg=waves * units.gears.amplitude_deg)
    return plane, replace(units, gears=gears)


def measured(plane, units, sigma_um, points=6):
    """Both arcs on the twin, as seen."""
    goals, arc = arc_goals(RANGE, FIXED, points)
    twin = DesiTwin(plane, units, seed=9, start_deg=START, contacts=False)
    rng, here, at = np.random.default_rng(1), START, []
    up, down, total = [], [], np.zeros((2, N, 2))
    for goal in goals:
        tables = move_tables(goal - here, moving=np.ones(N, dtype=bool))
        twin.execute(tables)
        total = total + np.array(ways_of(tables))
        up.append(total[0])
        down.append(total[1])
        here = START + total[0] - total[1]
        at.append(twin.fibre_xy() + 1e-3 * sigma_um * rng.standard_normal((N, 2)))
    return Arcs(np.stack(at, 1), np.stack(up, 1), np.stack(down, 1), START, arc)


def truth(plane, units):
    """(N, 6) of the unknowns, without scales."""
    return np.column_stack(
        [
            units.arms[:, :3],
            plane.l_beta_mm + units.beta_longer_mm,
            np.rad2deg(units.arms[:, 3]),
            np.rad2deg(units.arms[:, 4] + plane.metrology_phi_rad),
        ]
    )


def off(fit, plane, units):
    """(N, 6) of the fit."""
    out = fit.unknowns[:, :6] - truth(plane, units)
    out[:, 4:] = np.mod(out[:, 4:] + 180.0, 360.0) - 180.0
    return out


def test_straight_gears_give_back_arms_and_zeros():
    plane, units = units_of(DesiSizes(centre_um=30.0, length_um=50.0, scatter_deg=0.0), waves=0.0)
    fit = fit_arcs(measured(plane, units, sigma_um=2.0))
    assert fit.ok.all()
    # 24 numbers, 6 unknowns: sqrt(2 x 18 / 24) of 2 um an axis
    assert np.median(fit.residual_um) == pytest.approx(2.0 * np.sqrt(2 * 18 / 24), rel=0.1)
    error = off(fit, plane, units)
    sigma = np.sqrt(np.einsum("nuu->nu", fit.covariance))[:, :6]
    # the covariance comes from 18 degrees of freedom: t-distributed
    assert np.all(np.abs(error) < 7.0 * sigma)
    assert 0.85 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.3
    assert np.abs(error[:, [0, 1, 2, 3]]).max() < 0.015


def test_waves_of_the_gear_show_as_residual_and_widen_the_covariance():
    plane, units = units_of()
    fit = fit_arcs(measured(plane, units, sigma_um=2.0))
    error = off(fit, plane, units)
    sigma = np.sqrt(np.einsum("nuu->nu", fit.covariance))[:, :6]
    assert 15.0 < np.median(fit.residual_um) < 60.0
    assert 0.5 < np.sqrt(np.mean((error / sigma) ** 2)) < 2.0
    assert np.abs(error[:, R1]).mean() < 0.04
    assert np.abs(error[:, R2]).mean() < 0.04
    assert np.abs(error[:, [OFFSET_T, OFFSET_P]]).mean() < 0.8


def test_scales_of_degraded_motors_come_back_by_direction():
    sizes = DesiSizes(linear_phi=0.3, linear_theta=0.2, idle=0.0, scatter_deg=0.0)
    plane, units = units_of(sizes, waves=0.0)
    fit = fit_arcs(measured(plane, units, sigma_um=2.0), units.linear)
    # a theta that hardly turns draws no arc; an approach of 3 deg, scaled, may not close the play
    closed = (3.0 * units.scale.min(axis=2) > units.gears.play_deg).all(axis=1)
    turns = (units.scale > 0.3).all(axis=(1, 2)) & closed
    assert fit.ok[turns].all()
    wrong = (fit.scale - units.scale).reshape(N, 4)[turns]
    sigma = np.sqrt(np.einsum("nuu->nu", fit.covariance))[turns, 6:]
    assert np.median(np.abs(wrong[sigma > 0.0])) < 0.002
    assert np.all(np.abs(wrong) <= 7.0 * sigma)
    assert np.all(fit.scale[turns & ~units.linear.any(axis=1)] == 1.0)


def test_one_way_only_does_not_tell_scales_apart():
    plane, units = units_of(DesiSizes(linear_phi=1.0, idle=0.0, scatter_deg=0.0), waves=0.0)
    arcs = measured(plane, units, 0.0)
    arcs = replace(arcs, down_deg=0.2 * arcs.up_deg)
    with pytest.raises(InputError, match="none of 200 units"):
        fit_arcs(arcs, units.linear)
    assert fit_arcs(arcs).ok.any()


def test_too_few_points_refuse_a_unit_and_name_why():
    plane, units = units_of(waves=0.0)
    arcs = measured(plane, units, sigma_um=2.0)
    arcs.xy_mm[3, 2:] = np.nan
    fit = fit_arcs(arcs)
    assert not fit.ok[3]
    assert fit.ok.sum() == N - 1
    assert "2 points seen" in fit.reason[3]
    assert np.isnan(fit.unknowns[3]).all()


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="arcs: places"):
        Arcs(np.zeros((2, 3, 2)), np.zeros((2, 3, 2)), np.zeros((2, 4, 2)), np.zeros((2, 2)), np.zeros(3))
