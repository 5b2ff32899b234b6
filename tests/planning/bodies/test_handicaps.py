"""Single positioners that are wider, slower or not where they are said to be."""

from dataclasses import replace

import numpy as np
import pytest
from dense import field, fixed_table, plain_table, smallest_gap, top_accelerations, top_speeds
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane, read_layout, write_layout
from fiberloom.instruments.single_units import handicapped, handicaps_of
from fiberloom.operation.past import parts as past
from fiberloom.planning import (
    MotionLimits,
    bound_s,
    plan,
    plan_corrections,
    random_configuration,
    random_pair,
    verify,
)
from fiberloom.planning.untangling import untangle
from fiberloom.store.parts import unpack

SPEED_DEG_S, ACCELERATION_DEG_S2 = 11.7, 47.0
LEAST_MM = 0.0009
"""Plans keep 0.001 mm; rounding of angles to 1e-9 deg takes less than 1e-6 mm."""


def mixed(n: int, seed: int, wider_mm: float = 0.5) -> FocalPlane:
    """A field in which half are wider and a third slower, each by its own amount."""
    plane, rng = field(n, seed), np.random.default_rng(seed)
    wide = plane.positioner_id[rng.random(n) < 0.5]
    plane = handicapped(plane, wide, wider_mm=rng.uniform(0.05, wider_mm, len(wide)))
    slow = plane.positioner_id[rng.random(n) < 0.34]
    shares = rng.uniform(0.3, 0.95, (2, len(slow)))
    return handicapped(plane, slow, speed_share=shares[0], acceleration_share=shares[1])


def checked(plane: FocalPlane, made, start_deg, goal_deg):
    """A plan by the verifier and by dense samples with numbers of our own."""
    found = verify(plane, made, start_deg=start_deg, goal_deg=goal_deg, approach_deg=0.82)
    assert found.ok, str(found)
    radii_mm = made.collision_buffer_mm + plane.handicaps.wider_mm
    gap_mm = smallest_gap(plane, made, plain_table(plane, radii_mm), fixed_table(plane))
    assert gap_mm >= LEAST_MM
    assert found.min_clearance_mm <= gap_mm + 1e-4
    share = plane.handicaps.speed_share[:, None]
    assert (top_speeds(made) <= SPEED_DEG_S * share * (1 + 1e-6)).all()
    limits = ACCELERATION_DEG_S2 * plane.handicaps.acceleration_share
    assert (top_accelerations(made) <= limits * (1 + 1e-6)).all()
    return made


@pytest.mark.parametrize("seed", range(6))
def test_plans_with_mixed_buffers_and_speeds_are_free_and_within_each_ones_limits(seed):
    plane = mixed(37, seed)
    ends = random_pair(plane, seed)
    made = checked(plane, plan(plane, *ends, seed=seed), *ends)
    assert not made.refused
    assert made.duration_s >= bound_s(plane, *ends)


