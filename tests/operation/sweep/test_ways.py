"""How far positioners can turn together, held against the verifier at every place of the pass."""

from dataclasses import replace

import numpy as np
import pytest

from fiberloom.calibration.transmission.sweep import SweepSettings, wire_grid
from fiberloom.instruments import generate, load_instrument
from fiberloom.operation.sweep.ways import SweepPass, clear_ways, slow_plan
from fiberloom.planning import MotionLimits, verify

N = 37
PLANE = generate(load_instrument("sdssv"), 0, n_positioners=N).with_collision_buffer(2.5)
POINTS = wire_grid(PLANE, SweepSettings(60))
ALPHA = SweepPass(0, POINTS[0], 75.0, 0.82)
BETA = SweepPass(1, POINTS[1], 180.0, 0.82)
QUICK = MotionLimits(speed_deg_s=360.0, acceleration_deg_s2=1e6)


def all_but(*rows, plane=PLANE):
    offline = np.isin(np.arange(N), rows)
    return replace(plane, offline=offline, offline_position_deg=plane.park_deg.copy())


def collisions(plane, swept, ways):
    places = np.where(ways.takes[:, None], swept.places_deg(ways.low_deg), plane.park_deg)
    return verify(plane, slow_plan(plane, places, ways.takes), limits=QUICK).collisions


@pytest.mark.parametrize("swept", [ALPHA, BETA], ids=["alpha", "beta"])
def test_all_turn_together_but_not_into_what_stands_still(swept):
    plane = all_but(18)
    ways = clear_ways(plane, plane.park_deg, ~plane.offline, swept)
    assert ways.takes.sum() == N - 1
    assert collisions(plane, swept, ways) == ()
    # without a bend they would meet it: the test can fail
    straight = replace(ways, low_deg=np.full(N, ways.low_deg.min()))
    assert collisions(plane, swept, straight)


def test_only_those_with_something_in_their_way_bend():
    free = clear_ways(PLANE, PLANE.park_deg, np.ones(N, dtype=bool), ALPHA)
    assert set(free.low_deg) == {75.0, 90.0}  # the fiducials are an arm's length away
    plane = all_but(18)
    found = clear_ways(plane, plane.park_deg, ~plane.offline, ALPHA)
    bent = np.flatnonzero((found.low_deg > free.low_deg) & found.takes)
    apart_mm = np.hypot(*(PLANE.centres_mm[bent] - PLANE.centres_mm[18]).T)
    assert len(bent)
    assert apart_mm.max() < 3.0 * PLANE.instrument.layout.pitch_mm


def test_who_has_no_room_even_folded_stays_and_is_told_why():
    disc = [[*PLANE.centres_mm[18], PLANE.body_reach_mm[18]]]
    plane = all_but(18)
    plane = replace(plane, fiducials=np.vstack([plane.fiducials, disc]))
    ways = clear_ways(plane, plane.park_deg, ~plane.offline, ALPHA)
    assert ways.why
    assert {ways.why[row] for row in ways.why} == {
        f"no room to turn: fiducial {len(PLANE.fiducials)} is in its way"
    }
    assert not ways.takes[list(ways.why)].any()
    assert collisions(plane, ALPHA, ways) == ()


def test_points_that_are_not_reached_with_the_backlash_closed_do_not_count():
    low_deg = np.array([-0.82, 45.0])
    usable = BETA.usable(low_deg)
    assert usable[:, 0].all()
    np.testing.assert_array_equal(usable[:, 1], POINTS[1] > 45.0 + 2 * 0.82)
    assert ALPHA.usable(low_deg).all()
    places = BETA.places_deg(low_deg)
    assert places.shape == (62, 2, 2)
    assert (places[..., 0] == 180.0).all()
    assert (places[:, 1, 1] >= 45.0).all()
    assert places[0, 0, 1] == POINTS[1][0] - 0.82
    assert places[-1, 0, 1] == POINTS[1][-1] + 0.82
