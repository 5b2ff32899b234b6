"""Generated planes against the numbers that were put in."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.stats import kstest, truncnorm

from fiberloom.errors import InputError
from fiberloom.instruments import generate, instrument_names, load_instrument
from fiberloom.instruments.generated import hexagon, module_sites, spread


def test_the_array_of_sdssv(plane):
    assert plane.n == 500
    assert plane.carries("BOSS").sum() == 500
    assert plane.carries("APOGEE").sum() == 300
    assert len(plane.guide_cameras) == 6
    assert np.linalg.norm(plane.centres_mm, axis=1).max() < 291.2 + 0.5
    # alpha = 0 points to -y
    assert np.rad2deg(plane.arms[:, 3]).mean() == pytest.approx(-90.0 + 0.305, abs=0.15)


def test_holes_are_a_hexagon_with_its_symmetry():
    holes = hexagon(13)
    assert len(holes.q) == 547
    xy = holes.xy_mm(22.4)
    z = (xy[:, 0] + 1j * xy[:, 1]) * np.exp(1j * np.pi / 3)
    distance, _ = cKDTree(xy).query(np.column_stack([z.real, z.imag]))
    assert distance.max() < 1e-9
    assert holes.names()[0] == "R-13C1"
    assert holes.names()[273] == "R0C14"
    assert len(set(holes.names())) == 547


def test_neighbouring_holes_are_one_pitch_apart(plane):
    nominal = hexagon(13).xy_mm(22.4)
    distance, _ = cKDTree(nominal).query(nominal, k=7)
    assert distance[:, 1].max() == pytest.approx(22.4, abs=1e-9)
    # the base of a unit is off by its own shift only: 4 sd of 0.099 mm in both directions
    away, _ = cKDTree(nominal).query(plane.centres_mm)
    assert away.max() < 0.56


def test_fiducials_stand_in_holes_without_positioners(plane):
    gap, _ = cKDTree(plane.centres_mm).query(plane.fiducials[:, :2])
    # one pitch less the shift of the base
    assert gap.min() > 22.4 - 0.56
    assert len(plane.fiducials) == 43 + 18
    inner = plane.fiducials[:43, :2]
    distance, _ = cKDTree(inner).query(inner, k=2)
    np.testing.assert_allclose(distance[:, 1], 22.4 * np.sqrt(13), atol=1e-9)


def test_guide_cameras_are_the_six_segments_of_the_survey(plane):
    # sdss/kaiju: the second one runs from (-56.54, 276.23) to (56.54, 276.23)
    ends = plane.guide_cameras[:, :4].reshape(-1, 2)
    known = np.array([[56.54, 276.23], [-210.95, 187.08], [-267.49, 89.15]])
    known = np.vstack([known, known * [-1, 1], known * [1, -1], -known])
    distance, which = cKDTree(known).query(ends)
    assert distance.max() < 0.02
    assert len(set(which)) == 12


@pytest.fixture(scope="module")
def many(sdssv):
    """Enough units that the distributions can be told from wrong ones."""
    return generate(sdssv, seed=5, n_positioners=4000)


def distribution(scatter, shift=0.0):
    low, high = ((b - scatter.mean) / scatter.sd for b in scatter.bounds)
    return truncnorm(low, high, loc=scatter.mean + shift, scale=scatter.sd).cdf


def test_units_follow_the_scatter(sdssv, many):
    scatter = sdssv.scatter
    measured = {
        "l_alpha_mm": (many.arms[:, 2], distribution(scatter.l_alpha_mm)),
        "alpha_offset_deg": (
            np.rad2deg(many.arms[:, 3]),
            distribution(scatter.alpha_offset_deg, -90.0),
        ),
        "beta_offset_deg": (np.rad2deg(many.arms[:, 4]), distribution(scatter.beta_offset_deg)),
        "beta_length_mm": (
            many.points["metrology"][:, 0],
            distribution(scatter.beta_length_mm, 14.314),
        ),
        "point_x_mm": (
            many.points["BOSS"][:, 0] - many.points["metrology"][:, 0],
            distribution(scatter.point_x_mm, 14.965 - 14.314),
        ),
        "point_y_mm": (many.points["BOSS"][:, 1], distribution(scatter.point_y_mm, -0.376)),
    }
    # seeded, so this passes or fails for good; a mean wrong by 0.1 sd gives p below 1e-5
    for name, (values, cdf) in measured.items():
        assert kstest(values, cdf).pvalue > 1e-3, name


def test_the_base_shifts_in_the_frame_of_the_positioner(sdssv, many):
    nominal = hexagon(40).xy_mm(22.4)
    _, which = cKDTree(nominal).query(many.centres_mm)
    shift = many.centres_mm - nominal[which]
    # turned by -90 deg: the base's x is -y of the plane, its y is x
    # standard error of an sd of 4000 values: 1.1 %
    assert shift[:, 1].std() == pytest.approx(sdssv.scatter.base_x_mm.sd, rel=0.05)
    assert shift[:, 0].std() == pytest.approx(sdssv.scatter.base_y_mm.sd, rel=0.05)


def test_same_seed_same_plane_other_seed_other_units(sdssv, plane):
    assert generate(sdssv, 0).config_hash() == plane.config_hash()
    other = generate(sdssv, 1)
    assert other.config_hash() != plane.config_hash()
    np.testing.assert_array_equal(other.fiducials, plane.fiducials)


def test_a_patch_is_a_part_of_the_whole(plane, patch):
    rows = plane.index_of(patch.positioner_id)
    np.testing.assert_array_equal(patch.arms, plane.arms[rows])
    np.testing.assert_array_equal(patch.hole, plane.hole[rows])
    np.testing.assert_array_equal(patch.points["APOGEE"], plane.points["APOGEE"][rows])
    # compact: 37 positioners and the fiducials between them fit into four rings
    assert np.linalg.norm(patch.centres_mm, axis=1).max() < 4 * 22.4


def test_a_larger_array_grows(sdssv):
    large = generate(sdssv, 0, 2000)
    assert large.n == 2000
    assert np.unique(large.hole).size == 2000
    edge = np.linalg.norm(large.centres_mm, axis=1).max()
    assert np.linalg.norm(large.guide_cameras[:, :2], axis=1).min() > edge - 40
    assert large.positioner_id.max() == 2000


def test_impossible_numbers(sdssv):
    with pytest.raises(InputError, match="must be at least 1"):
        generate(sdssv, 0, 0)
    crowded = sdssv.layout.model_copy(update={"n_positioners": 520})
    with pytest.raises(InputError, match="leaves 504 holes for n_positioners = 520"):
        generate(sdssv.model_copy(update={"layout": crowded}), 0)


@pytest.mark.parametrize(("n", "fraction"), [(500, 0.6), (7, 1 / 3), (10, 1.0), (1, 0.2)])
def test_spread_is_even(n, fraction):
    chosen = spread(n, fraction)
    assert chosen.sum() == round(n * fraction)
    # over the first k, never more than one off from its share
    share = np.arange(1, n + 1) * chosen.sum() / n
    assert np.abs(np.cumsum(chosen) - share).max() <= 1.0


def test_petals_are_one_wedge_turned():
    desi = generate(load_instrument("desi"), 0)
    assert desi.n == 5000
    assert len(desi.fiducials) == 4 * 130
    turned = np.exp(2j * np.pi / 10) * (desi.fiducials[:, 0] + 1j * desi.fiducials[:, 1])
    distance, _ = cKDTree(desi.fiducials[:, :2]).query(np.column_stack([turned.real, turned.imag]))
    assert distance.max() < 1e-9
    # the gap between petals: no centre nearer to an edge than half of it, less the shift of a base
    angle = np.arctan2(*desi.centres_mm.T[::-1])
    off = (angle + np.pi / 10) % (np.pi / 5)
    to_edge = np.hypot(*desi.centres_mm.T) * np.sin(np.minimum(off, np.pi / 5 - off))
    assert to_edge.min() > 5.2 - 0.3
    assert np.hypot(*desi.centres_mm.T).max() < 412.3
    gap, _ = cKDTree(desi.centres_mm).query(desi.centres_mm, k=2)
    assert gap[:, 1].min() > 10.4 - 0.4


def test_no_hole_is_beside_a_guide_camera():
    """Where a folded arm would reach it. The tables of the instrument have none nearer than 6.4 mm."""
    desi = load_instrument("desi")
    cameras = [part for part in desi.bodies.keep_outs if part.polygon_mm]
    assert len(cameras) == 1
    centres = generate(desi, 0).centres_mm
    nearest = np.min([part.distance_mm(centres) for part in cameras], axis=0)
    assert nearest.min() > desi.layout.keep_out_gap_mm - 0.3  # a base is shifted by some 0.05 mm
    anywhere = desi.model_copy(update={"layout": desi.layout.model_copy(update={"keep_out_gap_mm": 0.0})})
    centres = generate(anywhere, 0).centres_mm
    inside = np.min([part.distance_mm(centres) for part in cameras], axis=0) == 0.0
    assert 40 < inside.sum() < 100


def test_the_presets_of_table_1():
    """Kronig 2020, Table 1: units, arms, pitch, requirement. PFS has 2394, not 2400; see the preset."""
    table = {
        "lamost": (4000, 8.25, 8.25, 25.6, 40.0),
        "megara": (92, 5.803, 5.803, 20.1, 102.0),
        "desi": (5000, 3.0, 3.0, 10.4, 5.0),
        "sdssv": (500, 7.4, 15.0, 22.4, 5.0),
        "moons": (1001, 8.0, 17.0, 25.0, 20.0),
        "pfs": (2394, 2.375, 2.375, 8.0, 5.0),
    }
    assert set(table) == set(instrument_names())
    for name, (units, l_alpha, l_beta, pitch, requirement) in table.items():
        i = load_instrument(name)
        fibre = i.positioner.points[i.science_fibres[0]]
        assert (i.layout.n_positioners, i.layout.pitch_mm) == (units, pitch)
        assert i.operation.requirement_um == requirement
        assert i.positioner.l_alpha_mm == pytest.approx(l_alpha, abs=1e-3)
        assert np.hypot(fibre.x_mm, fibre.y_mm) == pytest.approx(l_beta, abs=0.04)
        assert generate(i, 0).n == units


def test_a_round_field_grows_with_its_positioners(sdssv):
    layout = sdssv.layout.model_copy(update={"field_radius_mm": 200.0, "n_positioners": 200})
    small = sdssv.model_copy(update={"layout": layout})
    assert np.hypot(*generate(small, 0).centres_mm.T).max() < 200.6
    assert generate(small, 0, 400).n == 400


@pytest.fixture(scope="module")
def pfs():
    return generate(load_instrument("pfs"), 0)


def test_cobras_are_numbered_by_field_module_and_place(pfs):
    """Subaru-PFS/pfs_utils, grandfibermap: cobra 172 is place 1 of module 4 at (-48.497, 28.000) mm, and
    cobra 2394 the last one."""
    xy, names = module_sites(pfs.instrument.layout.modules, 8.0)
    assert pfs.positioner_id.tolist() == list(range(1, 2395))
    np.testing.assert_allclose(xy[[171, 172, 179]], [[-48.497, 28], [-55.426, 24], [-48.497, -4]], atol=6e-4)
    assert names[[0, 56, 57, 171, 798, 2393]].tolist() == [
        "SC01P01", "SC01P57", "SC02P01", "SC04P01", "SC15P01", "SC42P57",
    ]  # fmt: skip
    # three fields, each the one before turned by -120 deg; neighbours 8 mm apart
    turn = np.exp(-2j * np.pi / 3)
    z = xy @ [1, 1j]
    np.testing.assert_allclose(z[798:1596], turn * z[:798], atol=1e-9)
    distance, _ = cKDTree(xy).query(xy, k=2)
    np.testing.assert_allclose(distance[:, 1], 8.0, atol=1e-9)
    assert np.abs(z).max() == pytest.approx(224.0, abs=0.01)


def test_a_part_of_the_modules_keeps_its_numbers_and_dots(pfs):
    few = generate(load_instrument("pfs"), 0, 50)
    rows = pfs.index_of(few.positioner_id)
    np.testing.assert_array_equal(few.dots_mm, pfs.dots_mm[rows])
    off = pfs.dots_mm[:, :2] - pfs.centres_mm
    # 2394 values of sd 0.14, and 0.07 of the centres: standard error 0.003
    np.testing.assert_allclose(off.mean(axis=0), [-0.16, 2.26], atol=0.012)
    np.testing.assert_allclose(off.std(axis=0), np.hypot(0.14, 0.07), atol=0.01)
    with pytest.raises(InputError, match="n_positioners = 2395: the modules have 2394"):
        generate(load_instrument("pfs"), 0, 2395)


def test_fiducials_of_modules_stand_between_cobras(pfs):
    assert len(pfs.fiducials) == 96
    # the first spoke, at 150 deg: 18 mm and steps of 16 mm
    spoke = pfs.fiducials[:14, :2] @ [1, 1j]
    np.testing.assert_allclose(spoke, (18 + 16 * np.arange(14)) * np.exp(1j * np.pi * 5 / 6), atol=1e-3)
    xy, _ = module_sites(pfs.instrument.layout.modules, 8.0)
    assert cKDTree(xy).query(pfs.fiducials[:, :2])[0].min() > 5.99
