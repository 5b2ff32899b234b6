"""Targets at the edge of DESI's reach are left to others."""

import numpy as np

import fiberloom as fl
from fiberloom.assignment import AssignSettings, assign
from fiberloom.assignment.candidates import Block
from fiberloom.drive.desi.maps.reach import SureReach
from fiberloom.drive.way_rules import way_rule
from fiberloom.targets.generate import random_targets

PLANE = fl.FocalPlane.of("desi", seed=0, n=3)


def barred(phi_deg):
    rule = SureReach.of(PLANE)
    turn = phi_deg - np.rad2deg(PLANE.beta_off_rad[0])
    return bool(rule.blocks(np.array([0]), np.array([[10.0, turn]]))[0] == Block.EDGE)


def test_stretched_and_folded_arms_are_barred_by_what_is_not_known_of_them():
    """3 sqrt(3^2 + 2 x 5^2) = 23 um: of two arms of 3 mm, 1.5 mm (phi^2 / 2) is that at 10.0 deg."""
    assert [barred(phi) for phi in (0.0, 9.5, 10.5, 90.0, -9.5, -10.5)] == [1, 1, 0, 0, 1, 0]
    assert barred(180.0)
    assert not barred(175.0)


def test_no_target_is_assigned_there():
    plane = fl.FocalPlane.of("desi", seed=0, n=300)
    targets = random_targets(plane, 600, seed=1)
    plain = assign(plane, targets, seed=0)
    sure = assign(plane, targets, seed=0, settings=AssignSettings(ways=way_rule(plane)))

    def at_the_edge(found):
        rows = np.flatnonzero(found.target >= 0)
        goal = np.column_stack([found.alpha_deg, found.beta_deg])[rows]
        return int((SureReach.of(plane).blocks(rows, goal) == Block.EDGE).sum())

    assert at_the_edge(plain) > 0
    assert at_the_edge(sure) == 0
    assert sure.n_assigned > 0.98 * plain.n_assigned


def test_a_target_at_the_edge_is_told_so():
    """Of targets round one positioner, 10 um short of its reach, none is said to be behind what stands."""
    plane = fl.FocalPlane.of("desi", seed=0, n=1)
    turn = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    reach = float(plane.l_alpha_mm[0] + plane.l_beta_mm[0]) - 0.01
    x_mm, y_mm = plane.centres_mm[0][:, None] + reach * np.array([np.cos(turn), np.sin(turn)])
    names = np.array([f"t{k}" for k in range(12)])
    ring = fl.TargetList(names, x_mm, y_mm, np.ones(12), np.full(12, ""), np.full(12, -1))
    told = assign(plane, ring, settings=AssignSettings(ways=way_rule(plane))).unassigned
    assert len(told) == 12
    assert sum("so near to an end of its reach" in why for why in told.values()) >= 6
    assert not any("past what does not move" in why for why in told.values())
