"""Positioners of several parts on layers, and keep-outs: planned, proven, and looked at by brute force."""

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from dense import distances, pair_gaps, smallest_gap, times
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom._core import planning as core
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane, generate, load_instrument, parse_instrument, presets
from fiberloom.instruments.single_units import handicapped
from fiberloom.planning import MotionLimits, PlanSettings, Trajectory, plan, random_pair, verify
from fiberloom.planning.bodies import CollisionBodies
from fiberloom.planning.overlaps import Surroundings
from fiberloom.planning.untangling import untangle

DESI = load_instrument("desi")
LEAST_MM = 0.0009
BAR = {"arm": "beta", "capsule_mm": [0.0, 0.0, 14.7276, 0.0], "radius_mm": 1.6, "layers": [2]}
ELBOW = {"arm": "alpha", "capsule_mm": [-2.0, 1.0, 7.4, -0.5], "radius_mm": 2.2, "layers": [1, 3]}
TIP = {"arm": "beta", "polygon_mm": [[11.0, 2.0], [16.0, 1.0], [16.0, -1.5], [12.0, -2.5]], "layers": [1]}


@cache
def with_parts(n: int, seed: int, *numbers: int) -> FocalPlane:
    """A field of SDSS-V whose positioners have other parts: some of the three."""
    data = load_instrument("sdssv").model_dump(mode="json")
    data["bodies"]["parts"] = [(BAR, ELBOW, TIP)[k] for k in numbers]
    data["bodies"]["keep_outs"] = [{"line_mm": [[30.0, -60.0], [30.0, -20.0]], "radius_mm": 1.0, "copies": 3}]
    return generate(parse_instrument(data, "test"), seed, n_positioners=n)


@cache
def desi(n: int, seed: int = 0) -> FocalPlane:
    return generate(DESI, seed, n_positioners=n)


def tables(plane: FocalPlane) -> tuple[np.ndarray, np.ndarray]:
    bodies = CollisionBodies.of(plane)
    return bodies.parts, bodies.obstacles


def checked(plane, made, start_deg, goal_deg):
    found = verify(plane, made, start_deg=start_deg, goal_deg=goal_deg)
    assert found.ok, str(found)
    gap_mm = smallest_gap(plane, made, *tables(plane))
    assert gap_mm >= LEAST_MM
    assert found.min_clearance_mm <= gap_mm + 1e-4
    return made


@pytest.mark.parametrize("seed", range(3))
def test_plans_of_desi_keep_phi_clear_of_phi_and_theta(seed):
    plane = desi(37, seed)
    ends = random_pair(plane, seed)
    assert not checked(plane, plan(plane, *ends, seed=seed), *ends).refused


def toml_outlines(plane, row, angles_deg):
    """Corners (T, n) of phi and of theta as the preset's file tells them, complex, mm."""
    told = tomllib.loads((Path(presets.__file__).parent / "desi.toml").read_text())["bodies"]["parts"]
    x, y, l_alpha, alpha_off, beta_off = plane.arms[row]
    alpha = np.exp(1j * (np.radians(angles_deg[:, :1]) + alpha_off))
    beta = alpha * np.exp(1j * (np.radians(angles_deg[:, 1:]) + beta_off))
    phi, theta = (np.array(part["polygon_mm"]) @ [1.0, 1j] for part in told)
    return x + 1j * y + l_alpha * alpha + beta * phi, x + 1j * y + alpha * theta


def polygons_apart(p, q):
    """Of two sequences of polygons: least distance of their edges; 0 where one has a corner of the other."""
    if min(contains(p, q[:, 0]).max(), contains(q, p[:, 0]).max()):
        return 0.0
    edges = [np.stack([k, np.roll(k, -1, axis=1)], axis=-1) for k in (p, q)]
    one, other = (np.stack([e.real, e.imag], axis=-1).reshape(*e.shape[:2], 4) for e in edges)
    pairs = [(one[:, a], other[:, b]) for a in range(one.shape[1]) for b in range(other.shape[1])]
    return min(float(distances(a, b).min()) for a, b in pairs)


def contains(polygon, point):
    """By crossings of a ray."""
    a, b = polygon, np.roll(polygon, -1, axis=1)
    at = point[:, None]
    over = (a.imag > at.imag) != (b.imag > at.imag)
    rise = np.where(over, b.imag - a.imag, 1.0)
    return (over & (at.real < a.real + (b.real - a.real) * (at.imag - a.imag) / rise)).sum(axis=1) % 2


@pytest.mark.parametrize("seed", range(2))
def test_the_published_polygons_of_desi_stay_apart_by_what_covers_them(seed):
    plane = desi(37, seed)
    ends = random_pair(plane, seed)
    made = plan(plane, *ends, seed=seed)
    when_s = times(made)
    drawn = [toml_outlines(plane, k, robot.at(when_s)) for k, robot in enumerate(made.robots)]
    gaps_mm = []
    for i, j in plane.neighbour_pairs():
        (phi, theta), (other_phi, other_theta) = drawn[i], drawn[j]
        for p, q in ((phi, other_phi), (phi, other_theta), (theta, other_phi)):
            if np.abs(p.mean(axis=1) - q.mean(axis=1)).min() < 11.0:
                gaps_mm.append(polygons_apart(p, q))
    clear_mm = verify(plane, made).min_robot_clearance_mm
    assert clear_mm <= min(gaps_mm) + 1e-4
    assert min(gaps_mm) <= clear_mm + 2 * 0.25 + 0.02


