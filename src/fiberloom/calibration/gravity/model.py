"""How arms turn under gravity: the torque of their masses through the compliance of their gears.

An axis carries a mass m whose centre is at r in the frame of its arm. Gravity g turns it by the torque
m r x g, and the arm gives way by that over the stiffness k of the gear (Kronig 2020, Eq. 5a and Fig. 13). So
an arm has two numbers, the turns at 1 g by the parts of m r along the arm and across it:

    turn = along (u x g) - across (u . g),   u: direction of the arm, g in units of 9.80665 m/s^2

The beta arm is carried by alpha as well: alpha also turns by beta's turn times k_beta / k_alpha, which is
0.025 / 0.337 by Fig. 13; a gear that differs from it by 7 % changes the position by 0.01 um.
"""

from __future__ import annotations

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.instruments.pointing import STANDARD_GRAVITY_M_S2, Pointing
from fiberloom.typing import Floats
from fiberloom.units import deg_to_rad, rad_to_deg

PARAMETERS = ("alpha_along", "alpha_across", "beta_along", "beta_across")
"""Of a positioner, rad at 1 g."""
BETA_AT_ALPHA = 0.025 / 0.337
"""Stiffness of beta over that of alpha (Kronig 2020, Fig. 13)."""


def turns_per_parameter(plane: FocalPlane, angles_deg: Floats, pointing: Pointing) -> Floats:
    """(N, 2, 4): turns of alpha and beta by each parameter, at `angles_deg` (N, 2) of the `plane`."""
    across, down = pointing.gravity_m_s2() / STANDARD_GRAVITY_M_S2
    alpha_rad = deg_to_rad(angles_deg[:, 0]) + plane.alpha_off_rad
    beta_rad = alpha_rad + deg_to_rad(angles_deg[:, 1]) + plane.beta_off_rad
    turns = np.zeros((len(plane), 2, len(PARAMETERS)))
    for axis, direction_rad in enumerate((alpha_rad, beta_rad)):
        x, y = np.cos(direction_rad), np.sin(direction_rad)
        turns[:, axis, 2 * axis] = x * down - y * across
        turns[:, axis, 2 * axis + 1] = -(x * across + y * down)
    turns[:, 0, 2:] = BETA_AT_ALPHA * turns[:, 1, 2:]
    return turns


def turns_deg(plane: FocalPlane, angles_deg: Floats, sag_rad: Floats, pointing: Pointing) -> Floats:
    """(N, 2) deg by which the arms of the `plane` turn at `angles_deg` (N, 2), by their `sag_rad` (N, 4).

    `pointing`: of the telescope.
    """
    turned = np.einsum("nap,np->na", turns_per_parameter(plane, angles_deg, pointing), sag_rad)
    return rad_to_deg(turned)


def shifts_per_parameter(plane: FocalPlane, angles_deg: Floats, pointing: Pointing) -> Floats:
    """(N, 2, 4) mm/rad: shifts in x and y of the metrology fibre by each parameter."""
    per_rad = rad_to_deg(plane.jacobian(angles_deg[:, 0], angles_deg[:, 1]))
    shifts: Floats = per_rad @ turns_per_parameter(plane, angles_deg, pointing)
    return shifts
