"""Pairs of arms are left out until they could have met: how far an arm can come is bounded, and truly so."""

import itertools

import numpy as np
import pytest
from units_of import UNITS as AXES
from units_of import gear_of, nominal, plant
from wire import STOP, goto

from fiberloom._core import geometry
from fiberloom._core import twin as core
from fiberloom.bus.identifier import encode
from fiberloom.instruments import generate, load_instrument
from fiberloom.instruments.pointing import Pointing
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.errors.sizes import TwinErrors
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.faults.kinds import FaultKind
from fiberloom.twin.units import GEAR, ORDERS, plain
from fiberloom.units import TICK_S

PLANE = generate(load_instrument("sdssv"), seed=4, n_positioners=19)
UNITS = draw_units(PLANE, seed=6)
LOADED = draw_units(PLANE, seed=6, errors=TwinErrors.of(PLANE.instrument, "gravity,torque"))
IDS = [int(i) for i in PLANE.positioner_id]
OUT = (20.0, 110.0)
"""Where arms begin, deg: apart, but within each other's reach."""
SYNC = 4
"""Ticks."""


def lines_mm(twin):
    """Both ends of the centre lines of all beta arms, (N, 2, 2)."""
    angles = np.deg2rad(twin.truth())
    return geometry.beta_segment(twin.units.arms, *twin.plane.beta_segment_mm, angles).reshape(-1, 2, 2)


