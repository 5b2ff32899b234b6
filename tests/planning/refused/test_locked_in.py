"""One that cannot come past its neighbours is given up soon, and the others go."""

from dataclasses import replace

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.planning import plan

ROWS = [19, 20, 25, 26, 27, 31, 32, 36]
HERE_DEG = [(10.0, 170.0), (10.0, 170.0), (27.73, 147.22), (-2.75, 153.67), (10.0, 170.0), (10.0, 170.0),
            (262.67, 91.63), (10.0, 170.0)]  # fmt: skip
GOAL_DEG = [(271.42, 29.92), (111.65, 48.12), (245.73, 113.58), (215.95, 59.78), (208.99, 89.18),
            (352.88, 95.56), (84.83, 162.38), (91.04, 113.68)]  # fmt: skip
LOST_MM = [(22.475, -38.849, 24.114), (-10.970, 19.445, 24.148)]
"""Where two of which nothing is known may be."""


def test_what_is_in_vain_ends():
    """It took minutes: 2000 repairs, each of them slow, for every one that was given up."""
    plane = FocalPlane.of("sdssv", n=37, seed=2).select(ROWS)
    plane = replace(plane, fiducials=np.vstack([plane.fiducials, LOST_MM]))
    made = plan(plane, HERE_DEG, GOAL_DEG, seed=2, approach_deg=0.82)
    assert "its goal touches fiducial 62" in made.refused[278]  # and no way to the place it was sent to
    assert 50 < made.statistics["repairs"] < 3000
    assert len(made.refused) <= 3
    assert made.statistics["expansions"] < 20_000_000
