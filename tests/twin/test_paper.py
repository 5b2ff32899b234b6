"""Figures 16 and 17 and Eq. 22 of Kronig 2020: the real firmware on the twin's motors."""

import numpy as np
import pytest
from wire import COLLISION, commands, goto, ramp_path, start, upload

from fiberloom.bus.identifier import encode
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Fault, Twin, draw_units

PLANE = generate(load_instrument("sdssv"), seed=2, n_positioners=7)
IDS = [int(i) for i in PLANE.positioner_id]
UP_AND_DOWN = [200, 0, 1800, 0, 2000, 0, -200, 0, -1800, 0, -2000]  # rpm
OPEN_LOOP_BETA = 125


def tracking_deg(units, *, axis=1, open_loop=False, rows=range(7)):
    """Tracking error along the ramps of Fig. 16, motor deg, (units, ticks); and collisions."""
    twin = Twin(PLANE, units, seed=1, threads=1, neighbours=False, start_deg=(60.0, 60.0))
    time, path = ramp_path(UP_AND_DOWN, 0.25, 0.0, acceleration_rad_s2=4000.0)
    for row in rows:
        if open_loop:
            twin.send([(encode(IDS[row], OPEN_LOOP_BETA, 1), b"")])
            twin.run(0.001)
        wire = [units.transmission(row, k, 60.0)[0][0] + np.zeros_like(path) for k in (0, 1)]
        wire[axis] += path
        upload(twin, IDS[row], time, *wire)
    scopes = [twin.scope(row, axis) for row in rows]
    start(twin)
    replies = twin.run(time[-1] + 0.3)
    collisions = [c for c in commands(replies) if c[1] == COLLISION]
    return np.array([s.take()["tracking_deg"] for s in scopes]), collisions


def rms(errors):
    return float(np.sqrt(np.mean(errors**2)))


@pytest.fixture(scope="module")
def full():
    return tracking_deg(draw_units(PLANE, 3))


def test_figure_16_feedforward_and_pi(full):
    """The paper: up to 15 degrees, and within 20 in Section 3.2; the gap is where it is lost."""
    errors, collisions = full
    worst = np.abs(errors).max(axis=1)
    assert np.median(worst) < 17.0
    assert worst.max() < 22.0
    assert worst.min() > 5.0
    assert collisions == []


@pytest.mark.parametrize(
    ("term", "worse"), [("use_speed", 10.0), ("use_break_away", 1.4), ("use_inertia", 1.2)]
)
def test_figure_16_any_term_left_out_is_worse(full, term, worse):
    units = draw_units(PLANE, 3)
    units.firmware[term] = 0.0
    for alarm in ("collision_torque", "contact_torque"):  # the figure's tracking, not the alarm
        units.firmware[alarm] *= 100.0
    errors, _ = tracking_deg(units)
    assert rms(errors) > worse * rms(full[0])


def test_figure_16_open_loop_lags_by_tens_of_degrees(full):
    """The paper: up to 55 degrees; the lag is asin(torque / torque at full voltage)."""
    errors, collisions = tracking_deg(draw_units(PLANE, 3), open_loop=True)
    assert 20.0 < np.abs(errors).max() < 60.0
    assert rms(errors) > 5 * rms(full[0])
    assert collisions == []


def test_equation_22_blocked_axis_is_found_within_16_ms():
    """At 2000 rpm with 120 degrees: 12 degrees a millisecond, so 10 ms after the command left."""
    found = blocked_found_s(contact=False)
    assert set(found) == set(IDS)
    assert min(found.values()) > 0.006
    assert max(found.values()) < 0.016


def test_the_contact_rules_find_a_blocked_axis_sooner():
    assert max(blocked_found_s(contact=True).values()) < 0.006


def blocked_found_s(contact):
    """When each positioner says that it is blocked, after it was, s; with or without our own rule."""
    units = draw_units(PLANE, 3)
    for own in ("contact_torque", "touch_torque"):
        units.firmware[own] *= contact
    twin = Twin(PLANE, units, seed=1, threads=1, neighbours=False, start_deg=(60.0, 60.0))
    for number in IDS:
        goto(twin, number, 90.0, 90.0)
    twin.run(1.0)
    blocked_s = twin.time_s
    for number in IDS:
        twin.inject(Fault("blocked", number, "beta"))
    replies = twin.run(0.1)
    return {c[0]: r.time_s - blocked_s for r, c in zip(replies, commands(replies), strict=True)}


@pytest.mark.parametrize(("axis", "lever_mm", "paper_nm"), [(0, 7.6, 160.0), (1, 15.0, 130.0)])
def test_figure_17_repeatability(axis, lever_mm, paper_nm):
    """Three targets 1 um apart, each from above by 840 motor degrees, with a camera of 101 nm."""
    units = draw_units(PLANE, 3)
    twin = Twin(PLANE, units, seed=1, threads=1, neighbours=False, start_deg=(100.0, 170.0))
    home = np.array([[units.transmission(r, k, x)[0][0] for k, x in enumerate((100, 170))] for r in range(7)])
    step_deg = np.rad2deg(1e-3 / lever_mm)
    seen_nm = np.array([[visit(twin, home, axis, k * step_deg) for k in range(3)] for _ in range(12)])
    seen_nm *= np.deg2rad(1.0) * lever_mm * 1e6
    gear_nm = np.sqrt(((seen_nm - seen_nm.mean(axis=0)) ** 2).mean() * 12 / 11)
    # 12 visits to 3 targets of 7 units: 5 percent of rms, units scatter by 15 percent
    assert np.hypot(gear_nm, 101.0) == pytest.approx(paper_nm, rel=0.12)
    assert np.hypot(gear_nm, 101.0) < 170.0
    apart_nm = np.diff(seen_nm.mean(axis=0), axis=0)
    # the slope of delta, 0.15 at most, and what is left of the noise
    np.testing.assert_allclose(apart_nm, 1000.0, atol=330.0)


def visit(twin, home, axis, offset_deg):
    for leg_deg in (840.0 / 1024.0, 0.0):
        wire = home.copy()
        wire[:, axis] += offset_deg + leg_deg
        for number, angles in zip(IDS, wire, strict=True):
            goto(twin, number, *angles)
        twin.run(0.8)
    return twin.truth()[:, axis]
