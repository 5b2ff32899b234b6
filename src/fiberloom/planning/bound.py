"""The time below which no plan gets its positioners to their goals."""

from collections.abc import Collection

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.instruments import FocalPlane
from fiberloom.planning.bodies import angles_rad, approach_rad, beside, paces_rad
from fiberloom.planning.planner import PlanSettings


def bound_s(
    plane: FocalPlane,
    start_deg: ArrayLike,
    goal_deg: ArrayLike,
    *,
    settings: PlanSettings | None = None,
    refused: Collection[int] = (),
) -> float:
    """The time that the longest way of one axis takes at the planned speed, approach included.

    max over axes of (|goal + approach - start| + approach) / speed. Waits, ways round others and the time
    to speed up come on top.

    Parameters
    ----------
    plane : FocalPlane
        N positioners. Those offline, and those at their goal already, have no way.
    start_deg, goal_deg : array_like
        (N, 2) alpha and beta, deg.
    settings : PlanSettings, optional
        Of the plan; its speed counts, and the share of it that a positioner has.
    refused : collection of int
        Positioners that do not arrive, as `Plan.refused`: they have no way.

    Returns
    -------
    float
        s; 0 where no positioner has a way.

    Examples
    --------
    >>> import fiberloom as fl
    >>> from fiberloom.planning import bound_s
    >>> plane = fl.FocalPlane.of("sdssv", n=7)
    >>> round(bound_s(plane, plane.park_deg, plane.park_deg - [0.0, 58.5]), 2)
    5.07
    """
    start, goal = (
        angles_rad(name, angles, plane) for name, angles in (("start_deg", start_deg), ("goal_deg", goal_deg))
    )
    approach = approach_rad(plane, None)
    way = np.abs(goal + beside(plane, approach) - start).max(axis=1) + approach
    stays = plane.offline | (start == goal).all(axis=1) | np.isin(plane.positioner_id, list(refused))
    speed, _ = paces_rad(plane, (settings or PlanSettings()).of(plane).speed_deg_s or 0.0, 0.0)
    return float((np.where(stays, 0.0, way) / speed).max(initial=0.0))
