"""From the camera's positions of a sweep to transmission maps.

While one axis turns, the metrology fibre goes round a circle: its centre is the axis, and the
direction about the centre is the angle up to a constant. The two circles also tell where the other
axis rested: alpha by the direction from centre to centre, beta by the triangle of the lengths.
(What its own sweep found at that position is no help: an axis at rest creeps by what its motor is
kicked about while the other one moves.) The constants are then those with which the layout's
kinematics (Eq. 1) meets all points best, so that the map's angles are the layout's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.calibration.transmission.circle import Circles, fit_circles
from fiberloom.calibration.transmission.maps import Provenance, TransmissionMaps
from fiberloom.calibration.transmission.sweep_data import SweepData
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.timing import part
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import UM_PER_MM, rad_to_deg, wrap_deg

# Less than this on the camera is no motion: a hundred times the noise of a bad camera.
_NO_MOTION_MM = 0.1
_STEPS = 3


@dataclass(frozen=True)
class CalibrationReport:
    """How good the maps of N positioners are, and which have none."""

    positioner_id: Ints
    reason: list[str]
    """Why a positioner has no map of its own; empty where it has."""
    circle_rms_um: Floats
    """(N, 2) radial scatter about the circles of alpha and beta."""
    layout_rms_um: Floats
    """(N,) what the layout's kinematics leaves, rms: the camera's noise along the radius, and what
    the layout's lengths and centre are wrong by."""
    centre_mm: Floats
    """(N, 2) the alpha axis as measured."""
    l_alpha_mm: Floats
    l_alpha_se_mm: Floats
    l_beta_mm: Floats
    """Length from the beta axis to the metrology fibre, and its standard error."""
    l_beta_se_mm: Floats
    n_seen: Ints
    """(N,) points used, of both axes and directions."""

    @property
    def ok(self) -> Flags:
        """(N,) True where the map is measured."""
        return np.array([not reason for reason in self.reason])


@part("maps")
def evaluate(
    plane: FocalPlane, data: SweepData, seen_at_least: float, provenance: Provenance
) -> tuple[TransmissionMaps, CalibrationReport]:
    """Maps and report of a sweep.

    `plane`: the layout; `data`: wire positions and places of the sweep; `seen_at_least`: share of the
    points of a pass that must be usable; `provenance` goes into the maps. A positioner that cannot be
    evaluated keeps the identity, with a reason.
    """
    circles = [_circle(data, axis) for axis in range(2)]
    reason = _first(data.trouble, _not_seen(circles, seen_at_least), _not_moved(data))
    rest = _rest_deg(plane, circles)
    output = np.stack([_output_deg(plane, data, circles, rest, axis) for axis in range(2)], axis=1)
    good = np.flatnonzero([not r for r in reason])
    zero, layout_rms = np.zeros((plane.n, 2)), np.full(plane.n, np.nan)
    if len(good):
        zero[good], layout_rms[good] = _tie(plane, data, output, rest, circles, good)
    output += zero[:, :, None, None]
    reason = _first(reason, _not_rising(output, data.wire_deg))
    wire = np.broadcast_to(data.wire_deg[:, None], output.shape).copy()
    for row in np.flatnonzero([bool(r) for r in reason]):
        output[row] = wire[row]
    maps = TransmissionMaps(plane.positioner_id, wire, output, provenance)
    return maps, _report(plane, circles, reason, layout_rms)


def _circle(data: SweepData, axis: int) -> Circles:
    """Both passes of an axis go round one circle."""
    _, k, n, _ = data.xy_mm[axis].shape
    xy = data.xy_mm[axis].reshape(2 * k, n, 2).transpose(1, 0, 2)
    return fit_circles(xy, np.isfinite(xy).all(axis=-1))


def _first(*reasons: list[str]) -> list[str]:
    """Row by row the first reason that is not empty."""
    return [next((r for r in row if r), "") for row in zip(*reasons, strict=True)]


