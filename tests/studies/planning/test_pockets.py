"""The flood proves pockets, and only pockets."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.planning import campaign, pairs, pockets
from benchmarks.planning.bodies import Bodies, between, read_bodies
from benchmarks.planning.campaign import pocketed
from benchmarks.planning.pockets import Places, Way, flood, meets_one

from fiberloom.instruments import write_layout

BUFFER_MM = 2.0
STOPS_DEG = np.array([[-4.0, 364.0], [-4.0, 364.0]])


def made(centres, discs) -> Bodies:
    """Nominal arms at these places, among discs (distance from 0 in mm, direction in deg) of 1 mm."""
    n = len(centres)
    places = [r * np.exp(1j * np.radians(d)) for r, d in discs]
    obstacles = np.array([[p.real, p.imag, p.real, p.imag, 1.0] for p in places]).reshape(-1, 5)
    arms = np.array(centres, dtype=complex), np.full(n, 7.4), np.zeros(n), np.zeros(n)
    return Bodies(np.arange(1, n + 1), *arms, (0.0, 14.7276), obstacles, STOPS_DEG)


def way(discs, start, goal) -> Way:
    ends = np.array(start, dtype=float), np.array(goal, dtype=float)
    return flood(made([0.0], discs), 0, ends, BUFFER_MM).way


WALL = [(6.0, 90.0)]
"""The elbow passes it at 1.4 mm: no alpha near 90 deg is possible, whatever beta."""


def test_a_wall_across_alpha_parts_both_sides():
    assert way(WALL, (180.0, 120.0), (20.0, 120.0)) == Way.NONE
    assert way([], (180.0, 120.0), (20.0, 120.0)) == Way.THERE
    assert way(WALL, (180.0, 60.0), (300.0, 60.0)) == Way.THERE


def test_alpha_does_not_turn_through_its_stops():
    """On the circle there would be a way round: alpha 20 and 340 deg are 40 deg apart."""
    walls = [(6.0, 90.0), (6.0, 270.0)]
    assert way(walls, (20.0, 120.0), (340.0, 120.0)) == Way.NONE


def test_a_gap_narrower_than_a_coarse_cell_is_decided_by_finer_ones():
    """Elbow and disc leave 0.13 mm; the arm in a coarse cell is anywhere within 0.16 mm."""
    near = 7.4 + 3.13
    bodies = made([0.0], [(near, 90.0)])
    ends = np.array([150.0, 178.0]), np.array([30.0, 178.0])
    found = flood(bodies, 0, ends, BUFFER_MM)
    assert found.way == Way.THERE
    assert found.cell_deg < 0.5
    closed = flood(made([0.0], [(near - 0.15, 90.0)]), 0, ends, BUFFER_MM)
    assert closed.way != Way.THERE


# The second cell is finer than those of the whole square: around the start alone. The third gap opens 0.5 um
# beyond 3 deg: nothing is said.
@pytest.mark.parametrize(
    ("passes_below_deg", "way", "cell_deg"),
    [
        (-3.5, Way.NONE, 0.25),
        (-3.2, Way.NONE, 1 / 16),
        (-3.004, Way.UNKNOWN, 0.125),
        (-2.5, Way.THERE, 0.125),
    ],
)
def test_what_opens_only_where_no_motion_goes_is_a_pocket(passes_below_deg, way, cell_deg):
    """Stretched sideways the arm passes a disc below an angle of alpha alone; a wall shuts the way round."""
    elbow = 7.4 * np.exp(1j * np.radians(passes_below_deg))
    disc = elbow + (14.7276 + BUFFER_MM + 1.0) * np.exp(1j * np.radians(passes_below_deg + 90.0))
    bodies = made([0.0], [(abs(disc), np.degrees(np.angle(disc))), (6.0, 65.0)])
    ends = np.array([0.0, 60.0]), np.array([0.0, 100.0])
    found = flood(bodies, 0, ends, BUFFER_MM)
    assert (found.way, found.cell_deg, found.room_deg) == (way, cell_deg, 1.0)
    assert (found.pocket is not None) == (way == Way.NONE)
    if way == Way.NONE:
        assert "keeps 1 deg to the hard stops" in pocketed(bodies, [1], (ends[:1], ends[1:]), BUFFER_MM)[1]


def stretched_beside(gap_mm) -> tuple[Bodies, tuple]:
    """Starts so far from a disc, goes away from it; another disc overlaps it far from there, stretched."""
    ends = np.array([40.0625, 60.0625]), np.array([40.0625, 100.0625])  # in the middle of cells
    elbow, along = 7.4 * np.exp(1j * np.radians(40.0625)), np.exp(1j * np.radians(100.125))
    near = elbow + 14.0 * along + (BUFFER_MM + 1.0 + gap_mm) * along * -1j
    far = 7.4 * np.exp(1j * np.radians(6.0)) + 8.0 * np.exp(1j * np.radians(12.0))
    bodies = made([0.0], [(abs(disc), np.degrees(np.angle(disc))) for disc in (near, far)])
    return replace(bodies, stops_deg=np.array([[-4.0, 60.0], [-4.0, 120.0]])), ends


def test_one_that_starts_next_to_a_body_is_looked_at_where_it_starts():
    """No cell there is open before the finest ones."""
    bodies, ends = stretched_beside(0.02)
    assert flood(bodies, 0, ends, BUFFER_MM).way == Way.UNKNOWN
    assert flood(bodies, 0, ends[::-1], BUFFER_MM).way == Way.UNKNOWN


def test_one_that_overlaps_a_body_where_it_starts_is_nowhere():
    """By less than wide cells tell: no places of it count."""
    bodies, ends = stretched_beside(-0.012)
    found = flood(bodies, 0, ends, BUFFER_MM)
    assert (found.way, found.pocket) == (Way.NONE, None)


def test_a_goal_that_is_shut_in_tells_no_place(monkeypatch):
    """As above, the other way round; around the start is too much to be looked at."""
    elbow = 7.4 * np.exp(1j * np.radians(-3.2))
    disc = elbow + (14.7276 + BUFFER_MM + 1.0) * np.exp(1j * np.radians(86.8))
    bodies = made([0.0], [(abs(disc), np.degrees(np.angle(disc))), (6.0, 65.0)])
    bodies = replace(bodies, stops_deg=np.array([[-4.0, 40.0], [40.0, 230.0]]))
    ends = np.array([0.0, 100.0]), np.array([0.0, 60.0])
    there = flood(bodies, 0, ends[::-1], BUFFER_MM)
    assert there.way == Way.NONE
    assert there.pocket is not None
    monkeypatch.setattr(pockets, "MOST_AROUND", 170_000)
    found = flood(bodies, 0, ends, BUFFER_MM)
    assert (found.way, found.cell_deg, found.pocket) == (Way.NONE, 1 / 16, None)


def test_who_is_kept_away_by_one_in_a_pocket_is_refused_rightly():
    """The first has its elbow between two discs; the second's goal lies across that elbow."""
    bodies = made([0.0, -22.0], [(6.0, 150.0), (6.0, 210.0)])
    start = np.array([[180.0, 180.0], [90.0, 170.0]])
    goal = np.array([[20.0, 120.0], [268.1, 122.0]])
    found = pocketed(bodies, [1, 2], (start, goal), BUFFER_MM)
    assert set(found) == {1, 2}
    assert "alone" in found[1]
    assert "1, in a pocket" in found[2]
    # while the first is not in a pocket, it can make way: the second is no case of it
    assert pocketed(bodies, [2], (start, goal), BUFFER_MM) == {}
    free = made([0.0, -22.0], [])
    assert pocketed(free, [1, 2], (start, goal), BUFFER_MM) == {}