@given(st.integers(7, 19), st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_any_small_field(n, seed):
    plane = mixed(n, seed % 50, wider_mm=1.0)
    rng = np.random.default_rng(seed)
    try:
        ends = [random_configuration(plane, seed + k) for k in range(2)]
    except InputError:  # no room for arms so wide
        return
    some = rng.random(n) < 0.2
    ends[1][some] = ends[0][some]
    checked(plane, plan(plane, *ends, seed=seed), *ends)


def test_no_handicap_is_the_same_as_none():
    plane = field(37, 1)
    ends = random_pair(plane, 1)
    same = handicapped(plane, plane.positioner_id, wider_mm=0.0, speed_share=1.0, acceleration_share=1.0)
    assert plan(same, *ends, seed=1).to_dict() == plan(plane, *ends, seed=1).to_dict()


def test_one_that_is_slow_takes_longer_and_the_others_do_not():
    plane = field(19)
    start_deg = np.tile([10.0, 170.0], (19, 1))
    goal_deg = start_deg - [0.0, 60.0]
    slow = handicapped(plane, plane.positioner_id[[0]], speed_share=0.5)
    usual, made = plan(plane, start_deg, goal_deg), plan(slow, start_deg, goal_deg)
    speeds = top_speeds(made).max(axis=1)
    assert speeds[0] == pytest.approx(0.5 * SPEED_DEG_S, rel=0.1)
    assert np.median(speeds[1:]) == pytest.approx(SPEED_DEG_S, rel=0.1)
    assert made.duration_s > 1.5 * usual.duration_s
    assert bound_s(slow, start_deg, goal_deg) == pytest.approx(2.0 * bound_s(plane, start_deg, goal_deg))


def test_one_that_is_very_slow_slows_the_clock_and_keeps_its_limits():
    plane = field(7)
    start_deg = np.tile([10.0, 170.0], (7, 1))
    slow = handicapped(plane, plane.positioner_id[[3]], speed_share=0.02, acceleration_share=0.1)
    made = checked(slow, plan(slow, start_deg, start_deg - [0.0, 12.0]), start_deg, start_deg - [0.0, 12.0])
    assert not made.refused


def test_corrections_of_slow_ones_keep_their_limits():
    plane = handicapped(field(7), field(7).positioner_id[[2]], speed_share=0.4, acceleration_share=0.5)
    start_deg = np.tile([10.0, 170.0], (7, 1))
    goal_deg = start_deg - [0.3, 0.2]
    made = checked(plane, plan_corrections(plane, start_deg, goal_deg), start_deg, goal_deg)
    assert made.robots[2].moves
    assert not made.refused


def test_the_verifier_sees_a_slow_one_that_goes_as_fast_as_the_others():
    plane = field(7)
    start_deg = np.tile([10.0, 170.0], (7, 1))
    made = plan(plane, start_deg, start_deg - [0.0, 60.0])
    slow = handicapped(plane, plane.positioner_id[[4]], speed_share=0.8)
    assert {(v.kind, v.positioner_id) for v in verify(slow, made).violations} == {
        ("speed", int(plane.positioner_id[4]))
    }
    weak = handicapped(plane, plane.positioner_id[[5]], acceleration_share=0.3)
    assert ("acceleration", int(plane.positioner_id[5])) in {
        (v.kind, v.positioner_id) for v in verify(weak, made).violations
    }
    assert verify(slow, made, limits=MotionLimits(speed_deg_s=20.0)).ok


@pytest.mark.parametrize("seed", range(3))
def test_the_verifier_sees_one_that_is_wider_than_it_was_planned(seed):
    plane = field(37, seed)
    ends = random_pair(plane, seed)
    made = plan(plane, *ends, seed=seed)
    wide = handicapped(plane, plane.positioner_id, wider_mm=0.3)
    found = verify(wide, made)
    radii_mm = made.collision_buffer_mm + wide.handicaps.wider_mm
    gap_mm = smallest_gap(wide, made, plain_table(wide, radii_mm), fixed_table(wide))
    assert gap_mm < 0.0
    assert not found.ok
    assert found.min_clearance_mm == pytest.approx(gap_mm, abs=0.02)


def test_all_places_where_one_that_is_offline_may_be_are_kept_free():
    plane, rng = field(19), np.random.default_rng(0)
    dead = int(plane.positioner_id[5])
    said, doubt = np.array([120.0, 100.0]), np.array([25.0, 15.0])
    plane = plane.with_offline([dead], [said])
    unsure = handicapped(plane, [dead], doubt_deg=doubt)
    ends = random_pair(unsure, 4)
    made = plan(unsure, *ends, seed=4)
    assert verify(unsure, made, start_deg=ends[0], goal_deg=ends[1]).ok
    table = plain_table(plane, np.full(19, made.collision_buffer_mm))
    corners = said + doubt * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    for place in [said, *corners, *(said + doubt * rng.uniform(-1, 1, (20, 2)))]:
        there = plane.with_offline([dead], [place])
        robots = tuple(
            replace(r, alpha_deg=place[:1], beta_deg=place[1:]) if r.positioner_id == dead else r
            for r in made.robots
        )
        moved = replace(made, robots=robots)
        assert smallest_gap(there, moved, table, fixed_table(there)) >= LEAST_MM
    # and it matters: a plan without the doubt touches it somewhere there
    blind = plan(plane, *ends, seed=4)
    assert not verify(unsure, blind).ok


def test_one_that_begins_where_an_uncertain_one_may_be_is_told_of_it():
    plane = field(7)
    dead, other = map(int, plane.positioner_id[:2])
    unsure = handicapped(plane.with_offline([dead], [[0.0, 170.0]]), [dead], doubt_deg=[180.0, 180.0])
    start_deg = np.tile([10.0, 170.0], (7, 1))
    towards = plane.centres_mm[0] - plane.centres_mm[1]
    start_deg[1] = [(np.degrees(np.arctan2(*towards[::-1])) + 90.0) % 360.0, 0.0]
    made = plan(unsure, start_deg, np.tile([10.0, 160.0], (7, 1)))
    assert f"positioner {dead}, where it may be" in made.refused[other]
    told = verify(unsure, made).contacts
    assert f"positioner {dead}, where it may be" in {contact.other for contact in told}


def test_an_overlap_of_wide_ones_is_undone():
    plane = field(7)
    start_deg = random_configuration(plane, 4)
    lines = plane.beta_segments(*start_deg.T)
    assert len(lines) == 7
    wide = handicapped(plane, plane.positioner_id, wider_mm=1.0)
    found = untangle(wide, start_deg)
    assert found.free
    for stage in found.stages:
        assert verify(wide, stage.plan, limits=MotionLimits(separating=stage.separates)).ok


def test_handicaps_are_kept_by_files_archives_and_selections(tmp_path):
    plane = mixed(7, 2)
    plane = handicapped(plane, plane.positioner_id[[6]], doubt_deg=[1.0, 2.0])
    write_layout(plane, tmp_path)
    read = read_layout(tmp_path, plane.instrument)
    kept = past.plane_of(unpack(past.packed_layout(plane)))
    for other in (read, kept):
        for name, values in plane.handicaps.arrays.items():
            np.testing.assert_allclose(getattr(other.handicaps, name), values, atol=1e-9)
    assert read.config_hash() == kept.config_hash() == plane.config_hash()
    assert plane.config_hash() != field(7, 2).config_hash()
    picked = plane.select([6, 1]).handicaps
    assert picked.doubt_deg.tolist() == [[1.0, 2.0], [0.0, 0.0]]
    assert picked.wider_mm.tolist() == plane.handicaps.wider_mm[[6, 1]].tolist()


def test_a_table_with_some_of_the_columns_is_refused(tmp_path):
    write_layout(mixed(7, 2), tmp_path)
    path = tmp_path / "positioners.ecsv"
    path.write_text(path.read_text().replace("speed_share", "speed"))
    with pytest.raises(InputError, match="speed_share"):
        read_layout(tmp_path, field(7, 2).instrument)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"wider_mm": -0.1}, "wider_mm must be finite and not below 0"),
        ({"doubt_deg": [np.nan, 0.0]}, "doubt_deg must be finite"),
        ({"speed_share": 0.0}, "speed_share must be above 0 and at most 1"),
        ({"acceleration_share": 1.5}, "acceleration_share must be above 0"),
    ],
)
def test_values_out_of_range_are_refused(wrong, words):
    with pytest.raises(InputError, match=words):
        handicapped(field(7), field(7).positioner_id[:1], **wrong)


def test_reach_grows_with_the_room_of_each():
    plane = field(7)
    wide = handicapped(plane, plane.positioner_id[[0]], wider_mm=0.7)
    np.testing.assert_allclose(wide.body_reach_mm - plane.body_reach_mm, [0.7, 0, 0, 0, 0, 0, 0], atol=1e-12)
    assert handicaps_of(plane).wider_mm.tolist() == [0.0] * 7
