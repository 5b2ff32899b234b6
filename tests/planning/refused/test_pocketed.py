"""One that cannot leave its pocket makes room within it; those that it cannot make way for are refused."""

import numpy as np
import pytest

from fiberloom.instruments import FocalPlane, load_instrument, read_layout
from fiberloom.planning import plan, random_configuration, verify

ALONE = "it cannot pass what stands still around it within its travel, even alone"
START_DEG = np.array([[1.679, 10.222], [116.258, 162.774]])
GOAL_DEG = np.array([[83.29, 102.92], [344.932, 135.877]])
NEAR_MM = 70.0
"""Of centres: arms that can touch are nearer than 50 mm."""


def test_one_in_a_pocket_makes_room_for_a_neighbour():
    """234 starts beside a fiducial that it cannot pass, in the place where 210 must be."""
    whole = FocalPlane.of("sdssv", seed=0, n=127)
    plane = whole.select(whole.index_of([234, 210]))
    made = plan(plane, START_DEG, GOAL_DEG)
    assert made.refused == {234: f"positioner 234: {ALONE}"}
    assert verify(plane, made).ok
    np.testing.assert_allclose(made.end_deg[1], GOAL_DEG[1], atol=1e-6)
    assert np.abs(made.end_deg[0] - START_DEG[0]).max() > 0.5


@pytest.mark.parametrize(
    ("seed", "in_pocket", "refused"),
    [(160, 200, {200}), (336, 1094, {1094, 932}), (198, 962, {962, 110})],
)
def test_pairs_of_the_campaign(shared_sdssv, seed, in_pocket, refused):
    """Others were refused that a flood of their angles lets arrive: once 501 and 689, once 1000 and 581.

    Where 1094 can be, it is always in the way of 932. Where 962 can be, it is in the way of 110 or of 944, at
    its start of both; both were refused.
    """
    plane = read_layout(shared_sdssv / "apo_2024.04.01", load_instrument("sdssv"))
    start_deg, goal_deg = (
        random_configuration(plane, 2 * seed + end, collision_buffer_mm=2.0) for end in (0, 1)
    )
    middle_mm = plane.centres_mm[plane.index_of([in_pocket])]
    near = np.flatnonzero(np.hypot(*(plane.centres_mm - middle_mm).T) < NEAR_MM)
    made = plan(plane.select(near), start_deg[near], goal_deg[near], seed=seed)
    assert made.refused.keys() == refused