@pytest.mark.parametrize(
    ("goal_deg", "how"),
    [
        ((268.1, 122.0), "1, in a pocket that keeps 1 deg to the hard stops, meets"),
        ((90.0, 170.0), "no way beside 1 in pockets that keeps 1 deg to the hard stops"),
    ],
)
def test_what_hangs_on_a_pocket_says_what_that_keeps_to_the_hard_stops(monkeypatch, goal_deg, how):
    bodies = made([0.0, -22.0], [])
    start = np.array([[180.0, 180.0], [90.0, 170.0]])
    goal = np.array([[20.0, 120.0], goal_deg])
    there = pockets.Pocket(0, bodies.lines(0, *np.radians(start[:1].T)), 0.0, 1.0)
    shut_in = [pockets.Found(Way.NONE, 0.5, there, 1.0), pockets.Found(Way.NONE, 0.5)]
    monkeypatch.setattr(campaign, "flood", lambda bodies, row, *_: shut_in[row])
    assert how in pocketed(bodies, [1, 2], (start, goal), BUFFER_MM)[2]


def test_of_two_goals_that_one_in_a_pocket_can_only_leave_alone_one_by_one_one_is_refused_rightly():
    """The first can turn by 80 deg between four discs: above it meets the second's goal, below another."""
    discs = [(6.0, 150.0), (6.0, 210.0), (17.0, 80.0), (17.0, 280.0)]
    bodies = made([0.0, 22.4 * np.exp(1j * np.pi / 3), 22.4 * np.exp(-1j * np.pi / 3)], discs)
    goal = np.array([[20.0, 120.0], [297.0, 284.0], [55.0, 64.0]])
    start = np.vstack([[180.0, 180.0], goal[1:]])
    found = pocketed(bodies, [1, 2], (start, goal), BUFFER_MM)
    assert set(found) == {1, 2}
    assert "alone" in found[1]
    assert "not beside all that arrive: 1" in found[2]
    assert set(pocketed(bodies, [1, 3], (start, goal), BUFFER_MM)) == {1, 3}
    # each of them could arrive without the other: to refuse both is no proof
    pocket = flood(bodies, 0, (start[0], goal[0]), BUFFER_MM).pocket
    assert pocket is not None
    both = bodies.lines_of(np.array([1, 2]), goal)
    assert meets_one(pocket, both, BUFFER_MM)
    for one in (0, 1):
        assert not meets_one(pocket, (both[0][[one]], both[1][[one]]), BUFFER_MM)


