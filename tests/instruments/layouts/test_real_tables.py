"""Public tables of DESI, PFS and MEGARA, where they lie beside the checkout, against what is known."""

import csv
import gzip

import numpy as np
import pytest
from scipy.spatial import cKDTree

import fiberloom as fl
from fiberloom.drive.piezo import read_module_maps
from fiberloom.errors import InputError


@pytest.fixture(scope="module")
def desi(shared_desi):
    return fl.FocalPlane.read(shared_desi, "desi")


def test_desi_stands_where_the_survey_says(desi, shared_desi):
    """The table holds the places in CS5 too, by desimeter's own transformations; we do not read these."""
    last = {}
    with gzip.open(shared_desi / "calib-20260303.csv.gz", "rt") as text:
        for row in csv.DictReader(text):
            place = int(row["location"])
            if place not in last or row["time_recorded"] > last[place]["time_recorded"]:
                last[place] = row
    assert desi.n == len(last) == 5020
    cs5 = [[float(last[k][f"offset_{c}_cs5"]) for c in "xy"] for k in desi.positioner_id.tolist()]
    off_um = 1e3 * np.hypot(*(desi.centres_mm - cs5).T)
    assert np.median(off_um) < 0.1
    assert off_um.max() < 1.0
    working = [last[k]["device_classified_nonfunctional"] == "False" for k in desi.positioner_id.tolist()]
    np.testing.assert_array_equal(~desi.offline, working)
    # 4647 rows are of functional units; one of these stands where a later one does not work
    assert sum(working) == 4646


def test_desi_s_units_are_those_of_the_published_statistics(desi):
    moves = ~desi.offline
    assert np.median(desi.l_alpha_mm[moves]) == pytest.approx(3.0, abs=0.02)
    assert np.median((desi.l_alpha_mm + desi.l_beta_mm)[moves]) == pytest.approx(6.065, abs=0.01)
    theta, phi = np.ptp(desi.stops_of(), axis=2)[moves].T
    assert (theta.mean(), phi.mean()) == (pytest.approx(392.24, abs=0.05), pytest.approx(191.17, abs=0.05))
    assert (desi.stops_of()[:, 1, 1] == 185.0).all()
    low, high = np.moveaxis(desi.limits_of(), -1, 0)
    assert (low + np.array([0.0, -3.0]) >= desi.stops_of()[..., 0] + 3.0 - 1e-9).all()
    assert (high + np.array([3.0, 0.0]) <= desi.stops_of()[..., 1] - 3.0 + 1e-9).all()
    distance, _ = cKDTree(desi.centres_mm).query(desi.centres_mm, k=2)
    assert np.median(distance[:, 1]) == pytest.approx(10.4, abs=0.02)
    assert len(desi.fiducials) == 473
    assert desi.fiducials[:, :2].max() < 430.0


def test_the_edges_of_petals_lie_between_petals(desi):
    """No centre is nearer than 5 mm to an edge: the arms' own discs fit in."""
    edges = np.vstack([part.capsules_mm for part in desi.instrument.bodies.keep_outs if part.line_mm])
    assert len(edges) == 10
    along = edges[:, 2:4] / np.hypot(*edges[:, 2:4].T)[:, None]
    off = np.abs(desi.centres_mm @ np.column_stack([-along[:, 1], along[:, 0]]).T)
    ahead = desi.centres_mm @ along.T > 0.0
    assert off[ahead].min() == pytest.approx(5.13, abs=0.15)


def _corners_of_arms(desi, angles_deg):
    """(n, 7) complex places in mm of the corners of each phi arm, as wide as the unit's own is."""
    phi = np.array(next(part.polygon_mm for part in desi.instrument.bodies.parts if part.arm == "beta"))
    alpha = np.deg2rad(angles_deg[:, 0]) + desi.alpha_off_rad
    turn = alpha + np.deg2rad(angles_deg[:, 1]) + desi.beta_off_rad
    elbow = desi.centres_mm @ [1.0, 1.0j] + desi.l_alpha_mm * np.exp(1j * alpha)
    return elbow[:, None] + (phi @ [1.0, 1.0j]) * np.exp(1j * turn)[:, None]


def _to_cameras_mm(desi, places):
    cameras = [part for part in desi.instrument.bodies.keep_outs if part.polygon_mm]
    assert len(cameras) == 10
    xy = np.column_stack([places.real.ravel(), places.imag.ravel()])
    return np.min([part.distance_mm(xy) for part in cameras], axis=0).reshape(places.shape).min(axis=1)


