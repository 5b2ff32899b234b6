"""Arms that touch: contact forces, and the firmware that feels them (Kronig 2020, Eq. 22)."""

import numpy as np
import pytest
from wire import COLLISION, STOP, commands, goto

from fiberloom._core import geometry
from fiberloom.bus.identifier import encode
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Twin, draw_units

PLANE = generate(load_instrument("sdssv"), seed=4, n_positioners=2)
UNITS = draw_units(PLANE, seed=6)
IDS = [int(i) for i in PLANE.positioner_id]


def towards(row, point):
    """Alpha at which an arm stretched out (beta 0) points at a place, deg in [0, 360)."""
    x, y = point - UNITS.arms[row, :2]
    return np.rad2deg(np.arctan2(y, x) - UNITS.arms[row, 3]) % 360.0


def facing(offset_deg):
    """Both arms stretched towards each other's centre, turned off by this angle: tips pass."""
    return np.array([[towards(i, UNITS.arms[1 - i, :2]) + offset_deg, 0.5] for i in (0, 1)])


def gaps_mm(twin, pairs=((0, 1),)):
    """Free way between the real arms of pairs, by the true angles."""
    angles = np.deg2rad(twin.truth())
    segments = geometry.beta_segment(twin.units.arms, *twin.plane.beta_segment_mm, angles)
    i, j = np.array(pairs).T
    return geometry.segment_distance(segments[i], segments[j]) - 3.0


def test_two_arms_that_meet_stop_and_say_so():
    twin = Twin(PLANE, UNITS, seed=1, threads=1, start_deg=facing(25.0))
    assert gaps_mm(twin)[0] > 1.0
    goals = facing(-25.0)
    for number, goal in zip(IDS, goals, strict=True):
        goto(twin, number, *goal)
    replies = twin.run(4.0)
    assert {r[0] for r in commands(replies) if r[1] == COLLISION} == set(IDS)
    reported = [r.time_s for r, c in zip(replies, commands(replies), strict=True) if c[1] == COLLISION]
    counted = twin.contacts()  # which takes none of them away
    touches = twin.touches()
    assert [(t.positioner_id, t.other) for t in touches][:1] == [(IDS[0], IDS[1])]
    assert counted == len(touches) == twin.contacts()
    # the arms bend by a degree before the threshold of Eq. 22 is met, at 12 deg/s and at a slant
    assert 0.0 < min(reported) - touches[0].time_s < 0.5
    stopped = twin.truth()
    assert np.abs(stopped[:, 0] - goals[:, 0]).min() > 20.0
    assert abs(gaps_mm(twin)[0]) < 0.05  # bent arms touch, they do not pass through each other
    twin.run(1.0)
    assert (twin.truth() == stopped).all()


def test_arms_that_begin_close_touch_before_they_overlap():
    """The first look at a pair is planned before the first tick: no later than the two may meet."""
    near, far = 0.0, 25.0  # they overlap, they do not
    while far - near > 1e-4:
        middle = 0.5 * (near + far)
        apart = gaps_mm(Twin(PLANE, UNITS, seed=1, threads=1, start_deg=facing(middle)))[0] > 0.02
        near, far = (near, middle) if apart else (middle, far)
    twin = Twin(PLANE, UNITS, seed=1, threads=1, start_deg=facing(far))
    for number, goal in zip(IDS, facing(-far), strict=True):
        goto(twin, number, *goal)
    deepest_mm = 0.0
    while not twin.touches() and twin.time_s < 1.0:
        twin.run(0.002)
        deepest_mm = min(deepest_mm, gaps_mm(twin)[0])
    assert twin.time_s < 1.0
    assert deepest_mm > -0.05  # from one look to the next: 2 ms, both at 10 mm/s at most


def test_one_hits_another_at_rest():
    twin = Twin(PLANE, UNITS, seed=1, threads=1, start_deg=facing(25.0))
    before = twin.truth()[1]
    goto(twin, IDS[0], *facing(-60.0)[0])
    replies = twin.run(6.0)
    assert {r[0] for r in commands(replies) if r[1] == COLLISION} == {IDS[0]}
    pushed = twin.truth()[1] - before
    # it is not driven back, only bent: below what its own stiffness allows
    assert 1e-3 < np.abs(pushed).max() < 0.5
    # the push ends when the other goes away
    goto(twin, IDS[0], *facing(40.0)[0])
    twin.run(0.01)


def test_arms_pass_when_neighbours_are_off():
    twin = Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False, start_deg=facing(25.0))
    for number, goal in zip(IDS, facing(-25.0), strict=True):
        goto(twin, number, *goal)
    replies = twin.run(6.0)
    assert COLLISION not in {r[1] for r in commands(replies)}
    np.testing.assert_allclose(twin.truth(), facing(-25.0), atol=0.6)


def test_a_fiducial_is_hit_too():
    plane = PLANE.select([0])
    units = UNITS.select([0])
    centre = units.arms[0, :2]
    direction = np.deg2rad(100.0) + units.arms[0, 3]
    spot = centre + 19.0 * np.array([np.cos(direction), np.sin(direction)])
    plane = type(plane)(**{**plane.__dict__, "fiducials": np.array([[*spot, 2.0]])})
    twin = Twin(plane, units, seed=1, threads=1, start_deg=(60.0, 0.5))
    goto(twin, IDS[0], 140.0, 0.5)
    replies = twin.run(8.0)
    assert COLLISION in {r[1] for r in commands(replies)}
    assert [t.other for t in twin.touches()] == [None]
    # 3.5 mm at 19 mm: it meets it 10.6 deg before the middle, beta's half degree sooner, and stops within
    # the bending of beta by some newtons at 10 N/mm
    meets = 100.0 - np.rad2deg(np.arcsin(3.5 / 19.0))
    assert meets - 0.5 < twin.truth()[0, 0] < meets + 1.0
    # pressing on, and springing back, it is the same contact; come again it is another
    twin.run(1.0)
    twin.send([(encode(IDS[0], STOP, 1), b"")])
    goto(twin, IDS[0], 60.0, 0.5)
    twin.run(10.0)
    assert twin.truth()[0, 0] < 61.0
    assert twin.touches() == []
    goto(twin, IDS[0], 140.0, 0.5)
    twin.run(8.0)
    assert [t.other for t in twin.touches()] == [None]


@pytest.mark.parametrize("seed", [1, 7, 11])
def test_every_first_touch_is_found_at_its_sync_point(seed):
    """Against the distances at every sync point: far neighbours are looked at rarely, but never
    too late. A second twin takes long slices where nothing can meet.
    """
    plane = generate(load_instrument("sdssv"), seed=4, n_positioners=7)
    units = draw_units(plane, seed=6)
    twin, other = (Twin(plane, units, seed=1, threads=1) for _ in range(2))
    pairs = np.array([(i, j) for i in range(7) for j in range(i + 1, 7)])
    rng = np.random.default_rng(seed)
    for number in plane.positioner_id:
        goal = rng.uniform(0, 350), rng.uniform(0, 60)
        goto(twin, int(number), *goal)
        goto(other, int(number), *goal)
    found = []
    while not found and twin.time_s < 20.0:
        free = gaps_mm(twin, pairs) > 0.0
        now = twin.time_s
        twin.run(0.002)
        found = twin.touches()
        if not free.all():
            ids = plane.positioner_id[pairs[~free]]
            assert [(t.positioner_id, t.other) for t in found] == [tuple(i) for i in ids]
            assert found[0].time_s == pytest.approx(now, abs=1e-9)
        else:
            assert not found
    assert found
    other.run(twin.time_s)
    assert other.touches() == found