@pytest.mark.parametrize("numbers", [(0, 1), (2, 1), (0, 1, 2), (2,)])
def test_plans_with_parts_on_layers_are_free(numbers):
    plane = with_parts(19, 3, *numbers)
    ends = random_pair(plane, 5)
    assert not checked(plane, plan(plane, *ends, seed=1), *ends).refused


@given(st.integers(3, 12), st.integers(0, 10_000), st.sampled_from([(0, 1), (0, 1, 2), (2, 1)]))
@settings(max_examples=5, deadline=None)
def test_any_small_field_with_parts(n, seed, numbers):
    plane = with_parts(n, seed % 20, *numbers)
    rng = np.random.default_rng(seed)
    some = plane.positioner_id[rng.random(n) < 0.3]
    plane = handicapped(plane, some, wider_mm=0.2, speed_share=0.6)
    try:
        ends = random_pair(plane, seed)
    except InputError:
        return
    checked(plane, plan(plane, *ends, seed=seed), *ends)


def test_one_part_told_is_the_plain_capsule():
    plain = generate(load_instrument("sdssv"), 1, n_positioners=37)
    data = plain.instrument.model_dump(mode="json")
    data["bodies"]["parts"] = [BAR | {"radius_mm": 2.0, "layers": [1]}]
    told = replace(plain, instrument=parse_instrument(data, "test"))
    ends = random_pair(plain, 2)
    assert plan(told, *ends, seed=2).to_dict() == plan(plain, *ends, seed=2).to_dict()


def test_two_parts_that_are_the_plain_capsule_move_as_safely():
    """Cut in two, it is searched as a shape; the verifier with one part finds nothing wrong."""
    plain = generate(load_instrument("sdssv"), 1, n_positioners=37)
    data = plain.instrument.model_dump(mode="json")
    halves = [[0.0, 0.0, 8.0, 0.0], [8.0, 0.0, 14.7276, 0.0]]
    data["bodies"]["parts"] = [BAR | {"capsule_mm": half, "radius_mm": 2.0, "layers": [1]} for half in halves]
    cut = replace(plain, instrument=parse_instrument(data, "test"))
    ends = random_pair(plain, 2)
    made = plan(cut, *ends, seed=2)
    both = [verify(plane, made, start_deg=ends[0], goal_deg=ends[1]) for plane in (plain, cut)]
    assert both[0].ok
    assert both[0].min_clearance_mm == pytest.approx(both[1].min_clearance_mm, abs=2e-4)


@pytest.mark.parametrize(("layers", "free"), [([1], False), ([2], True), ([1, 2], False)])
def test_parts_touch_only_on_a_common_layer(layers, free):
    """Two arms across each other: all of the first are on layer 1."""
    arms = np.array([[0.0, 0.0, 7.4, 0.0, 0.0], [22.4, 0.0, 7.4, np.pi, 0.0]])
    bits = float(sum(1 << (k - 1) for k in layers))
    parts = np.array([[0, 1, 0, 0, 14.7, 0, 2.0, 1], [1, 1, 0, 0, 14.7, 0, 2.0, bits]])
    bodies = core.Bodies(arms, parts, np.zeros((0, 7)))
    stretched = np.zeros((2, 2))
    assert (len(core.conflicts(bodies, stretched, 0.0)) == 0) is free
    wide = np.array([[-10.0, 10.0]] * 2)
    rules = core.Rules(speed=1e9, acceleration=1e12, rounding=1e-8, travel=wide)
    found = core.verify(bodies, [np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.01]]), np.zeros((1, 3))], rules)
    assert (len(found["violations"]) == 0) is free


def swapped(made, plane, i):
    """A mutant: one arm makes the motion of its neighbour."""
    near = plane.neighbour_pairs()
    j = int(near[(near == i).any(axis=1)][0].sum() - i)
    other = made.robots[j]
    own = Trajectory(made.robots[i].positioner_id, other.time_s, other.alpha_deg, other.beta_deg, None)
    return replace(made, robots=(*made.robots[:i], own, *made.robots[i + 1 :]))


@pytest.mark.parametrize("plane", [desi(19), with_parts(12, 3, 0, 1)], ids=["desi", "parts"])
def test_mutants_that_touch_are_caught_and_others_are_not(plane):
    ends = random_pair(plane, 1)
    made = plan(plane, *ends, seed=1)
    seen = {True: 0, False: 0}
    for i in range(plane.n):
        mutant = swapped(made, plane, i)
        gap_mm = smallest_gap(plane, mutant, *tables(plane), of=i)
        found = verify(plane, mutant, limits=MotionLimits(1e9, 1e12))
        if gap_mm < -0.02:
            assert found.collisions
        if found.collisions:
            assert gap_mm < 0.02
        else:
            assert found.min_clearance_mm <= gap_mm + 1e-4
        seen[bool(found.collisions)] += 1
    assert min(seen.values()) > 0


