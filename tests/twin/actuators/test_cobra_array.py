"""Cobras of the twin: ways in time, contacts against a dense search, dots, faults."""

import sys
from pathlib import Path

import numpy as np
import pytest

from fiberloom._core.geometry import segment_distance
from fiberloom.errors import InputError
from fiberloom.twin.actuators import PiezoErrors, drawn_maps
from fiberloom.twin.cobras.array import CobraArray, CobraMove
from fiberloom.twin.faults.faults import Fault

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from support.cobras import pfs_plane

N = 114
PERFECT = PiezoErrors(0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.9, 0.0, 0.0, 0.0, 0.0)
PULSE_US = np.tile([44.0, 22.0], (N, 1))
STEP_S = np.full(N, 2.5e-3)


def array_at(start_deg, errors=PERFECT):
    return CobraArray(pfs_plane(N), drawn_maps(N, 1), errors, seed=3, start_deg=start_deg)


def drawn(seed):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(10.0, 360.0, N), rng.uniform(20.0, 150.0, N)])


def moved(array, steps, sleeps=None):
    none = np.zeros((N, 2), dtype=np.int64)
    return array.start(CobraMove(steps, PULSE_US, none if sleeps is None else sleeps, STEP_S))


def segments(array, angle_deg):
    """(n, 4) by the focal plane's own kinematics, not by that of the contacts."""
    plane = array.plane
    alpha, beta = (angle_deg + plane.stops_of()[:, :, 0]).T
    return np.hstack([plane.elbows_mm(alpha), plane.forward(alpha, beta)])


@pytest.mark.parametrize("halted", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_contacts_are_those_of_a_dense_search(seed, halted):
    """Halted: the power of half of them goes on the way, and the others run into some of these."""
    array = array_at(drawn(seed))
    rng = np.random.default_rng(seed + 10)
    duration_s = moved(array, rng.integers(-800, 800, (N, 2)), rng.integers(0, 300, (N, 2)))
    planned = list(array.touched)
    if halted:
        array.clock = lambda: 0.15 * duration_s
        array.halt(np.arange(N) % 2 == 0)
        assert array.touched != planned
    told = {(c.positioner_id, c.other) for c in array.touched if c.other is not None}
    pairs = np.array([p for p in array._pairs.tolist() if p[1] < N])
    nearest = np.full(len(pairs), np.inf)
    for time_s in np.linspace(0.0, duration_s, 1500):
        now = segments(array, array.angle_at_deg(time_s))
        gap = segment_distance(np.ascontiguousarray(now[pairs[:, 0]]), np.ascontiguousarray(now[pairs[:, 1]]))
        nearest = np.minimum(nearest, gap)
    found = {(i + 1, j + 1) for (i, j), gap in zip(pairs.tolist(), nearest, strict=True) if gap < 2.0}
    assert len(found) > 3
    assert found <= told
    # between two moments of the search arms go 5 um
    near = {(i + 1, j + 1) for (i, j), gap in zip(pairs.tolist(), nearest, strict=True) if gap < 2.02}
    assert told <= near


def test_folded_arms_turn_without_contacts():
    start = drawn(1)
    start[:, 1] = 40.0
    array = array_at(start)
    rng = np.random.default_rng(0)
    steps = np.column_stack([rng.integers(-2000, 2000, N), np.zeros(N, dtype=int)])
    moved(array, steps)
    assert array.touched == []


def test_the_way_begins_and_ends_where_motors_are():
    array = array_at(drawn(2), PiezoErrors())
    before = array.angle_deg.copy()
    steps = np.random.default_rng(1).integers(-500, 500, (N, 2))
    duration_s = moved(array, steps)
    np.testing.assert_allclose(array.angle_at_deg(0.0), before, atol=1e-9)
    np.testing.assert_allclose(array.angle_at_deg(duration_s), array.motors.angle_deg.reshape(-1, 2))
    ways = np.array([array.angle_at_deg(t) for t in np.linspace(0.0, duration_s, 200)])
    went = np.diff(ways, axis=0)
    assert np.all((went >= -1e-12).all(axis=0) | (went <= 1e-12).all(axis=0))  # one way only


def test_homing_ends_at_the_stops():
    array = array_at(drawn(4), PiezoErrors(stuck_share=0.0))
    moved(array, np.tile([-10_000, -5_000], (N, 1)))
    assert np.mean(np.abs(array.motors.angle_deg) < 1e-9) > 0.97  # some steps are very short


def test_a_fibre_behind_its_dot_is_dark_and_not_dead():
    array = array_at(drawn(5))
    at = array.dots_mm[:, :2].copy()
    at[:57] += 3.0  # elsewhere
    from fiberloom.drive.piezo.cobras import CobraArms

    angle = CobraArms.of(array.plane).angles_deg(at, np.full((N, 2), 90.0))
    array = array_at(np.clip(angle, 0.0, [380.0, 186.0]))
    assert array.hidden[57:].all()
    assert not array.hidden[:57].any()
    assert array.dark[57:].all()
    before = array.angle_deg.copy()
    moved(array, np.full((N, 2), -100))
    assert np.all(array.motors.angle_deg.reshape(-1, 2)[57:, 1] < before[57:, 1])


def test_faults():
    array = array_at(drawn(6))
    array.inject(Fault("dark", 3))
    array.inject(Fault("dead", 5))
    assert array.dark[2]
    before = array.angle_deg.copy()
    moved(array, np.full((N, 2), 50))
    still = np.all(array.motors.angle_deg.reshape(-1, 2) == before, axis=1)
    np.testing.assert_array_equal(np.flatnonzero(still), [4])
    array.clear(Fault("dead", 5))
    assert not array.stuck[4]
    with pytest.raises(InputError, match="known are dark"):
        array.inject(Fault("stuck_hall", 5))


def test_maps_of_another_number_are_refused():
    with pytest.raises(InputError, match="motor maps of 20 motors for 114 cobras"):
        CobraArray(pfs_plane(N), drawn_maps(10, 0))
