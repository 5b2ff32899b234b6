"""The twin's sky counts what stars give, and is blind: offsets are found whatever their size."""

from dataclasses import replace

import numpy as np
import pytest

from fiberloom.calibration.fibres.combine import combine
from fiberloom.calibration.fibres.dithered import hexagon
from fiberloom.calibration.fibres.estimate import estimate
from fiberloom.twin.sky.sky import Believed, Sky, SkyConditions

CALM = SkyConditions(
    sn=(100.0, 100.0), seeing_spread=0.0, transparency_spread=0.0, guide_um=0.0, field_guide_um=0.0,
    turn_um=0.0, doubles=0.0, cosmics=0.0,
)  # fmt: skip


def believed(rng, n, star_error_mm=0.0):
    xy, arm = rng.uniform(-300.0, 300.0, (n, 2)), rng.uniform(0.0, 360.0, n)
    star = xy + star_error_mm * rng.standard_normal((n, 2))
    return Believed("a field", np.arange(n), np.full(n, "BOSS"), star, xy, arm)


def in_focal_plane_mm(arm_deg, offset_um):
    z = offset_um @ [1.0, 1.0j] * np.exp(1j * np.deg2rad(arm_deg))
    return 1e-3 * np.column_stack([z.real, z.imag])


def test_signal_to_noise_is_as_asked():
    told = believed(np.random.default_rng(0), 400)
    field = Sky(0, 0, CALM).expose(told, told.fibre_mm, np.zeros((4, 2)))
    assert np.median(field.flux / field.flux_error) == pytest.approx(100.0, rel=0.02)
    scatter = np.sqrt(field.flux.var(axis=0, ddof=1).mean())
    assert scatter == pytest.approx(field.flux_error.mean(), rel=0.1)


def test_light_falls_with_the_dither_alike_to_all_sides():
    told = believed(np.random.default_rng(0), 400)
    mean = Sky(0, 0, CALM).expose(told, told.fibre_mm).flux.mean(axis=1)
    near, far = mean[1:7], mean[7:]
    assert near.std() / near.mean() < 0.01
    assert 0.5 < near.mean() / mean[0] < 0.9
    assert far.mean() < 0.6 * near.mean() or far.mean() / near.mean() < 0.75


def test_a_fibre_without_light_counts_noise():
    told = believed(np.random.default_rng(0), 50)
    true_mm = told.fibre_mm.copy()
    true_mm[3] = np.nan
    field = Sky(0, 0, CALM).expose(told, true_mm)
    assert np.abs(field.flux[:, 3] / field.flux_error[:, 3]).max() < 5.0
    assert "no light" in estimate(field).reason[3]


def test_the_same_seed_gives_the_same_field_and_another_number_another():
    told = believed(np.random.default_rng(0), 30)
    one, two, other = (Sky(1, k).expose(told, told.fibre_mm).flux for k in (0, 0, 1))
    assert np.array_equal(one, two)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("size", [1.0, 2.0])
def test_offsets_are_found_whatever_their_size(size):
    """Blind: with offsets twice as large the same errors are left, once those of the first field are used."""
    rng = np.random.default_rng(4)
    offset = size * rng.normal(0.0, 8.0, (120, 2))
    found, known = [], np.zeros((120, 2))
    for number in range(3):
        told = believed(rng, 120)
        # stars fall where the fibres are believed with what is known so far
        told = replace(told, star_mm=told.fibre_mm + in_focal_plane_mm(told.arm_deg, known))
        true_mm = told.fibre_mm + in_focal_plane_mm(told.arm_deg, offset)
        found.append(estimate(Sky(4, number).expose(told, true_mm, hexagon())))
        known = combine(found).offset_um
    error = np.hypot(*(known - offset)[combine(found).n_fields > 0].T)
    assert np.sqrt((error**2).mean()) < 1.3
    assert np.percentile(error, 95) < 2.5
