"""Who may search at the same time: checked by sampling, with other code than that which chooses."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from arrays import layout
from scipy.spatial import cKDTree

from fiberloom.operation.session.clearing import Clearing
from fiberloom.operation.session.home import Homing, near_stop_deg
from fiberloom.planning import plan

PLANE = layout(37)
ALL = np.ones(37, dtype=bool)
NONE = ~ALL
BODY_MM = 2.0


def arm(row, angles_deg):
    """Two ends of the beta arm's centre line, by hand."""
    alpha = PLANE.alpha_off_rad[row] + np.deg2rad(angles_deg[0])
    elbow = PLANE.centres_mm[row] + PLANE.l_alpha_mm[row] * np.array([np.cos(alpha), np.sin(alpha)])
    beta = alpha + PLANE.beta_off_rad[row] + np.deg2rad(angles_deg[1])
    way = np.array([np.cos(beta), np.sin(beta)])
    start, end = PLANE.beta_segment_mm
    return elbow + start * way, elbow + end * way


def points(row, angles_deg):
    a, b = arm(row, angles_deg)
    return a + np.linspace(0.0, 1.0, 60)[:, None] * (b - a)


def nearest_mm(first, second):
    return cKDTree(second).query(first)[0].min()


@pytest.fixture(scope="module")
def rounds():
    """Beta rounds until all have searched."""
    waiting, made = list(range(37)), []
    while waiting:
        found = Clearing(PLANE, PLANE.park_deg, ALL, NONE).beta_round(waiting)
        assert found.searchers
        made.append(found)
        waiting = [row for row in waiting if row not in found.searchers]
    return made


def test_every_positioner_gets_its_turn_once(rounds):
    assert sorted(row for found in rounds for row in found.searchers) == list(range(37))
    assert len(rounds) < 10


def test_no_arm_comes_near_a_searcher_whatever_its_beta(rounds):
    betas = np.arange(-4.0, 172.0, 5.0)
    for found in rounds:
        for row in found.searchers:
            swept = np.vstack([points(row, (found.goals_deg[row, 0], beta)) for beta in betas])
            for other in set(range(37)) - {row}:
                if np.hypot(*(PLANE.centres_mm[row] - PLANE.centres_mm[other])) > 60.0:
                    continue
                if other in found.searchers:  # at any place of its own search
                    there = [points(other, (found.goals_deg[other, 0], beta)) for beta in betas]
                    assert nearest_mm(swept, np.vstack(there)) > 2.0 * BODY_MM
                else:
                    assert nearest_mm(swept, points(other, found.goals_deg[other])) > 2.0 * BODY_MM


def test_bodies_that_cannot_move_are_respected():
    stuck_deg = PLANE.park_deg.copy()
    stuck_deg[20] = [200.0, 60.0]
    mobile = ALL.copy()
    mobile[20] = False
    clearing = Clearing(PLANE, stuck_deg, mobile, NONE)
    found = clearing.beta_round([i for i in range(37) if i != 20])
    np.testing.assert_array_equal(found.goals_deg[20], stuck_deg[20])
    for row in found.searchers:
        swept = np.vstack([points(row, (found.goals_deg[row, 0], b)) for b in np.arange(-4.0, 172.0, 5.0)])
        assert nearest_mm(swept, points(20, stuck_deg[20])) > 2.0 * BODY_MM


def test_next_to_one_that_may_be_anywhere_none_searches():
    somewhere = NONE.copy()
    somewhere[0] = True
    near = np.flatnonzero(np.hypot(*(PLANE.centres_mm - PLANE.centres_mm[0]).T) < 23.0)
    clearing = Clearing(PLANE, PLANE.park_deg, ~somewhere, somewhere)
    assert set(clearing.beta_round(list(range(1, 37))).searchers).isdisjoint(near)


def homing_of(here_deg):
    """Of positioners that are there, none offline."""
    state = SimpleNamespace(here_deg=here_deg, obstacles=lambda: PLANE, mobile=ALL, somewhere=NONE)
    return Homing(SimpleNamespace(plane=PLANE, state=state), np.arange(37))


