"""Wear: sizes of Kronig 2020, Fig. 21 and 22, by unit and cycle, alike in both fidelities."""

import numpy as np
import pytest

from fiberloom.instruments.arms import L_ALPHA
from fiberloom.twin import StatisticalTwin, Twin, Wear, WearModel, bench_units, worn
from fiberloom.twin.gears import Gears
from fiberloom.twin.units import GEAR

PLANE, NEW = bench_units("sdssv", 4, range(24))
WEAR = Wear(NEW, seed=4)
THETA = np.deg2rad(np.broadcast_to(np.linspace(0, 360, 1441), (24, 2, 1441)))


def delta_deg(units):
    return np.rad2deg(Gears(units).gear_of(THETA) / GEAR - THETA)


def test_delta_changes_locally_up_to_015_deg():
    change = delta_deg(WEAR.at(100.0)) - delta_deg(NEW)
    largest = np.abs(change).max(axis=2)
    assert largest.max() <= 0.147  # the limit of 0.16, as far as it is grown
    assert largest.max() > 0.14  # "up to" is reached among 48 axes
    assert 0.08 < np.median(largest) < 0.14
    # locally: half of alpha's way keeps what it had to a tenth of the change
    assert np.median(np.mean(np.abs(change[:, 0]) < 0.1 * largest[:, :1], axis=1)) > 0.4


def test_tuned_to_the_papers_largest_change():
    """TUNED: of beta, the most of four units; Kronig 2020, Fig. 22 shows 0.15 deg, with a camera's noise."""
    most = np.abs(delta_deg(WEAR.at(100.0)) - delta_deg(WEAR.at(1.0)))[:, 1].max(axis=1)
    assert most.reshape(-1, 4).max(axis=1).mean() == pytest.approx(0.14, abs=0.01)


def test_marks_develop_and_never_jump():
    ages = np.array([0.0, 1.0, 2.0, 10.0, 50.0, 100.0, 1000.0])
    change = np.stack([delta_deg(WEAR.at(age)) - delta_deg(NEW) for age in ages])
    sizes = np.abs(change).max(axis=(1, 2, 3))
    assert sizes[0] == 0.0
    assert (np.diff(sizes) >= 0.0).all()
    assert sizes[4] < 0.95 * sizes[5]
    assert np.abs(change[2] - change[1]).max() < 0.006  # a cycle: a fortieth of 0.2 deg at most


def test_arms_wander_within_a_micrometre():
    lengths = np.stack(
        [np.column_stack([u.arms[:, L_ALPHA], u.beta_longer_mm]) for u in map(WEAR.at, range(0, 400, 4))]
    )
    off_um = 1e3 * (lengths - lengths[0])
    assert np.abs(off_um).max() <= 1.0
    assert np.abs(off_um).max() > 0.6
    assert np.abs(np.diff(off_um, axis=0)).max() < 0.5  # four cycles: a walk, no noise


def test_friction_grows_and_the_firmware_is_not_told():
    old = WEAR.at(100.0)
    grown = old.plant["coulomb_gear"] / NEW.plant["coulomb_gear"]
    assert grown.min() >= 1.0
    assert 1.05 < grown.mean() < 1.25
    assert grown.max() <= 1.3 + 1e-12
    assert old.firmware.tobytes() == NEW.firmware.tobytes()


def test_wear_depends_on_seed_and_number_alone():
    rows = [17, 3]
    part = worn(NEW.select(rows), 60.0, seed=4)
    for name in ("plant", "gear", "arms", "beta_longer_mm"):
        assert getattr(part, name).tobytes() == getattr(WEAR.at(60.0).select(rows), name).tobytes()
    assert worn(NEW, 60.0, seed=5).gear.tobytes() != WEAR.at(60.0).gear.tobytes()
    each = np.linspace(0.0, 90.0, 24)
    assert WEAR.at(each).gear[5].tobytes() == WEAR.at(each[5]).gear[5].tobytes()


def test_units_of_a_bench_do_not_depend_on_the_range():
    plane, units = bench_units("sdssv", 4, range(498, 503))  # the end of one array and the next
    _, alone = bench_units("sdssv", 4, range(501, 502))
    assert units.select([3]).digest() == alone.digest()
    assert plane.positioner_id.tolist() == [499, 500, 501, 502, 503]
    assert len(np.unique(units.plant["stiffness"])) == 10


def test_both_fidelities_wear_alike():
    """Motors stand; arms move with their gears, by the same angle."""
    start = (130.0, 95.0)
    full = Twin(PLANE, NEW, threads=1, neighbours=False, start_deg=start)
    quick = StatisticalTwin(PLANE, NEW, start_deg=start)
    before = full.truth()
    for twin in (full, quick):
        twin.set_units(WEAR.at(100.0))
    moved = full.truth() - before
    assert np.abs(moved).max() > 0.02
    np.testing.assert_allclose(quick.truth(), full.truth(), atol=1e-9)
    np.testing.assert_allclose(quick.fibre_xy("BOSS"), full.fibre_xy("BOSS"), atol=1e-9)


def test_a_wear_model_of_ones_own():
    still = worn(NEW, 100.0, model=WearModel(mark_rms_deg=0.0, arm_um=0.0, friction_growth=(0.0, 0.0)))
    assert still.plant.tobytes() == NEW.plant.tobytes()
    np.testing.assert_array_equal(still.arms, NEW.arms)
    np.testing.assert_allclose(delta_deg(still), delta_deg(NEW), atol=1e-12)
    with pytest.raises(Exception, match="no such"):
        bench_units("no such instrument", 1, range(1))
