"""What wrong centres and lengths of arms do once the zeros of the maps are tied to the layout.

A sweep measures angles about the true axes; the two constants of a map are those with which the layout's
kinematics meets all points of the sweep best (`fiberloom.calibration.transmission.evaluate`). So a part of
what a length has wrong is made up for. To first order, with d the displacement of the fibre and J the
Jacobian of Kronig 2020, Eq. 1: zeros = J(sweep)^+ d(sweep), and what is left at a target is d - J zeros.
"""

from __future__ import annotations

import math

import numpy as np

from fiberloom.calibration import SweepSettings
from fiberloom.typing import Floats

SWEEP_BETA_DEG, SWEEP_ALPHA_DEG = SweepSettings.beta_lever_deg, SweepSettings.alpha_rest_deg
"""Of beta while alpha is swept, and of alpha while beta is."""
POINTS = 181


def left_mm2(l_alpha_mm: float, l_beta_mm: float, beta_range_deg: tuple[float, float]) -> Floats:
    """(4, 4) mean square that is left over the targets, of errors of centre x, y, l_alpha, l_beta.

    A dimensionless form: p^T Q p is in the square of the unit of p. Targets are spread evenly over the
    annulus, so that beta has the density sin(beta); `beta_range_deg` of the sweep.
    """
    turn = np.linspace(0.0, 2.0 * np.pi, POINTS)[:-1]
    low, high = (math.radians(angle) for angle in beta_range_deg)
    bend = np.linspace(low, high, POINTS)
    sweep_alpha = np.concatenate([turn, np.full(len(bend), math.radians(SWEEP_ALPHA_DEG))])
    sweep_beta = np.concatenate([np.full(len(turn), math.radians(SWEEP_BETA_DEG)), bend])
    moved, jacobian = _linear(l_alpha_mm, l_beta_mm, sweep_alpha, sweep_beta)
    zeros = np.linalg.pinv(jacobian.reshape(-1, 2)) @ moved.reshape(-1, 4)
    moved, jacobian = _linear(l_alpha_mm, l_beta_mm, *_targets())
    left = moved - jacobian @ zeros
    form: Floats = np.einsum("nci,ncj->ij", left, left) / len(left)
    return form


def sag_mm2(l_alpha_mm: float, l_beta_mm: float, compliance: Floats) -> Floats:
    """(2, 2) mean square of the way of the fibre, mm^2, by products of the torques on alpha and beta, (Nm)^2.

    Torques of gravity on arms that point along it; `compliance` (2,) rad/Nm of alpha and beta. Beta's moment
    turns alpha too.
    """
    alpha, beta = _targets()
    _, jacobian = _linear(l_alpha_mm, l_beta_mm, alpha, beta)
    first, second = np.cos(alpha), np.cos(alpha + beta)
    turned = np.zeros((len(alpha), 2, 2))
    turned[:, 0, 0], turned[:, 0, 1], turned[:, 1, 1] = first, second, second
    way = jacobian @ (compliance[:, None] * turned)
    form: Floats = np.einsum("nci,ncj->ij", way, way) / len(way)
    return form


def _targets() -> tuple[Floats, Floats]:
    """(3600,) alpha and beta in rad of targets spread evenly over the annulus."""
    turn = np.arange(60) * 2.0 * np.pi / 60
    bend = np.arccos(1.0 - (2.0 * np.arange(60) + 1.0) / 60.0)
    return np.tile(turn, 60), np.repeat(bend, 60)


def _linear(l_alpha_mm: float, l_beta_mm: float, alpha: Floats, beta: Floats) -> tuple[Floats, Floats]:
    """(n, 2, 4) displacement by errors of centre and lengths, and (n, 2, 2) mm by rad of the angles."""
    first, second = (np.column_stack([np.cos(a), np.sin(a)]) for a in (alpha, alpha + beta))
    moved = np.zeros((len(alpha), 2, 4))
    moved[:, :, :2] = np.eye(2)
    moved[:, :, 2], moved[:, :, 3] = first, second
    fibre = l_alpha_mm * first + l_beta_mm * second
    turned = np.stack([fibre, l_beta_mm * second], axis=-1)
    jacobian = np.stack([-turned[:, 1], turned[:, 0]], axis=1)
    return moved, jacobian