def _not_seen(circles: list[Circles], seen_at_least: float) -> list[str]:
    out = [""] * len(circles[0].used)
    for axis, circle in enumerate(circles):
        passes = circle.used.reshape(len(out), 2, -1)
        for row, share in enumerate(passes.mean(axis=-1).min(axis=-1)):
            if share < seen_at_least and not out[row]:
                out[row] = (
                    f"only {100 * share:.0f} % of the points of a pass of {AXES[axis]} usable, "
                    f"{100 * seen_at_least:.0f} % needed"
                )
    return out


def _not_moved(data: SweepData) -> list[str]:
    out = [""] * data.xy_mm.shape[3]
    for axis in range(2):
        xy = data.xy_mm[axis].reshape(-1, len(out), 2)
        low = np.where(np.isnan(xy), np.inf, xy).min(axis=0)
        high = np.where(np.isnan(xy), -np.inf, xy).max(axis=0)
        for row in np.flatnonzero((high - low).max(axis=1) < _NO_MOTION_MM):
            out[row] = out[row] or f"{AXES[axis]} did not move"
    return out


def _rest_deg(plane: FocalPlane, circles: list[Circles]) -> Floats:
    """(N, 2) angles of alpha and beta at rest while the other axis turned."""
    alpha, beta = circles
    arm = beta.centre_mm - alpha.centre_mm
    l_alpha, l_beta, reach = np.hypot(*arm.T), beta.radius_mm, alpha.radius_mm
    product = np.maximum(2.0 * l_alpha * l_beta, 1e-300)
    cosine = (reach**2 - l_alpha**2 - l_beta**2) / product
    bend = np.arccos(np.clip(cosine, -1.0, 1.0))  # right-handed, as beta in [0, 180]
    zero = _zeros_rad(plane)
    return rad_to_deg(np.column_stack([np.arctan2(arm[:, 1], arm[:, 0]), bend]) - zero)


def _zeros_rad(plane: FocalPlane) -> Floats:
    """(N, 2) the layout's zeros: directions of the alpha arm, and of the fibre from it."""
    return np.column_stack([plane.alpha_off_rad, plane.beta_off_rad + plane.metrology_phi_rad])


def _output_deg(
    plane: FocalPlane, data: SweepData, circles: list[Circles], rest: Floats, axis: int
) -> Floats:
    """(N, 2, K) output angles of the axis that turned, before they are tied to the layout."""
    xy, circle = data.xy_mm[axis].transpose(2, 0, 1, 3), circles[axis]  # (N, 2, K, 2)
    out = xy - circle.centre_mm[:, None, None]
    direction = rad_to_deg(np.arctan2(out[..., 1], out[..., 0]))
    direction -= _direction_at_zero_deg(plane, circles, rest, axis)[:, None, None]
    # near the wire's angle, whatever the number of turns
    used = circle.used.reshape(direction.shape)
    off = direction - data.wire_deg[axis]
    unit = np.where(used, np.exp(1j * np.deg2rad(np.nan_to_num(off))), 0.0)
    mean = rad_to_deg(np.angle(unit.sum(axis=(1, 2))))[:, None, None]
    off = np.where(used, mean + wrap_deg(off - mean), np.nan)
    output: Floats = _fill(off, data.wire_deg[axis]) + data.wire_deg[axis]
    return output


def _direction_at_zero_deg(plane: FocalPlane, circles: list[Circles], rest: Floats, axis: int) -> Floats:
    """(N,) where the fibre would be, seen from the axis that turned, at its angle 0."""
    zero = _zeros_rad(plane)
    if axis == 1:
        return rest[:, 0] + rad_to_deg(zero[:, 0] + zero[:, 1])
    bend = np.deg2rad(rest[:, 1]) + zero[:, 1]
    arm = circles[1].centre_mm - circles[0].centre_mm
    l_alpha, l_beta = np.hypot(*arm.T), circles[1].radius_mm
    lead = np.arctan2(l_beta * np.sin(bend), l_alpha + l_beta * np.cos(bend))
    return rad_to_deg(zero[:, 0] + lead)


