"""Figures of the monitor that follow from geometry, from its stated rules, or by hand."""

import re

import numpy as np
import pytest
from visits import Trouble, Visits

from fiberloom.health.habits import ArmFit
from fiberloom.health.monitor import Ailment, HealthMonitor, ObservedMove
from fiberloom.health.settings import HealthSettings
from fiberloom.instruments import generate, load_instrument
from fiberloom.metrology.noise import CorrectionNoise

PLANE = generate(load_instrument("sdssv"), seed=0, n_positioners=3)
ALL = np.ones(len(PLANE), dtype=bool)
AT = np.array([40.0, 90.0])


def moved(monitor, before_deg, believed_deg, true_deg, seen=ALL):
    """One move of every positioner, from, to where they believe, and where their fibres are."""
    shape = (len(PLANE), 2)
    before, believed, true = (np.broadcast_to(a, shape) for a in (before_deg, believed_deg, true_deg))
    place_mm = np.where(seen[:, None], PLANE.forward(*true.T, "metrology"), np.nan)
    monitor.update(ObservedMove(before, believed, place_mm, ALL, ALL))


# -- the fit of offsets and arm length ---------------------------------------------------------------------

ALPHA_AND_BETA = np.array([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
ARM = np.array([[[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]])


def test_a_measurement_as_good_as_what_is_assumed_counts_half():
    """Before anything was seen: 0.1 deg of each offset, 20 um of the arm."""
    fit = ArmFit(1, memory=1.0)
    fit.add(np.array([0]), ALPHA_AND_BETA, np.array([[0.08, -0.06]]), 0.1**2 * np.eye(2)[None])
    np.testing.assert_allclose(fit.offsets_deg(), [[0.04, -0.03]])
    fit.add(np.array([0]), ARM, np.array([[0.01, 0.0]]), 0.02**2 * np.eye(2)[None])
    np.testing.assert_allclose(fit.longer_mm(), [0.005])
    np.testing.assert_allclose(fit.solved(0), [0.04, -0.03, 0.005])


def test_the_fit_forgets_within_about_ten_fields():
    fit = ArmFit(1, HealthSettings().memory)
    for offset_deg, fields in ((0.0, 60), (0.05, 10)):
        for _ in range(fields):
            off_mm = np.array([[offset_deg, 0.0]])
            fit.add(np.array([0]), ALPHA_AND_BETA, off_mm, 0.01**2 * np.eye(2)[None])
    # of ten fields 1 - 0.9^10 = 65 % are new; a little less for the prior of no offset
    assert fit.offsets_deg()[0, 0] == pytest.approx(0.65 * 0.05, rel=0.02)


def test_an_image_scatters_by_the_camera_alone_where_maps_are_perfect():
    """The 2-D rms of a camera is sqrt(2) of that of each coordinate."""
    monitor = HealthMonitor(PLANE, noise=CorrectionNoise(camera_um=3.0, blind_um=0.0))
    variance_mm2 = monitor._image_variance(np.ones((3, 2, 2)), np.arange(3))
    rms_um = 1e3 * np.sqrt(np.trace(variance_mm2, axis1=1, axis2=2))
    np.testing.assert_allclose(rms_um, 3.0, rtol=1e-6)
    np.testing.assert_array_equal(variance_mm2[:, 0, 1], 0.0)


# -- when it began -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("healthy", [0, 5])
def test_a_finding_says_at_which_move_it_became_more_than_chance(healthy):
    """A dark image adds ln(0.99 / 1e-4) = 9.2; half of the alarm of 20 is passed by the second one."""
    monitor = HealthMonitor(PLANE)
    for _ in range(healthy):
        moved(monitor, AT, AT, AT)
    for _ in range(3):
        moved(monitor, AT, AT, AT, seen=np.array([True, False, True]))
    assert monitor.moves == healthy + 3
    (finding,) = monitor.findings()
    assert finding.ailment is Ailment.DARK
    assert finding.positioner_id == PLANE.positioner_id[1]
    assert finding.since_move == healthy + 2


# -- ways that were not gone -------------------------------------------------------------------------------


def stills(way_deg, gone_deg):
    """Ways of alpha counted as not gone, for one way after a first image."""
    monitor = HealthMonitor(PLANE)
    start = np.array([5.0, 90.0])
    moved(monitor, start, start, start)
    moved(monitor, start, np.add(start, [way_deg, 0.0]), np.add(start, [gone_deg, 0.0]))
    return monitor.stills_in_a_row[:, 0].tolist()


def test_nearly_a_whole_turn_that_was_gone_is_no_way_that_was_not_gone():
    # 352 deg end 8 deg beside the begin: less than 3 % of the way
    assert stills(352.0, 352.0) == [0, 0, 0]
    assert stills(280.0, 280.0) == [0, 0, 0]
    assert stills(280.0, 0.0) == [1, 1, 1]


def test_a_way_of_twelve_standard_deviations_tells():
    """Blind moves scatter by 16 um a coordinate and image: 0.055 deg of alpha, between two of them."""
    lever_mm = np.hypot(PLANE.l_alpha_mm, PLANE.l_beta_mm)
    sd_deg = np.rad2deg(1.6 * 0.010 / lever_mm)
    for share, tells in ((11.0, 0), (15.0, 1)):
        way_deg = share * sd_deg.mean()
        # below 0.3 mm: the places alone do not tell
        assert (np.deg2rad(way_deg) * lever_mm).max() < 0.3
        assert stills(way_deg, 0.0) == [tells] * 3


# -- slips -------------------------------------------------------------------------------------------------


def slip_score(jump_deg, at_deg):
    """Of a jump of alpha that stays, seen first at `at_deg`."""
    monitor = HealthMonitor(PLANE)
    moved(monitor, AT, AT, AT)
    here, on = np.array([at_deg, 90.0]), np.array([at_deg + 60.0, 90.0])
    moved(monitor, AT, here, np.add(here, [jump_deg, 0.0]))
    moved(monitor, here, on, np.add(on, [jump_deg, 0.0]))
    return monitor.slip.score[:, 0] / monitor.settings.alarm


def across(row, direction):
    """Alpha at which the fibre of a row goes along x (0) or y (1) as alpha turns, beta at 90 deg."""
    angles = np.arange(60.0, 240.0, 0.5)
    columns = PLANE.jacobian(angles, np.full(len(angles), 90.0), "metrology", index=np.full(len(angles), row))
    return angles[np.argmin(np.abs(columns[:, 1 - direction, 0]))]


@pytest.mark.parametrize("direction", [0, 1])
@pytest.mark.parametrize("row", range(3))
def test_a_jump_beyond_a_third_of_a_millimetre_is_a_slip_in_whatever_direction_it_is_seen(row, direction):
    at_deg = across(row, direction)
    assert slip_score(1.5, at_deg)[row] == pytest.approx(1.1)
    # 0.2 mm are more than eight standard deviations, and are left to the fit
    assert slip_score(0.7, at_deg)[row] == 0.0


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("size", [0.5, -0.5, 0.9, -0.9])
def test_the_evidence_of_a_slip_has_its_size_and_sign(axis, size):
    monitor = HealthMonitor(PLANE)
    for passage in Visits(PLANE, 1, (Trouble("slipped", 1, axis, start=61, size=size),)).run(45):
        monitor.update(passage)
    (finding,) = monitor.findings()
    assert finding.ailment is Ailment.SLIPPED
    told = [float(x) for x in re.findall(r"[-+]\d+\.\d+", finding.evidence)]
    # the map's ripple is 0.025 deg rms; the prior and the lesser weight of wild misses draw towards zero
    assert told[axis] == pytest.approx(size, abs=0.2 * abs(size))
    assert told[1 - axis] == pytest.approx(0.0, abs=0.08)


def test_an_offset_that_is_known_is_no_miss_of_every_place():
    """An offset of 0.3 deg is 5 standard deviations of each place until it is learnt; then none."""
    monitor = HealthMonitor(PLANE)
    rng = np.random.default_rng(0)
    before = np.tile([40.0, 90.0], (3, 1))
    scores = []
    for _ in range(40):
        to = rng.uniform([10.0, 30.0], [340.0, 150.0], (3, 2))
        moved(monitor, before, to, np.add(to, [0.3, 0.0]))
        before = to
        scores.append(monitor.everywhere.score[:, 0].max())
    assert scores[-1] == 0.0
    # the prior of no offset draws it by a tenth
    np.testing.assert_allclose(monitor.geometry.offsets_deg(), [[0.3, 0.0]] * 3, atol=0.04)


# -- scatter -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("alpha_deg", [0.0, 30.0, 75.0, 120.0, 200.0, 290.0])
def test_a_miss_of_beta_is_across_the_beta_arm_wherever_that_points(alpha_deg):
    monitor = HealthMonitor(PLANE)
    off_deg = 0.05
    at = np.array([alpha_deg, 90.0])
    moved(monitor, at, at, at)
    moved(monitor, at, np.add(at, [0.01, 0.0]), np.add(at, [0.01, off_deg]))
    fibre_mm = PLANE.forward(*np.tile(at, (3, 1)).T, "metrology")
    lever_mm = np.hypot(*(fibre_mm - PLANE.elbows_mm(np.full(3, alpha_deg))).T)
    # the newest move weighs a tenth
    across_mm = np.sqrt(monitor._wobble_mm2[:, 1] / 0.1)
    np.testing.assert_allclose(across_mm, lever_mm * np.deg2rad(off_deg), rtol=2e-3)
    np.testing.assert_allclose(monitor._wobble_mm2[:, 0], 0.0, atol=1e-8)
