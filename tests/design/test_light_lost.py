"""Light lost by decentre and the number of corrections, against an independent table and limits."""

import numpy as np
import pytest

from fiberloom.design.throughput import (
    MOFFAT_BETA,
    CorrectionCosts,
    FibreOptics,
    best_corrections,
    needed_corrections,
    speeds,
)
from fiberloom.errors import InputError

UM = (1, 2, 5, 10, 15, 20, 30, 40, 50)
SDSSV, DESI, PFS = (120.0, 60.0), (107.0, 70.0), (127.0 / 1.28, 89.0)
TABLE = [
    # fibre, seeing; per cent lost at UM; share in a centred fibre
    (SDSSV, 0.7, (0.01, 0.03, 0.21, 0.86, 2.0, 3.8, 9.7, 20, 36), 0.92),
    (SDSSV, 1.0, (0.01, 0.06, 0.35, 1.4, 3.2, 5.7, 13, 24, 37), 0.79),
    (SDSSV, 1.5, (0.01, 0.06, 0.37, 1.5, 3.3, 5.9, 13, 22, 33), 0.56),
    (DESI, 0.7, (0.02, 0.06, 0.40, 1.6, 3.7, 6.8, 16, 30, 47), 0.83),
    (DESI, 1.0, (0.02, 0.08, 0.48, 1.9, 4.3, 7.7, 17, 29, 43), 0.64),
    (DESI, 1.5, (0.02, 0.06, 0.39, 1.6, 3.5, 6.1, 13, 22, 33), 0.40),
    (PFS, 0.7, (0.02, 0.09, 0.56, 2.2, 5.0, 8.9, 20, 34, 49), 0.67),
    (PFS, 1.0, (0.02, 0.08, 0.49, 2.0, 4.4, 7.7, 17, 28, 40), 0.46),
    (PFS, 1.5, (0.01, 0.05, 0.31, 1.3, 2.8, 4.9, 11, 18, 27), 0.25),
]


@pytest.mark.parametrize(("fibre", "seeing", "lost", "centred"), TABLE)
def test_what_a_micrometre_costs(fibre, seeing, lost, centred):
    optics = FibreOptics(*fibre, seeing)
    found = 100.0 * optics.loss(UM)
    # two digits are given: half of the last, and as much again for the table's own integration
    digit = 10.0 ** (np.floor(np.log10(lost)) - 1).clip(min=-2)
    assert (np.abs(found - lost) <= digit).all(), found - lost
    assert optics.centred == pytest.approx(centred, abs=0.011)


def test_the_share_of_a_centred_fibre_is_the_closed_form():
    optics = FibreOptics(*SDSSV)
    assert optics.share(0.0)[0] == pytest.approx(optics.centred, abs=1e-9)


def test_a_fibre_far_off_has_the_light_of_the_profile_there():
    optics = FibreOptics(20.0, 60.0)
    a = optics.core_radius_um
    density = (MOFFAT_BETA - 1.0) / (np.pi * a**2) * (1.0 + (600.0 / a) ** 2) ** -MOFFAT_BETA
    bend = 1.0 + 49.0 / 8.0 * (10.0 / 600.0) ** 2  # mean of r^-7 over the disc
    assert optics.share(600.0)[0] == pytest.approx(density * np.pi * 100.0 * bend, rel=1e-4)


@pytest.mark.parametrize(("fibre", "k"), [(SDSSV, 1.4e-4), (DESI, 1.93e-4), (PFS, 1.97e-4)])
def test_small_losses_are_quadratic(fibre, k):
    optics = FibreOptics(*fibre)
    assert optics.k_per_um2 == pytest.approx(k, rel=0.01)
    assert optics.mean_loss(2.0) == pytest.approx(4.0 * optics.k_per_um2, rel=0.01)
    assert optics.speed(2.0) == pytest.approx(1.0 - 8.0 * optics.k_per_um2, abs=1e-5)


def test_means_over_moves_of_a_rms():
    optics = FibreOptics(*SDSSV)
    assert optics.mean_loss(36.0) == pytest.approx(0.19, abs=0.005)
    assert optics.mean_loss(10.4) == pytest.approx(0.015, abs=0.0005)


def test_air_that_desi_takes_off_speeds_its_survey():
    """7.3 to 3.5 um: 1.6 % (Schlafly et al. 2024)."""
    optics = FibreOptics(*DESI, 1.1)
    assert optics.speed(3.5) / optics.speed(7.3) - 1.0 == pytest.approx(0.016, abs=0.001)


def test_light_asks_for_one_correction_and_the_requirement_for_two():
    optics, moves = FibreOptics(*SDSSV), CorrectionCosts(10.36)
    assert [moves.rms_um(k) for k in range(3)] == pytest.approx([10.36, 2.6, 0.9], abs=0.03)
    assert [moves.beyond(k, 5.0) for k in range(3)] == pytest.approx([0.79, 0.023, 0.0], abs=0.003)
    assert best_corrections(optics, moves, 900.0) == 1
    assert needed_corrections(moves, 5.0) == 2
    assert best_corrections(optics, moves, 5700.0) == 1
    assert best_corrections(optics, moves, 6100.0) == 2


@pytest.mark.parametrize(
    ("exposure_s", "best"), [(300.0, (1, 0, 0, 0)), (900.0, (1, 1, 0, 0)), (3600.0, (2, 1, 1, 1))]
)
def test_best_numbers_by_the_time_that_each_takes(exposure_s, best):
    optics = FibreOptics(*SDSSV)
    moves = [CorrectionCosts(10.36, each_s=each_s) for each_s in (5.0, 15.0, 30.0, 60.0)]
    assert tuple(best_corrections(optics, one, exposure_s) for one in moves) == best


def test_a_correction_that_costs_no_time_is_always_worth_it():
    found = speeds(FibreOptics(*SDSSV), CorrectionCosts(10.36, each_s=0.0), 900.0)
    assert (np.diff(found) >= 0.0).all()


def test_bad_numbers_are_refused():
    with pytest.raises(InputError, match="seeing_arcsec 0"):
        FibreOptics(120.0, 60.0, 0.0)
    with pytest.raises(InputError, match="exposure -1 s"):
        speeds(FibreOptics(*SDSSV), CorrectionCosts(10.0), -1.0)
    with pytest.raises(InputError, match="what remains 1"):
        CorrectionCosts(10.0, remains=1.0)
    assert needed_corrections(CorrectionCosts(10.0, floor_um=9.0), 5.0) is None