def _fill(off: Floats, wire: Floats) -> Floats:
    """Points that are missing lie on the straight line between their neighbours."""
    off = np.ascontiguousarray(off)  # so that the lines are views
    for line in off.reshape(-1, len(wire)):
        known = np.isfinite(line)
        line[~known] = np.interp(wire[~known], wire[known], line[known]) if known.any() else 0.0
    return off


def _tie(
    plane: FocalPlane,
    data: SweepData,
    output: Floats,
    rest: Floats,
    circles: list[Circles],
    rows: Ints,
) -> tuple[Floats, Floats]:
    """Gauss-Newton on the two constants of each positioner: their values, and the rms left."""
    angles = np.stack([_both_deg(output[rows], rest[rows], axis) for axis in range(2)], axis=1)
    xy = data.xy_mm.transpose(3, 0, 1, 2, 4)[rows].reshape(len(rows), -1, 2)
    used = np.concatenate([c.used[rows] for c in circles], axis=1)
    angles = angles.reshape(len(rows), -1, 2)
    index = np.repeat(rows, angles.shape[1])
    zero = np.zeros((len(rows), 2))
    for _ in range(_STEPS):
        at = (angles + zero[:, None]).reshape(-1, 2)
        left = xy - plane.forward(at[:, 0], at[:, 1], index=index).reshape(xy.shape)
        left = np.where(used[..., None], left, 0.0)
        jacobian = plane.jacobian(at[:, 0], at[:, 1], index=index).reshape(*xy.shape, 2)
        jacobian = np.where(used[..., None, None], jacobian, 0.0)
        inverse = np.linalg.inv(np.einsum("nmci,nmcj->nij", jacobian, jacobian))
        zero += np.einsum("nij,nmcj,nmc->ni", inverse, jacobian, left, optimize=True)
    square = (left**2).sum(axis=(1, 2))
    return zero, np.sqrt(square / used.sum(axis=1)) * UM_PER_MM


def _both_deg(output: Floats, rest: Floats, axis: int) -> Floats:
    """(n, 2, K, 2) both angles at every point of the sweep of one axis."""
    out = np.empty((*output[:, axis].shape, 2))
    out[..., axis] = output[:, axis]
    out[..., 1 - axis] = rest[:, 1 - axis, None, None]
    return out


def _not_rising(output: Floats, wire: Floats) -> list[str]:
    out = [""] * len(output)
    for row, axis, side, k in np.argwhere(~(np.diff(output, axis=-1) > 0.0)):
        contact = ("negative", "positive")[side]
        out[row] = out[row] or (
            f"{AXES[axis]} does not follow its motor at {wire[axis, k]:.1f} deg, {contact} contact"
        )
    return out


def _report(
    plane: FocalPlane,
    circles: list[Circles],
    reason: list[str],
    layout_rms: Floats,
) -> CalibrationReport:
    alpha, beta = circles
    arm = beta.centre_mm - alpha.centre_mm
    l_alpha = np.linalg.norm(arm, axis=1)
    along = arm / np.maximum(l_alpha, 1e-300)[:, None]
    spread = (alpha.covariance + beta.covariance)[:, :2, :2]
    return CalibrationReport(
        positioner_id=plane.positioner_id,
        reason=reason,
        circle_rms_um=np.stack([c.rms_mm for c in circles], axis=1) * UM_PER_MM,
        layout_rms_um=layout_rms,
        centre_mm=alpha.centre_mm,
        l_alpha_mm=l_alpha,
        l_alpha_se_mm=np.sqrt(np.einsum("ni,nij,nj->n", along, spread, along)),
        l_beta_mm=beta.radius_mm,
        l_beta_se_mm=np.sqrt(beta.covariance[:, 2, 2]),
        n_seen=sum(c.used.sum(axis=1) for c in circles),
    )