def test_guide_cameras_are_beside_all_folded_arms_and_in_the_way_of_some(desi):
    """Each petal has one, and it is nearest to the same places of each."""
    apart = _to_cameras_mm(desi, _corners_of_arms(desi, desi.park_deg)) - desi.handicaps.wider_mm
    assert apart.min() > 1.0
    centres = desi.centres_mm @ [[1.0], [1.0j]]
    beside = desi.select(np.flatnonzero(_to_cameras_mm(desi, centres) < 15.0))  # arms end within 8 mm
    stretched = np.zeros((beside.n, 2))
    met = np.zeros(beside.n, dtype=bool)
    for alpha in np.arange(0.0, 360.0, 5.0):
        stretched[:, 0] = alpha
        met |= _to_cameras_mm(beside, _corners_of_arms(beside, stretched)) < beside.handicaps.wider_mm
    of_petals = np.bincount(beside.positioner_id[met] // 1000, minlength=10)
    assert of_petals.tolist() == [2, 2, 2, 2, 2, 2, 2, 1, 2, 2]
    assert {place % 1000 for place in beside.positioner_id[met].tolist()} == {459, 526}


def test_desi_s_fibres_come_back(desi):
    """A round trip with all units at once, each within its own range."""
    rng = np.random.default_rng(0)
    low, high = np.moveaxis(desi.limits_of(), -1, 0)
    angles = low + rng.random(low.shape) * (high - low)
    xy = desi.forward(*angles.T)
    found = desi.inverse(xy, near_deg=angles)
    assert found.reachable.all()
    again = desi.forward(found.alpha_deg, found.beta_deg)
    assert np.abs(again - xy).max() < 1e-8


@pytest.fixture(scope="module")
def pfs(shared_pfs):
    return fl.FocalPlane.read(shared_pfs, "pfs")


def test_cobras_are_the_lattice_with_their_dots_beside_them(pfs, shared_pfs):
    with gzip.open(shared_pfs / "grandfibermap.txt.gz", "rt") as text:
        rows = [line.split() for line in text if not line.startswith("\\")]
    rows = [row for row in rows if row[0] != "-"]
    known = {int(row[0]): (float(row[9]), float(row[10])) for row in rows}
    assert sorted(known) == pfs.positioner_id.tolist()
    from fiberloom.instruments.generated import module_sites

    lattice, _ = module_sites(pfs.instrument.layout.modules, pfs.instrument.layout.pitch_mm)
    # the file has three digits
    np.testing.assert_allclose(lattice, [known[k] for k in pfs.positioner_id.tolist()], atol=0.6e-3)
    off = pfs.dots_mm[:, :2] - lattice
    for field in range(3):
        one = off[798 * field : 798 * (field + 1)]
        assert one.std(axis=0).max() < 0.16
        assert 2.0 < one[:, 1].mean() < 2.6
    assert np.abs(pfs.dots_mm[:, 2] - 0.75).max() < 0.01


def test_cobras_have_the_arms_and_ranges_of_their_modules(pfs):
    moves = ~pfs.offline
    assert 0 < pfs.offline.sum() < 50  # failed fits
    theta, phi = np.ptp(pfs.stops_of(), axis=2)[moves].T
    assert (np.median(theta), np.median(phi)) == (
        pytest.approx(380.1, abs=0.05),
        pytest.approx(185.95, abs=0.05),
    )
    for arm in (pfs.l_alpha_mm, pfs.l_beta_mm):
        low, middle, high = np.percentile(arm[moves], [1, 50, 99])
        assert middle == pytest.approx(2.375, abs=0.002)
        assert 2.1 < low < 2.25 < 2.6 < high < 2.7
    low, high = np.moveaxis(pfs.limits_of(), -1, 0)[:, :, 1]
    assert (low < -155.0).all()  # three of module 19 fold to -158 deg only
    assert (high <= 0.0).all()
    assert len(pfs.fiducials) == 92  # of 96, four were never measured


def test_maps_of_a_module_are_those_of_the_summary(shared_pfs):
    maps = read_module_maps(shared_pfs / "SC03_final.xml.gz")
    slow = np.load(shared_pfs / "derived" / "pfs_2394_motor_maps_slow.npz")
    rows = np.flatnonzero(slow["module"] == "SC03")
    rows = rows[np.argsort(slow["positioner"][rows])]
    assert maps.motors == 2 * 57
    for link, motor in enumerate(("theta", "phi")):
        for way, name in enumerate(("fwd", "rev")):
            told = slow[f"{motor}_{name}_deg_per_step"][rows].astype(np.float64)
            # half a unit in the last place of 16 bits, relative
            np.testing.assert_allclose(maps.step_deg[link::2, way], told, rtol=0.5e-3)
    assert maps.bin_deg == pytest.approx(400.0 / 112.0, abs=1e-4)
    assert np.median(maps.pulse_us[::2]) == pytest.approx(44.0, abs=4.0)
    assert np.median(maps.pulse_us[1::2]) == pytest.approx(22.0, abs=4.0)


@pytest.fixture(scope="module")
def megara(shared_megara):
    return fl.FocalPlane.read(shared_megara, "megara")


def test_megara_s_robots(megara, shared_megara):
    assert megara.n == 100
    moves = ~megara.offline
    assert moves.sum() == 92
    assert megara.positioner_id[megara.offline].tolist() == list(range(93, 101))
    l_alpha, l_beta = megara.l_alpha_mm[moves], megara.l_beta_mm[moves]
    assert (l_alpha.mean(), l_alpha.std()) == (pytest.approx(5.886, abs=1e-3), pytest.approx(0.09, abs=1e-3))
    assert (l_beta.mean(), l_beta.std()) == (pytest.approx(5.867, abs=1e-3), pytest.approx(0.094, abs=1e-3))
    turn = np.degrees(megara.alpha_off_rad[moves])
    assert (turn.mean(), turn.std()) == (pytest.approx(-0.01, abs=0.01), pytest.approx(0.58, abs=0.02))
    theory = np.genfromtxt(shared_megara / "positionerCenters_theoretical_92RPs.txt", delimiter="|")
    off = megara.centres_mm[megara.index_of(theory[:, 0].astype(int))] - theory[:, 1:]
    np.testing.assert_allclose(off.mean(axis=0), [-0.011, -0.004], atol=6e-4)
    np.testing.assert_allclose(off.std(axis=0), [0.013, 0.017], atol=6e-4)


def test_megara_s_exclusion_area_is_free_of_folded_arms_and_within_reach_of_six(megara):
    """The frame of the bundle in the middle; folded, an arm keeps within its elbow's circle and the bar."""
    (area,) = megara.instrument.bodies.keep_outs
    apart = area.distance_mm(megara.centres_mm)
    assert apart.min() == pytest.approx(9.3, abs=0.1)  # 9.8 mm less its margin
    folded = megara.beta_segments(*megara.park_deg.T)
    for end in (folded[:, :2], folded[:, 2:]):
        assert area.distance_mm(end).min() > megara.collision_buffer_mm
    beside = np.flatnonzero(apart < megara.body_reach_mm)
    assert len(beside) == 6
    names = np.arange(6).astype(str)
    # a target for each, out on its own side or in on that of the area
    centres = megara.centres_mm[beside]
    out = centres / np.hypot(*centres.T)[:, None]
    for side, most in ((1.0, 6), (-1.0, 2)):
        xy = (centres + 11.0 * side * out).T
        targets = fl.TargetList(names, *xy, np.zeros(6), np.full(6, ""), np.full(6, -1))
        found = fl.assign(megara, targets)
        assert found.n_assigned <= most
        goals = megara.forward(*found.goal_deg.T)[found.target >= 0]
        assert (area.distance_mm(goals) > 0.0).all()
        if side > 0.0:
            assert found.n_assigned == 6
        else:
            why = list(found.unassigned.values())
            assert all("would touch a fiducial, a guide camera or an offline neighbour" in one for one in why)
            assert len(why) >= 4


def test_tables_of_another_instrument_are_refused(shared_desi, shared_pfs, shared_megara):
    for folder, name, use in (
        (shared_desi, "pfs", "use --instrument desi"),
        (shared_desi, "sdssv", "use --instrument desi"),
        (shared_pfs, "desi", "no layout.modules; use pfs"),
        (shared_megara, "lamost", "use --instrument megara"),
    ):
        with pytest.raises(InputError, match=use):
            fl.FocalPlane.read(folder, name)
