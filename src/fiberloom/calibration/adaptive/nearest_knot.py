"""Adaptive calibration as printed: Kronig 2020, Eq. 27 to 33.

What is commanded and what is measured are two Gaussians about the true place of the fibre; their
product gives the most probable place (Eq. 31), Eq. 2 its angles, and the knot of the map nearest to
the motor command is shifted by what the angles are off (Eq. 33).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats, Ints
from fiberloom.units import MM_PER_UM, RAD_PER_DEG, UM_PER_MM, deg_to_rad


@dataclass(frozen=True)
class CommandSigmas:
    """How far a command can be trusted (Eq. 29); the paper prints no numbers.

    These are what a bench calibration leaves of lengths and knots (docs/calibration.md). Ten times
    larger lengths make Eq. 32 throw camera noise into beta where its Jacobian is nearly singular;
    ten times larger angles let a knot follow what is wrong half-way to the next one.
    """

    l_alpha_um: float = 0.1
    l_beta_um: float = 0.1
    alpha_deg: float = 0.002
    beta_deg: float = 0.002


def levers(plane: FocalPlane, index: Ints) -> tuple[Floats, Floats, Floats]:
    """(n,) lengths of both arms in mm, and the angle of the metrology fibre in the arm's frame."""
    return plane.l_alpha_mm[index], plane.l_beta_mm[index], plane.metrology_phi_rad[index]


def directions(plane: FocalPlane, angles_deg: Floats, index: Ints) -> tuple[Floats, Floats]:
    """(n, 2) dimensionless unit vectors along the alpha arm, and from the beta axis to the metrology
    fibre.
    """
    alpha, beta = deg_to_rad(angles_deg).T
    first = alpha + plane.alpha_off_rad[index]
    second = first + beta + plane.beta_off_rad[index] + levers(plane, index)[2]
    return _unit(first), _unit(second)


def _unit(angle_rad: Floats) -> Floats:
    return np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)


def command_covariance(
    plane: FocalPlane,
    angles_deg: Floats,
    sigmas: CommandSigmas,
    index: Ints,
    printed: bool = False,
) -> Floats:
    """(n, 2, 2) mm^2: Sigma_cmd at `angles_deg` (n, 2) of the rows `index` of the `plane`.

    Default: G diag(`sigmas`^2) G^T with G the Jacobian of Eq. 1. `printed`: Eq. 29 as printed, with
    each angle's sigma times its own arm's length: alpha then moves the fibre across the alpha arm with
    lever l_alpha, whatever beta is.
    """
    along_alpha, along_beta = directions(plane, angles_deg, index)
    l_alpha, l_beta, _ = levers(plane, index)
    lengths = MM_PER_UM * np.array([sigmas.l_alpha_um, sigmas.l_beta_um])
    if printed:
        swings = [_across(along_alpha) * l_alpha[:, None], _across(along_beta) * l_beta[:, None]]
    else:
        per_deg = plane.jacobian(angles_deg[:, 0], angles_deg[:, 1], index=index)
        swings = [per_deg[:, :, axis] / RAD_PER_DEG for axis in range(2)]
    angles = RAD_PER_DEG * np.array([sigmas.alpha_deg, sigmas.beta_deg])
    columns = [*zip((along_alpha, along_beta), lengths, strict=True), *zip(swings, angles, strict=True)]
    total: Floats = sum(sigma**2 * column[:, :, None] * column[:, None, :] for column, sigma in columns)
    return total


def _across(unit: Floats) -> Floats:
    return np.stack([-unit[:, 1], unit[:, 0]], axis=-1)


def most_probable(
    r_cmd: Floats, sigma_cmd: Floats, r_meas: Floats, sigma_meas: Floats
) -> tuple[Floats, Floats]:
    """Eq. 30 and 31: the place (n, 2) in mm and its covariance (n, 2, 2) in mm^2, from two Gaussians.

    `r_cmd`, `sigma_cmd`: commanded place in mm and its covariance in mm^2; `r_meas`, `sigma_meas`: the
    measured one.
    """
    inverse = np.linalg.inv(sigma_meas + sigma_cmd)
    share = sigma_cmd @ inverse
    r_est = r_cmd + np.einsum("nij,nj->ni", share, r_meas - r_cmd)
    return r_est, share @ sigma_meas


def estimated_angles(plane: FocalPlane, r_est: Floats, near_deg: Floats, index: Ints) -> Floats:
    """Eq. 32: angles (n, 2) in deg by Eq. 2, on the elbow and turn nearest to `near_deg` (n, 2); NaN where
    out of reach.

    `r_est` (n, 2) mm: the most probable place, of the rows `index` of the `plane`.
    """
    found = plane.inverse(r_est, index=index, near_deg=near_deg)
    angles = np.column_stack([found.alpha_deg, found.beta_deg])
    angles[:, 0] += 360.0 * np.rint((near_deg[:, 0] - angles[:, 0]) / 360.0)
    return np.where(found.reachable[:, None], angles, np.nan)


def shift_nearest(output_deg: Floats, wire_deg: Floats, command_deg: Floats, shift_deg: Floats) -> Floats:
    """Eq. 33: output deg of the knots, the one nearest to the motor command shifted.

    `output_deg`, `wire_deg` (n, 2, K): the knots; `command_deg` (n, 2): wire position of the command;
    `shift_deg` (n, 2): estimated less commanded angle, NaN for no shift.
    """
    nearest = np.abs(wire_deg - command_deg[..., None]).argmin(axis=-1)[..., None]
    out = output_deg.copy()
    moved = np.take_along_axis(out, nearest, axis=-1) + np.nan_to_num(shift_deg)[..., None]
    np.put_along_axis(out, nearest, moved, axis=-1)
    return out


def lever_um_per_deg(plane: FocalPlane, angles_deg: Floats, index: Ints) -> Floats:
    """(n, 2) um: how far the fibre goes for a degree of each axis."""
    jacobian = plane.jacobian(angles_deg[:, 0], angles_deg[:, 1], index=index)
    per_deg: Floats = UM_PER_MM * np.linalg.norm(jacobian, axis=1)
    return per_deg