def lines(random, n, spread_mm):
    """Lines of 14.7 mm around 0, both ends complex."""
    from_ = spread_mm * (random.uniform(-1, 1, n) + 1j * random.uniform(-1, 1, n))
    return from_, from_ + 14.7 * np.exp(1j * random.uniform(-0.02, 0.02, n) * spread_mm)


@pytest.mark.parametrize("spread_mm", [0.3, 2.0])
def test_halved_places_tell_what_all_of_them_tell(spread_mm):
    random = np.random.default_rng(3)
    places, (p, q) = lines(random, 300, spread_mm), lines(random, 500, 5.0)
    met = (between(p[:, None], q[:, None], *places) < 3.0).all(axis=1)
    assert 10 < met.sum() < 490
    np.testing.assert_array_equal(Places(*places).all_met(p, q, 3.0), met)


def test_a_wide_pocket_takes_few_distances(monkeypatch):
    """As in a real pair that took more than 600 s: each cell was held against each place of the other."""
    looked_at = []

    def counting(p, q, r, s):
        gap = between(p, q, r, s)
        looked_at.append(gap.size)
        return gap

    monkeypatch.setattr(pockets, "between", counting)
    random = np.random.default_rng(3)
    places, (p, q) = lines(random, 20_000, 0.5), lines(random, 1000, 5.0)
    assert Places(*places).all_met(p, q, 5.0).any()
    assert sum(looked_at) < 0.02 * 20_000 * 1000


def test_the_bodies_of_a_written_layout_are_those_of_the_plane(tmp_path):
    plane = pairs.array_of("hexagon 19")
    write_layout(plane, tmp_path)
    same_bodies(read_bodies(tmp_path), plane)


def test_the_bodies_of_the_real_tables_are_those_of_the_plane():
    folder = pairs.real_layout()
    if folder is None:
        pytest.skip(f"no {pairs.REAL} beside the checkout: its tables are not part of this project")
    same_bodies(read_bodies(folder), pairs.array_of(str(folder)))


def same_bodies(bodies, plane):
    """To rounding: degrees in tables."""
    np.testing.assert_allclose(bodies.centre, plane.arms[:, 0] + 1j * plane.arms[:, 1], atol=1e-12)
    np.testing.assert_allclose(bodies.l_alpha, plane.arms[:, 2], atol=1e-12)
    turns = np.exp(1j * bodies.alpha_off), np.exp(1j * plane.arms[:, 3])
    np.testing.assert_allclose(*turns, atol=1e-12)
    np.testing.assert_allclose(bodies.beta_off, plane.arms[:, 4], atol=1e-12)
    ours = np.vstack([plane.fiducials[:, [0, 1, 0, 1, 2]], plane.guide_cameras])
    swapped = ours[:, [2, 3, 0, 1, 4]]
    apart = np.minimum(np.abs(bodies.obstacles - ours), np.abs(bodies.obstacles - swapped)).max(axis=1)
    assert (np.sort(apart) < 1e-9).all()
    np.testing.assert_array_equal(bodies.stops_deg, plane.hard_stops_deg)
    assert bodies.segment == plane.beta_segment_mm