def test_gaps_of_a_field_are_those_of_the_brute_force():
    plane = with_parts(7, 1, 0, 1, 2)
    here_deg, _ = random_pair(plane, 0)
    around = Surroundings(plane, CollisionBodies.of(plane))
    found = {(i, j): gap for i, j, gap in zip(*around.gaps_of_pairs_mm(np.radians(here_deg)), strict=True)}
    still = plan(plane, here_deg, here_deg)
    checked_pairs = 0
    for i, j, gap in pair_gaps(plane, still, *tables(plane)):
        body = j if j >= 0 else plane.n - 1 - j
        if (i, body) in found and np.isfinite(gap):
            assert found[i, body] == pytest.approx(gap, abs=1e-9)
            checked_pairs += 1
        elif np.isfinite(gap):
            assert gap > 0.0
    assert checked_pairs > 5
    one = around.gaps_mm(0, np.radians(here_deg[[0]]), np.radians(here_deg), around.near[0])[0]
    later = [k for k in around.near[0] if k > 0]
    assert one[-len(later) :] == pytest.approx([found[0, int(k)] for k in later], abs=1e-9)


def test_arms_of_several_parts_are_untangled():
    plane = with_parts(7, 1, 0, 1, 2)
    start_deg, _ = random_pair(plane, 0)
    wide = handicapped(plane, plane.positioner_id, wider_mm=0.8)
    found = untangle(wide, start_deg)
    for stage in found.stages:
        assert verify(wide, stage.plan, limits=MotionLimits(separating=stage.separates)).ok


def test_a_keep_out_is_kept_free_and_named():
    plane = with_parts(19, 3, 0)
    _, obstacles = tables(plane)
    first = len(plane.fiducials) + len(plane.guide_cameras)
    assert len(obstacles) == first + 3
    for end in range(0, 4, 2):
        radius = np.hypot(*obstacles[first:, end : end + 2].T)
        np.testing.assert_allclose(radius, radius[0])
    x, y = obstacles[first, :2] * 0.5 + obstacles[first, 2:4] * 0.5
    row = int(np.hypot(*(plane.centres_mm - (x, y)).T).argmin())
    cx, cy, l_alpha, off, beta_off = plane.arms[row]
    alpha = np.degrees(np.arctan2(y - cy, x - cx) - off) % 360.0
    goal_deg = plane.park_deg.copy()
    goal_deg[row] = [alpha, np.clip(-np.degrees(beta_off), 0.0, 180.0)]
    assert np.hypot(x - cx, y - cy) < l_alpha + 14.0
    made = plan(plane, plane.park_deg, goal_deg)
    assert "touches keep-out 0" in made.refused[int(plane.positioner_id[row])]


def test_another_buffer_makes_all_parts_wider():
    plane = with_parts(7, 1, 0, 1, 2)
    usual, wide = CollisionBodies.of(plane), CollisionBodies.of(plane, plane.collision_buffer_mm + 0.25)
    np.testing.assert_allclose(wide.parts[:, 6] - usual.parts[:, 6], 0.25)
    with pytest.raises(InputError, match="collision_buffer_mm: parts of sdssv need more than"):
        CollisionBodies.of(plane, 0.1)
    ends = random_pair(plane, 0, collision_buffer_mm=2.2)
    made = plan(plane, *ends, settings=PlanSettings(collision_buffer_mm=2.2))
    assert smallest_gap(plane, made, CollisionBodies.of(plane, 2.2).parts, usual.obstacles) >= LEAST_MM


def test_no_arm_can_touch_a_fiducial_without_a_body():
    """An arm over a fiducial of DESI: refused where the fiducial has a radius, free without."""
    plane = desi(37)
    row = int(np.hypot(*(plane.centres_mm - plane.fiducials[0, :2]).T).argmin())
    aim = plane.fiducials[0, :2] - plane.centres_mm[row]
    beside = replace(
        plane, fiducials=np.array([[*(plane.centres_mm[row] + aim * 3.0 / np.hypot(*aim)), 0.0]])
    )
    alone = beside.select([row])
    goal_deg = np.array([[*alone.inverse(alone.fiducials[:, :2]).alpha_deg, 90.0]])
    assert CollisionBodies.of(alone).obstacles[0, 5] == 2.0**32 - 4.0  # parts are on layers 1 and 2
    made = plan(alone, alone.park_deg, goal_deg)
    assert made.refused == {}
    solid = replace(alone, fiducials=alone.fiducials + np.array([0.0, 0.0, 0.5]))
    assert not verify(solid, made).ok
    assert "fiducial 0" in next(iter(plan(solid, solid.park_deg, goal_deg).refused.values()))
