"""Assignments for arms of several parts, keep-outs and wider arms, by the planner's own geometry."""

from dataclasses import replace

import numpy as np
import pytest

from fiberloom.assignment import assign
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.handicaps import Handicaps
from fiberloom.planning.bodies import CollisionBodies
from fiberloom.planning.overlaps import Surroundings
from fiberloom.targets import TargetList
from fiberloom.units import deg_to_rad

MARGIN_MM = 0.2


@pytest.fixture(scope="module")
def desi():
    """Arms of ten capsules on two layers; the edges of ten petals."""
    return FocalPlane.of("desi", n=300)


def dense_targets(plane, per_positioner=3.0, seed=3):
    """Everywhere in the field, priority 1."""
    rng = np.random.default_rng(seed)
    radius = np.hypot(*plane.centres_mm.T).max() + 3.0
    n = int(per_positioner * plane.n)
    r, turn = radius * np.sqrt(rng.random(n)), rng.uniform(0.0, 2.0 * np.pi, n)
    names = np.array([f"t{k}" for k in range(n)])
    empty, free = np.full(n, ""), np.full(n, -1)
    return TargetList(names, r * np.cos(turn), r * np.sin(turn), np.ones(n), empty, free)


def gaps_at_rest_mm(plane, found):
    """Rows, bodies and gaps as the planner has them."""
    return Surroundings(plane, CollisionBodies.of(plane)).gaps_of_pairs_mm(deg_to_rad(found.goal_deg))


def test_all_parts_of_all_arms_keep_the_margin(desi):
    found = assign(desi, dense_targets(desi))
    rows, others, gaps = gaps_at_rest_mm(desi, found)
    assert found.n_assigned > 0.75 * desi.n
    assert gaps[others < desi.n].min() > MARGIN_MM
    # half of it to what does not move: here the edges of the petals
    assert (others >= desi.n).any()
    assert gaps[others >= desi.n].min() > MARGIN_MM / 2
    # and the report of the gaps is the planner's, as far as it looks: to arms that can come within 1 mm
    arms = others < desi.n
    least = np.full(desi.n, np.inf)
    np.minimum.at(least, rows[arms], gaps[arms])
    np.minimum.at(least, others[arms], gaps[arms])
    near = np.minimum(least, 1.0)
    assert np.all(np.minimum(found.clearance_mm, 1.0) <= near + 1e-9)
    assert (near < 1.0).sum() > 50


def near_edges(targets, within_mm=0.5):
    """Those beside the edges of petals, at 18 deg and turns of 36 deg."""
    x, y = targets.xy_mm.T
    turn = np.arctan2(y, x) - np.pi / 10
    off = np.hypot(x, y) * np.abs(np.sin(turn - np.round(turn / (np.pi / 5)) * (np.pi / 5)))
    return targets.select(np.flatnonzero(off < within_mm))


def test_keep_outs_keep_targets_off():
    """Without the edges of the petals more targets near them are observed."""
    desi = FocalPlane.of("desi", n=150)
    targets = near_edges(dense_targets(desi, 40.0))
    bodies = desi.instrument.bodies.model_copy(update={"keep_outs": ()})
    open_field = replace(desi, instrument=desi.instrument.model_copy(update={"bodies": bodies}))
    found = assign(open_field, targets)
    _, others, gaps = gaps_at_rest_mm(desi, found)
    assert gaps[others >= desi.n].min() < 0.0
    assert assign(desi, targets).n_assigned < 0.5 * found.n_assigned


def test_a_wider_arm_keeps_its_distance():
    plane = FocalPlane.of("sdssv", n=61)
    wider_mm = np.where(np.arange(plane.n) % 7 == 0, 0.8, 0.0)
    wide = replace(plane, handicaps=replace(Handicaps.none(plane.n), wider_mm=wider_mm))
    found = assign(wide, dense_targets(wide))
    assert gaps_at_rest_mm(wide, found)[2].min() > MARGIN_MM
    # the same list, all arms alike: some come too near for the wide ones
    assert gaps_at_rest_mm(wide, assign(plane, dense_targets(plane)))[2].min() < MARGIN_MM


def test_where_an_offline_arm_may_be_is_kept_free():
    plane = FocalPlane.of("sdssv", n=61)
    plane = plane.with_offline(plane.positioner_id[:4], [90.0, 100.0])
    doubt = np.zeros((plane.n, 2))
    doubt[plane.offline] = 20.0
    unsure = replace(plane, handicaps=replace(Handicaps.none(plane.n), doubt_deg=doubt))
    targets = dense_targets(plane)
    rows, others, gaps = gaps_at_rest_mm(unsure, assign(unsure, targets))
    assert gaps[(others >= plane.n) & ~plane.offline[rows]].min() > MARGIN_MM / 2
    rows, others, gaps = gaps_at_rest_mm(unsure, assign(plane, targets))
    assert gaps[(others >= plane.n) & ~plane.offline[rows]].min() < 0.0
