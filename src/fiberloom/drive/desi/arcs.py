"""Arc calibration: arms, zeros and the scales of degraded motors, from places seen on two arcs.

    x + i y = c + R1 exp(i t) + R2 exp(i (t + p)),   t = offset_t + start + s_up U - s_down D

with U and D the ways commanded up and down since the start, p alike. Desimeter's model; the scales are those
of "linear" motors, 1 for the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.drive.desi.clock import degrees_of
from fiberloom.drive.desi.tables import MoveTables
from fiberloom.errors import InputError
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import RAD_PER_DEG

X, Y, R1, R2, OFFSET_T, OFFSET_P, SCALES = range(7)
"""Columns of the unknowns; then the scales of theta up and down, of phi up and down."""
UNKNOWNS = 10
LEAST_RANK = 1e-6
"""Of the smallest to the largest singular value, columns scaled to one: below, the points do not tell."""
ROUNDS = 30


@dataclass(frozen=True, eq=False)
class Arcs:
    """What was commanded and seen at K points of N units; axis 0 is theta, 1 is phi."""

    xy_mm: Floats
    """(N, K, 2) seen, NaN where not."""
    up_deg: Floats
    """(N, K, 2) commanded upwards since the start, summed."""
    down_deg: Floats
    """(N, K, 2) commanded downwards, summed, positive."""
    start_deg: Floats
    """(N, 2) internal angles at the start."""
    arc: Ints
    """(K,) axis that the point's arc turns: 0 theta, 1 phi."""

    def __post_init__(self) -> None:
        shape = self.xy_mm.shape
        same = self.up_deg.shape == self.down_deg.shape == shape
        if not same or self.start_deg.shape != (shape[0], 2) or self.arc.shape != (shape[1],):
            raise InputError(
                f"arcs: places {shape}, ways {self.up_deg.shape}, {self.down_deg.shape}, start "
                f"{self.start_deg.shape}, arcs {self.arc.shape}; (N, K, 2) thrice, (N, 2), (K,) are needed"
            )


@dataclass(frozen=True, eq=False)
class ArcFit:
    """What arcs tell of N units."""

    unknowns: Floats
    """(N, UNKNOWNS) mm, deg and ratios; NaN of refused units."""
    covariance: Floats
    """(N, UNKNOWNS, UNKNOWNS) of them, by their residuals; zero where a scale is not asked for."""
    residual_um: Floats
    """(N,) 2-D rms."""
    ok: Flags
    """(N,)."""
    reason: list[str]
    """Why a unit was refused; empty if it was not."""

    @property
    def scale(self) -> Floats:
        """(N, 2, 2) ratios, by axis, up and down."""
        return self.unknowns[:, SCALES:].reshape(-1, 2, 2)


