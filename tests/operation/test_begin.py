"""The begin check: what an image says of positions that are only reported."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom.instruments import generate, load_instrument
from fiberloom.metrology import Measurement
from fiberloom.operation.safety.begin import Report, Standing, allowed_miss_mm, begin_check
from fiberloom.planning import random_configuration

PLANE = generate(load_instrument("sdssv"), 0, n_positioners=37)
DEPLOYED = random_configuration(PLANE, 3)
TURN_DEG = 360.0 / PLANE.instrument.alpha.gear
SCATTER_MM = 0.02
NOBODY = np.zeros(37, dtype=bool)


def image(true_deg, dark=(), seed=0):
    """Where the fibres are seen with these true angles; rows `dark` are not."""
    xy = PLANE.forward(*true_deg.T) + np.random.default_rng(seed).normal(0.0, SCATTER_MM, (37, 2))
    seen = ~np.isin(np.arange(37), dark)
    x, y = np.where(seen[:, None], xy, np.nan).T
    return Measurement(x, y, seen, 0.0)


def checked(reported_deg, true_deg, dark=(), vouched=NOBODY, answered=~NOBODY):
    return begin_check(PLANE, Report(reported_deg, answered, image(true_deg, dark), vouched))


def off(row, alpha_deg=0.0, beta_deg=0.0, at_deg=DEPLOYED):
    """Angles in which one positioner is elsewhere."""
    moved = at_deg.copy()
    moved[row] += (alpha_deg, beta_deg)
    return moved


def test_healthy_positioners_may_all_move():
    for at_deg in (DEPLOYED, PLANE.park_deg):
        found = checked(at_deg, at_deg)
        assert found.certain.all()
        assert not found.somewhere.any()
        assert set(found.standing) == {Standing.RIGHT}
        np.testing.assert_array_equal(found.where_deg, at_deg)


@settings(max_examples=60, deadline=None)
@given(row=st.integers(0, 36), alpha_deg=st.floats(-180.0, 180.0), beta_deg=st.floats(-90.0, 90.0))
def test_whoever_may_move_is_nowhere_off_by_more_than_allowed(row, alpha_deg, beta_deg):
    true_deg = off(row, alpha_deg, beta_deg)
    found = checked(DEPLOYED, true_deg)
    assert found.certain[np.arange(37) != row].all()
    if found.certain[row]:
        miss = PLANE.forward(*true_deg.T)[row] - PLANE.forward(*DEPLOYED.T)[row]
        assert np.hypot(*miss) < 0.5 + 4.0 * SCATTER_MM


@pytest.mark.parametrize("alpha_deg", [3.0, -3.0, 15.0, 40.0, 60.0, 180.0])
def test_a_wrong_alpha_is_named_and_placed(alpha_deg):
    row = 11
    found = checked(DEPLOYED, off(row, alpha_deg))
    assert found.standing[row] is Standing.DATUM
    assert not found.certain[row]
    assert not found.somewhere[row]
    placed = PLANE.forward(*found.where_deg.T)[row]
    assert np.hypot(*(placed - PLANE.forward(*off(row, alpha_deg).T)[row])) < 0.1
    assert "datum" in found.text[row]


def test_three_degrees_are_seen_in_a_folded_arm_too():
    found = checked(PLANE.park_deg, off(5, 3.0, at_deg=PLANE.park_deg))
    assert not found.certain[5]
    assert found.certain.sum() == 36


@pytest.mark.parametrize(("turns", "moves"), [(2, True), (5, False)])
def test_whole_motor_turns_are_named(turns, moves):
    row = int(np.argmax(np.hypot(*(PLANE.forward(*DEPLOYED.T) - PLANE.centres_mm).T)))
    found = checked(DEPLOYED, off(row, turns * TURN_DEG))
    assert found.standing[row] is Standing.TURNS
    assert found.certain[row] == moves


@pytest.mark.parametrize(("beta_deg", "certain"), [(185.0, True), (277.0, False), (-3.0, True)])
def test_where_no_map_holds_it_is_an_obstacle_where_it_reports(beta_deg, certain):
    there = DEPLOYED.copy()
    there[4, 1] = beta_deg
    found = checked(there, there)
    assert found.certain[4] == certain
    assert (found.standing[4] is Standing.BEYOND) != certain
    np.testing.assert_array_equal(found.where_deg[4], there[4])
    assert not found.somewhere[4]


def test_two_that_have_changed_their_numbers():
    a, b = 7, 8
    assert np.hypot(*(PLANE.centres_mm[a] - PLANE.centres_mm[b])) < 30.0
    reported = DEPLOYED.copy()
    reported[[a, b]] = DEPLOYED[[b, a]]
    found = checked(reported, DEPLOYED)
    assert [found.standing[i] for i in (a, b)] == [Standing.SWAPPED] * 2
    assert str(PLANE.positioner_id[b]) in found.text[a]
    assert not found.certain[[a, b]].any()


def test_a_dark_one_moves_only_where_its_datum_is_on_record():
    dark = (3, 20)
    vouched = NOBODY.copy()
    vouched[20] = True
    found = checked(DEPLOYED, off(3, 40.0), dark=dark, vouched=vouched)
    assert found.standing[3] is Standing.DARK
    assert found.somewhere[3]
    assert not found.certain[3]
    assert found.standing[20] is Standing.VOUCHED
    assert found.certain[20]


def test_a_silent_one_is_an_obstacle_where_it_is_seen():
    answered = ~NOBODY
    answered[[4, 9]] = False
    reported = DEPLOYED.copy()
    reported[[4, 9]] = 0.0  # nothing was read
    found = checked(reported, DEPLOYED, dark=(9,), answered=answered)
    assert [found.standing[i] for i in (4, 9)] == [Standing.SILENT] * 2
    assert not found.certain[[4, 9]].any()
    np.testing.assert_allclose(found.where_deg[4], DEPLOYED[4], atol=0.5)
    assert found.somewhere[9]
    assert not found.somewhere[4]


def test_arms_that_overlap_as_reported_are_an_alarm_and_the_one_that_is_seen_there_moves():
    a, b = 7, 8
    # b is stretched towards a's centre, as it says; a is seen where it reports
    towards = PLANE.centres_mm[a] - PLANE.centres_mm[b]
    alpha_deg = np.rad2deg(np.arctan2(towards[1], towards[0]) - PLANE.alpha_off_rad[b])
    reported = PLANE.park_deg.copy()
    reported[b] = (alpha_deg % 360.0, 0.0)
    found = checked(reported, PLANE.park_deg)
    assert found.alarms == [b]
    assert found.certain[a]
    assert not found.certain[b]


def test_those_that_have_not_answered_report_nothing_that_overlaps():
    a, b = 7, 8
    towards = PLANE.centres_mm[a] - PLANE.centres_mm[b]
    alpha_deg = np.rad2deg(np.arctan2(towards[1], towards[0]) - PLANE.alpha_off_rad[b])
    unread = PLANE.park_deg.copy()
    unread[b] = (alpha_deg % 360.0, 0.0)  # of nobody
    answered = ~NOBODY
    answered[b] = False
    found = checked(unread, PLANE.park_deg, answered=answered)
    assert found.alarms == []
    assert found.standing[b] is Standing.SILENT
    assert found.certain[a]


def test_what_is_allowed_shrinks_with_the_radius_of_the_fibre():
    stretched = PLANE.forward(np.full(37, 10.0), np.zeros(37))
    folded = PLANE.forward(*PLANE.park_deg.T)
    np.testing.assert_allclose(allowed_miss_mm(PLANE, stretched), 0.5, rtol=1e-3)
    # the same error of alpha, seen at either radius
    ratio = np.hypot(*(folded - PLANE.centres_mm).T) / np.hypot(*(stretched - PLANE.centres_mm).T)
    np.testing.assert_allclose(allowed_miss_mm(PLANE, folded), 0.5 * ratio, rtol=1e-3)


@pytest.mark.parametrize("name", ["pfs", "desi"])
def test_an_arm_folded_onto_its_axis_needs_its_datum_on_record(name):
    equal = generate(load_instrument(name), 0, n_positioners=7)
    folded = np.column_stack([np.full(7, 30.0), equal.park_deg[:, 1]])
    xy = equal.forward(*folded.T)
    assert (allowed_miss_mm(equal, xy) < 0.03).all()  # both arms are of the same length
    seen = Measurement(*xy.T, np.ones(7, dtype=bool), 0.0)
    for vouched in (False, True):
        report = Report(folded, np.ones(7, dtype=bool), seen, np.full(7, vouched))
        found = begin_check(equal, report)
        assert found.certain.all() == vouched
        assert set(found.standing) == {Standing.RIGHT if vouched else Standing.BLIND}


def test_a_layout_that_is_not_known_is_allowed_to_those_with_a_datum():
    """0.35 mm off, folded: of an angle it would be three times as much stretched, of a layout it is all."""
    folded = PLANE.park_deg.copy()
    seen = image(folded)
    seen.x_mm[3] += 0.35
    allowed = [
        begin_check(PLANE, Report(folded, ~NOBODY, seen, vouched), 0.5, layout_mm).certain[3]
        for vouched, layout_mm in ((NOBODY, 0.5), (~NOBODY, 0.0), (~NOBODY, 0.5))
    ]
    assert allowed == [False, False, True]
