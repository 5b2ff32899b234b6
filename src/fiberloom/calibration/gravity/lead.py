"""Fibres are placed beside their targets, so that gravity turns them onto these until the exposure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fiberloom.assignment import Assignment
from fiberloom.calibration.gravity.sag import ArmSag
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.pointing import ExposurePointing


def led(plane: FocalPlane, assignment: Assignment, sag: ArmSag, pointing: ExposurePointing) -> Assignment:
    """The `assignment` with its goals turned back by what `sag` says until the middle of the exposure.

    `plane`: of its N positioners; `pointing`: of image and exposure. Goals stay within the limits of the
    axes, arms without a target where they are.
    """
    goal_deg = assignment.goal_deg
    turn_deg = sag.turns_deg(plane, goal_deg, pointing.middle) - sag.turns_deg(
        plane, goal_deg, pointing.image
    )
    has = assignment.target >= 0
    low, high = plane.limits_deg.T
    # a few thousandths of a degree
    turned_deg = np.clip(goal_deg - turn_deg, np.minimum(low, goal_deg), np.maximum(high, goal_deg))
    led_deg = np.where(has[:, None], turned_deg, goal_deg)
    lead_mm = np.zeros((len(plane), 2))
    for fibre in np.unique(assignment.fibre[has]).tolist():
        rows = has & (np.asarray(assignment.fibre) == fibre)
        there_mm = plane.forward(led_deg[:, 0], led_deg[:, 1], fibre)
        lead_mm[rows] = (there_mm - plane.forward(goal_deg[:, 0], goal_deg[:, 1], fibre))[rows]
    return replace(assignment, alpha_deg=led_deg[:, 0], beta_deg=led_deg[:, 1], lead_mm=lead_mm)