def share_of_bound(twin, ticks, meanwhile=lambda: None):
    """Of the way that each arm may have come after these ticks, at most: what it has."""
    assert twin._core.tick % SYNC == 0
    bound_mm, before = twin._core.bounds_mm(ticks), lines_mm(twin)
    for part in (ticks // 2 - 1, ticks - ticks // 2 + 1):
        twin.run(part * TICK_S)
        meanwhile()
    return np.linalg.norm(lines_mm(twin) - before, axis=-1).max(axis=1) / bound_mm


def tell(twin, rng):
    """Stops one of the arms, or sends it out to where they meet: refused by one that moves."""
    number = int(rng.choice(IDS))
    if rng.random() < 0.3:
        twin.send([(encode(number, STOP, 1), b"")])
    else:
        goto(twin, number, rng.uniform(0, 350), rng.uniform(0, 90))


def touched(twin):
    """Whether each arm has been touched since the last call."""
    found = {number for touch in twin.touches() for number in (touch.positioner_id, touch.other)}
    return np.isin(twin.plane.positioner_id, [number for number in found if number is not None])


@pytest.mark.parametrize("ticks", [4, 16, 32, 96])
def test_no_arm_comes_further_than_its_bound(ticks):
    """Moves that begin, turn back, end and are stopped, told within a slice; with arms that meet."""
    twin = Twin(PLANE, UNITS, seed=1, threads=1, start_deg=OUT)
    rng, most, left_out = np.random.default_rng(ticks), 0.0, np.zeros(len(IDS), dtype=bool)
    for _ in range(12000 // ticks):
        share = share_of_bound(twin, ticks, lambda: tell(twin, rng))
        left_out |= touched(twin)  # in touch from now on, or lately: bounded by what pushes it
        most = max(most, share[~left_out].max(initial=0.0))
    assert np.count_nonzero(~left_out) > 3
    assert 0.05 < most < 1.0


def test_a_pushed_arm_comes_no_further_from_look_to_look():
    """Those in touch at the beginning and at the end of 2 ms, in any way of touching."""
    twin = Twin(PLANE, UNITS, seed=1, threads=1, start_deg=OUT)
    rng, most, seen = np.random.default_rng(3), 0.0, 0
    bound_at_rest_mm = twin._core.bounds_mm(SYNC)
    for _ in range(5000):
        if rng.random() < 0.1:
            tell(twin, rng)
        pushed = twin._core.bounds_mm(SYNC) > 3.0 * bound_at_rest_mm
        share = share_of_bound(twin, SYNC)
        seen += np.count_nonzero(pushed)
        most = max(most, share[pushed].max(initial=0.0))
    assert seen > 1000
    assert most < 1.0


@pytest.mark.parametrize("kind", [FaultKind.BLOCKED, FaultKind.DEAD, FaultKind.LYING, FaultKind.STUCK_HALL])
def test_no_fault_takes_an_arm_beyond_its_bound(kind):
    twin = Twin(PLANE.select([0]), UNITS.select([0]), seed=1, threads=1)
    most = 0.0
    for k in range(200):
        if k in (20, 60, 100):
            twin.inject(Fault(kind, IDS[0]))
        if k in (50, 80, 130):
            twin.clear(Fault(kind, IDS[0]))
            twin.send([(encode(IDS[0], STOP, 1), b"")])
        if k in (10, 55, 85, 135):
            goto(twin, IDS[0], 200.0, 20.0)
        most = max(most, share_of_bound(twin, 16).max())
    assert 0.02 < most < 1.0


def corner_duty(theta_rad):
    """The duties, all of the supply or none, whose field turns the rotor hardest towards larger angles."""
    corners = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
    ab, bc, ca = (np.roll(corners, -1, axis=1) - corners).T
    turn = np.deg2rad(120.0)
    torque = ab * np.cos(theta_rad) + bc * np.cos(theta_rad + turn) + ca * np.cos(theta_rad - turn)
    return corners[np.argmax(torque)]


@pytest.mark.parametrize("w0_rad_s", [0.0, 209.0, 700.0, -300.0])
@pytest.mark.parametrize("params", [nominal(), *AXES.plant[0]], ids=["nominal", "alpha", "beta"])
def test_a_rotor_driven_as_hard_as_can_be_stays_below_its_bound(params, w0_rad_s):
    p = plant(params, gear_of(3e4), 1.0)  # a gap that it does not cross: nothing but the rotor turns
    theta, _, gear, _ = p.state(0)
    p.set_state(0, theta + 10.0, w0_rad_s * float(params["inertia_motor"]), gear)
    limit, tau = p.speed_bound(0)
    most, nearest = 0.0, np.inf
    for k in range(1, 81):
        p.run(corner_duty(p.state(0)[0])[None, None])
        t = k * TICK_S
        coasting = -tau * np.expm1(-t / tau)
        bound = limit * (t - coasting) + abs(w0_rad_s) * coasting
        way = abs(p.state(0)[0] - theta - 10.0)
        most, nearest = max(most, way / bound), min(nearest, way / bound)
    assert most < 1.01  # what Neighbours adds for the plant's steps
    if w0_rad_s >= 0.0:
        assert nearest > 0.75  # the bound is not a wide one


def test_the_steepest_cell_of_a_gear_is_found():
    nodes = np.arange(core.NODES_PER_TURN + 1) * 2 * np.pi / core.NODES_PER_TURN
    for gears in ("stages", "family"):
        units = draw_units(PLANE, seed=6, gears=gears)
        for row in plain(units.gear.ravel())[:20]:
            gear, backlash = core.transmission(row, GEAR, nodes)
            narrowest = min(np.diff(gear).min(), np.diff(gear + backlash).min())
            steepest = core.output_per_motor(row, GEAR) * narrowest / nodes[1]
            assert 1.0 - 1e-9 < steepest < 1.25


def test_a_worn_gear_is_as_steep_as_its_mark():
    gear = gear_of()
    gear["wear"][0] = 1.5, 0.02, 5e-3  # falls by 5 mrad within 10: half as wide a cell, and less
    gear["delta_rad"][list(ORDERS).index(1)] = 1e-3, 0.0
    assert core.output_per_motor(plain(gear).ravel(), GEAR) * GEAR > 2.0


def meeting(**options):
    """All that a twin of arms that meet again and again tells, and what it takes."""
    twin = Twin(PLANE, LOADED, seed=1, start_deg=OUT, **options)
    rng, told = np.random.default_rng(5), []
    for k in range(400):
        tell(twin, rng)
        if k == 30:
            twin.set_external_torque(3, 1, 0.02)
        if k == 40:
            twin.point(Pointing(40.0, 70.0))
        if k == 50:
            twin.inject(Fault(FaultKind.BLOCKED, IDS[5]))
        told += twin.run(TICK_S * rng.integers(1, 200))
        told.append(twin.truth().tobytes())
    return told, twin.touches(), twin._core.slices


def test_shorter_slices_give_the_same_bytes():
    told, touches, slices = meeting(threads=1)
    again, touches_again, shorter = meeting(threads=2, bound_scale=10.0)
    assert len(touches) > 5
    assert shorter > 1.05 * slices
    assert touches_again == touches
    assert again == told


@pytest.mark.parametrize("late_ticks", [1, 3])
def test_calls_of_a_bus_that_begin_between_looks_are_seldom_cut(late_ticks):
    """One in four: a look serves the longest slice. One that serves two calls cuts every third."""
    twin = Twin(PLANE, LOADED, seed=1, threads=1)
    tell(twin, np.random.default_rng(5))
    twin.run(0.1 + late_ticks * TICK_S)
    before, calls = twin._core.slices, 40
    for _ in range(calls):
        twin.run(10 * TICK_S)
    assert twin._core.slices - before < 1.25 * calls


def test_a_bound_that_is_none_finds_touches_late():
    """What the test above would see."""
    _, touches, _ = meeting(threads=1)
    _, late, _ = meeting(threads=1, bound_scale=0.02)
    assert late != touches


def test_an_arm_that_is_bent_into_its_neighbour_touches_it_at_once():
    """Two that had not to be looked at for long: less far apart than one of them is bent by a torque."""
    plane = generate(load_instrument("sdssv"), seed=4, n_positioners=2)
    units = draw_units(plane, seed=6)
    way = units.arms[::-1, :2] - units.arms[:, :2]
    facing_deg = np.rad2deg(np.arctan2(way[:, 1], way[:, 0]) - units.arms[:, 3]) % 360.0
    for waited in range(1, 16):
        start_deg = np.stack([facing_deg + 15.0, [0.5, 0.5]], 1)
        twin = Twin(plane, units, seed=1, threads=1, skip_resting=False, start_deg=start_deg)
        lines = lines_mm(twin).reshape(2, 4)
        assert twin._core.bounds_mm(32).sum() < geometry.segment_distance(lines[:1], lines[1:])[0] - 3.0
        twin.run(0.1 + waited * TICK_S)
        told_s = twin.time_s
        twin.set_external_torque(0, 0, -4.0)  # more than any arm bears: 0.2 rad
        twin.run(0.05)
        assert 0.0 <= twin.touches()[0].time_s - told_s < SYNC * TICK_S - 1e-9