def arc_goals(range_deg: Floats, fixed_deg: tuple[float, float], points: int = 6) -> tuple[Floats, Ints]:
    """(2 points, 2) internal angles in deg of both arcs, and the axis of each.

    `range_deg` (2, 2): lowest and highest angle of theta and phi; `fixed_deg`: theta of the phi arc, phi of
    the theta arc; `points` of an arc. They zigzag, so that ways up and down are not in one proportion.
    """
    goals, axis = np.tile(np.asarray(fixed_deg, dtype=np.float64), (2 * points, 1)), np.repeat([0, 1], points)
    # 0, 3, 1, 4, 2, 5 of six
    zigzag = (np.arange(points) // 2) + np.arange(points) % 2 * ((points + 1) // 2)
    for k, (low, high) in enumerate(range_deg):
        goals[k * points : (k + 1) * points, k] = np.linspace(low, high, points)[zigzag]
    return goals, axis


def ways_of(tables: MoveTables) -> tuple[Floats, Floats]:
    """(N, 2) deg that tables command upwards, and downwards, of each axis; their overshoots are in both."""
    ways = tables.way_tenths
    return degrees_of(np.maximum(ways, 0).sum(axis=1)), degrees_of(np.maximum(-ways, 0).sum(axis=1))


def fit_arcs(arcs: Arcs, linear: Flags | None = None) -> ArcFit:
    """Least squares of all units at once.

    Parameters
    ----------
    arcs : Arcs
        Places seen, mm, and what was commanded, deg.
    linear : (N, 2) bool, optional
        Axes whose scales are wanted; none when left out.

    Returns
    -------
    ArcFit
        A unit that its points do not determine is refused, with the reason.

    Raises
    ------
    InputError
        No unit is determined.
    """
    n = len(arcs.xy_mm)
    scaled = np.zeros((n, 2), dtype=bool) if linear is None else linear
    free = np.ones((n, UNKNOWNS), dtype=bool)
    free[:, SCALES:] = np.repeat(scaled, 2, axis=1)
    seen = np.isfinite(arcs.xy_mm).all(axis=2)
    with np.errstate(all="ignore"):
        unknowns = _first_guess(arcs, seen)
    started = np.isfinite(unknowns).all(axis=1)
    unknowns = np.where(started[:, None], unknowns, 1.0)
    for _ in range(ROUNDS):
        off, rows = _linearised(arcs, unknowns, seen, free)
        unknowns = unknowns + _step(off, rows, free)
    return _judged(arcs, unknowns, seen, free, started)


def _judged(arcs: Arcs, unknowns: Floats, seen: Flags, free: Flags, started: Flags) -> ArcFit:
    off, rows = _linearised(arcs, unknowns, seen, free)
    normal, scale = _normal(rows, free)
    eigen = np.linalg.eigvalsh(normal)
    told, asked = 2 * seen.sum(axis=1), free.sum(axis=1)
    enough, ranked = told > asked, eigen[:, 0] > LEAST_RANK * eigen[:, -1]
    ok = started & enough & ranked
    if not ok.any():
        raise InputError(f"arcs: none of {len(ok)} units is determined; see more points, on both arcs")
    variance = np.sum(off**2, axis=1) / np.maximum(told - asked, 1)
    inverse = np.linalg.inv(np.where(ok[:, None, None], normal, np.eye(UNKNOWNS)))
    covariance = variance[:, None, None] * inverse / (scale[:, :, None] * scale[:, None, :])
    covariance *= free[:, :, None] & free[:, None, :]
    rms = 1e3 * np.sqrt(2.0 * np.sum(off**2, axis=1) / np.maximum(told, 1))
    why = [_reason(*row) for row in zip(seen.sum(axis=1), asked, started & enough, ranked, strict=True)]
    hidden = np.where(ok[:, None], _wrapped(unknowns), np.nan)
    return ArcFit(hidden, covariance, rms, ok, why)


def _reason(seen: int, asked: int, enough: bool, ranked: bool) -> str:
    if not enough:
        return f"{seen} points seen on both arcs; {asked} unknowns need more"
    return "" if ranked else "its points do not tell these unknowns apart; turn both ways"


def _wrapped(unknowns: Floats) -> Floats:
    out = unknowns.copy()
    for column in (OFFSET_T, OFFSET_P):
        out[:, column] = np.mod(out[:, column] + 180.0, 360.0) - 180.0
    return out


def _internal(arcs: Arcs, unknowns: Floats) -> Floats:
    """(N, K, 2) deg: angles by the scales."""
    scale = unknowns[:, SCALES:].reshape(-1, 1, 2, 2)
    internal: Floats = arcs.start_deg[:, None] + scale[..., 0] * arcs.up_deg - scale[..., 1] * arcs.down_deg
    return internal


def _linearised(arcs: Arcs, unknowns: Floats, seen: Flags, free: Flags) -> tuple[Floats, Floats]:
    """(N, 2 K) what places are off the model, mm; (N, 2 K, UNKNOWNS) how the model changes."""
    internal = _internal(arcs, unknowns)
    t = np.deg2rad(internal[..., 0] + unknowns[:, OFFSET_T, None])
    p = np.deg2rad(internal[..., 1] + unknowns[:, OFFSET_P, None])
    inner, outer = np.exp(1j * t), np.exp(1j * (t + p))
    elbow, fibre = unknowns[:, R1, None] * inner, unknowns[:, R2, None] * outer
    model = unknowns[:, X, None] + 1j * unknowns[:, Y, None] + elbow + fibre
    by_t, by_p = 1j * RAD_PER_DEG * (elbow + fibre), 1j * RAD_PER_DEG * fibre
    one = np.ones_like(inner)
    columns = [one, 1j * one, inner, outer, by_t, by_p]
    for axis, by in enumerate((by_t, by_p)):
        columns += [by * arcs.up_deg[..., axis], -by * arcs.down_deg[..., axis]]
    rows = np.stack(columns, axis=-1) * (seen[..., None] & free[:, None])
    off = np.where(seen, arcs.xy_mm[..., 0] + 1j * arcs.xy_mm[..., 1] - model, 0.0)
    return (
        np.concatenate([off.real, off.imag], axis=1),
        np.concatenate([rows.real, rows.imag], axis=1),
    )


def _normal(rows: Floats, free: Flags) -> tuple[Floats, Floats]:
    """(N, U, U) of columns scaled to one, with a one for unknowns that are fixed; (N, U) the scales."""
    scale = np.sqrt(np.sum(rows**2, axis=1))
    scale = np.where(scale > 0.0, scale, 1.0)
    even = rows / scale[:, None]
    normal = even.transpose(0, 2, 1) @ even
    normal += np.eye(UNKNOWNS) * ~free[:, None]
    return normal, scale


def _step(off: Floats, rows: Floats, free: Flags) -> Floats:
    """(N, U) of Gauss and Newton, damped a little."""
    normal, scale = _normal(rows, free)
    right = np.einsum("nku,nk->nu", rows, off) / scale
    step = np.linalg.solve(normal + 1e-9 * np.eye(UNKNOWNS), right[..., None])[..., 0]
    return np.asarray(step / scale)


def _first_guess(arcs: Arcs, seen: Flags) -> Floats:
    """(N, U): circles through both arcs, scales of one."""
    z = arcs.xy_mm[..., 0] + 1j * arcs.xy_mm[..., 1]
    on_theta, on_phi = seen & (arcs.arc == 0), seen & (arcs.arc == 1)
    centre, elbow = _circle(z, on_theta), _circle(z, on_phi)
    out = np.ones((len(z), UNKNOWNS))
    out[:, X], out[:, Y] = centre.real, centre.imag
    out[:, R1] = np.abs(elbow - centre)
    out[:, R2] = np.where(on_phi, np.abs(z - elbow[:, None]), 0.0).sum(axis=1) / on_phi.sum(axis=1)
    internal = np.deg2rad(_internal(arcs, out))
    arm = (elbow - centre) / np.abs(elbow - centre)
    turn_t = np.where(on_phi, arm[:, None] * np.exp(-1j * internal[..., 0]), 0.0).sum(axis=1)
    towards = (z - elbow[:, None]) / arm[:, None] * np.exp(-1j * internal[..., 1])
    turn_p = np.where(on_phi, towards, 0.0).sum(axis=1)
    out[:, OFFSET_T], out[:, OFFSET_P] = np.rad2deg(np.angle(turn_t)), np.rad2deg(np.angle(turn_p))
    return out


def _circle(z: Floats, on: Flags) -> Floats:
    """(N,) complex middles in mm of circles through places (N, K): algebraic, |z|^2 = 2 a x + 2 b y + c."""
    x, y = np.where(on, z.real, 0.0), np.where(on, z.imag, 0.0)
    rows = np.stack([2.0 * x, 2.0 * y, on.astype(np.float64)], axis=-1)
    normal = rows.transpose(0, 2, 1) @ rows + 1e-12 * np.eye(3)
    right = np.einsum("nku,nk->nu", rows, x**2 + y**2)
    found = np.linalg.solve(normal, right[..., None])[..., 0]
    return np.asarray(found[:, 0] + 1j * found[:, 1])