def test_the_verifier_refuses_of_a_round_those_in_whose_way_another_one_is(rounds):
    """All of a round are shown to it at once: each gets the answer that it gets alone."""
    first = rounds[0]
    here_deg, swept = first.goals_deg.copy(), []
    for row in first.searchers[::3]:
        near = np.argsort(np.hypot(*(PLANE.centres_mm - PLANE.centres_mm[row]).T))[1:7]
        other = next(i for i in near if i not in first.searchers)
        # stretched towards the searcher, whose arm is folded now
        towards = np.arctan2(*(PLANE.centres_mm[row] - PLANE.centres_mm[other])[::-1])
        here_deg[other] = np.rad2deg(towards - PLANE.alpha_off_rad[other]) % 360.0, 0.0
        swept.append(row)
    homing = homing_of(here_deg)
    clear = homing._verified(first.searchers, "beta")
    assert clear == [row for row in first.searchers if homing._verified([row], "beta")]
    assert set(swept).isdisjoint(clear)
    assert len(clear) > 1
    assert homing_of(first.goals_deg)._verified(first.searchers, "beta") == first.searchers


def test_a_searcher_that_is_not_where_it_begins_is_in_the_way_of_others(rounds, monkeypatch):
    """With the margin of those at rest, which the verifier does not ask for."""
    monkeypatch.setattr(Homing, "_verified", lambda homing, rows, axis: rows)
    first = rounds[0]
    assert homing_of(first.goals_deg)._ready(first, "beta") == first.searchers
    apart_mm = np.hypot(*(PLANE.centres_mm[first.searchers, None] - PLANE.centres_mm[first.searchers]).T)
    apart_mm[apart_mm == 0.0] = np.inf
    one, other = (first.searchers[k] for k in np.unravel_index(apart_mm.argmin(), apart_mm.shape))
    refused = set()
    for alpha_deg in range(0, 360, 5):
        here_deg = first.goals_deg.copy()
        here_deg[one] = alpha_deg, 0.0
        ready = homing_of(here_deg)._ready(first, "beta")
        assert one not in ready
        refused |= set(first.searchers) - set(ready)
    assert other in refused


def test_the_verifier_refuses_searches_of_alpha_where_an_arm_lies_in_the_disc():
    clearing = Clearing(PLANE, PLANE.park_deg, ALL, NONE)
    found = clearing.alpha_round(list(range(37)))
    homing = homing_of(PLANE.park_deg)
    assert homing._verified(found.searchers, "alpha") == found.searchers
    here_deg, row = PLANE.park_deg.copy(), 0
    other = int(np.argsort(np.hypot(*(PLANE.centres_mm - PLANE.centres_mm[row]).T))[1])
    towards = np.arctan2(*(PLANE.centres_mm[row] - PLANE.centres_mm[other])[::-1])
    here_deg[other] = np.rad2deg(towards - PLANE.alpha_off_rad[other]) % 360.0, 0.0
    rows = [r for r in found.searchers if r != other]
    assert row in rows
    clear = homing_of(here_deg)._verified(rows, "alpha")
    assert row not in clear
    assert clear == [r for r in rows if homing_of(here_deg)._verified([r], "alpha")]


def test_where_one_is_nowhere_nobody_searches(rounds):
    """The verifier looks at nothing else then."""
    here_deg = rounds[0].goals_deg.copy()
    here_deg[next(i for i in range(37) if i not in rounds[0].searchers)] = np.nan
    assert homing_of(here_deg)._verified(rounds[0].searchers, "beta") == []


def with_beta(**axis):
    instrument = PLANE.instrument
    return replace(
        PLANE, instrument=instrument.model_copy(update={"beta": instrument.beta.model_copy(update=axis)})
    )


@pytest.mark.parametrize(
    ("plane", "here", "near"),
    [
        (PLANE, 170.0, 6.0),
        (PLANE, 3.0, 3.0),  # not away from its stop
        (with_beta(hard_stop_deg=(-30.0, 364.0)), 170.0, -4.0),  # no plan goes farther below the range
    ],
)
def test_a_search_begins_near_the_stop_where_plans_go(plane, here, near):
    here_deg = np.tile([10.0, here], (37, 1))
    np.testing.assert_allclose(near_stop_deg(plane, [2, 5], here_deg), [near, near])
    goals_deg = here_deg.copy()
    goals_deg[[2, 5], 1] = near
    made = plan(plane, here_deg, goals_deg)
    assert made.refused == {}
