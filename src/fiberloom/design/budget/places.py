"""Where targets of an error budget are: spread evenly over the annulus of each positioner."""

from __future__ import annotations

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats

INSIDE_MM = 0.1
"""Targets keep this far from the ends of the reach."""


def random_goals_deg(plane: FocalPlane, rng: np.random.Generator) -> Floats:
    """(N, 2) of the first science fibre, spread evenly over the annulus of each unit."""
    fibre = plane.instrument.science_fibres[0]
    low_mm, high_mm = (abs(x) for x in plane.instrument.reach_mm)
    goals = np.zeros((plane.n, 2))
    left = np.arange(plane.n)
    while len(left):
        radius = np.sqrt(rng.uniform((low_mm + INSIDE_MM) ** 2, (high_mm - INSIDE_MM) ** 2, len(left)))
        turn = rng.uniform(0.0, 2.0 * np.pi, len(left))
        xy_mm = plane.centres_mm[left] + np.column_stack([radius * np.cos(turn), radius * np.sin(turn)])
        found = plane.inverse(xy_mm, fibre, left)
        goals[left] = np.column_stack([found.alpha_deg, found.beta_deg])
        left = left[~found.reachable]
    return goals
