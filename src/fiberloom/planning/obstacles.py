"""What the bodies of a focal plane are made of: capsules on arms, and capsules that do not move."""

import numpy as np

from fiberloom._core import geometry
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.handicaps import Handicaps
from fiberloom.typing import Floats, Ints
from fiberloom.units import deg_to_rad

RADIUS, LAYERS = 6, 7
"""Columns of parts."""
FIRST_LAYER, ALL_LAYERS = 1.0, 2.0**32 - 1.0
_BETA = 1.0

_FAN_STEP_MM = 0.25
"""An uncertain arm is covered by capsules at places so far apart that each is wider by this, or by more where
that would need too many."""
_MOST_IN_FAN = 1024


def parts_of(plane: FocalPlane, radius_mm: float) -> Floats:
    """(P, 8) parts of all positioners with a collision buffer in mm, for `_core.planning.Bodies`."""
    parts = plain_parts(plane.n, plane.beta_segment_mm, radius_mm)
    parts[:, RADIUS] += Handicaps.of(plane).wider_mm
    return parts


def plain_parts(n: int, segment_mm: tuple[float, float], radius_mm: float) -> Floats:
    """(n, 8): each of n positioners is one capsule on the axis of its beta arm, from and to, with a radius."""
    parts = np.zeros((n, 8))
    parts[:] = 0.0, _BETA, segment_mm[0], 0.0, segment_mm[1], 0.0, radius_mm, FIRST_LAYER
    parts[:, 0] = np.arange(n)
    return parts


def on_all_layers(capsules_mm: Floats) -> Floats:
    """(K, 7) obstacles of capsules (K, 5): x0, y0, x1, y1, radius."""
    count = len(capsules_mm)
    return np.column_stack([capsules_mm, np.full(count, ALL_LAYERS), np.full(count, -1.0)])


def fixed_obstacles(plane: FocalPlane) -> Floats:
    """(K, 7) fiducials, then guide cameras."""
    discs = plane.fiducials[:, [0, 1, 0, 1, 2]]
    return on_all_layers(np.vstack([discs, plane.guide_cameras.reshape(-1, 5)]))


def doubt_obstacles(plane: FocalPlane, parts: Floats) -> Floats:
    """(K, 7) capsules that cover all places where offline positioners may be; parts (P, 8)."""
    fans = [_fan(plane, row, parts[parts[:, 0] == row]) for row in _doubtful(plane)]
    return np.vstack([np.zeros((0, 7)), *fans])


def _doubtful(plane: FocalPlane) -> Ints:
    return np.flatnonzero(plane.offline & (Handicaps.of(plane).doubt_deg > 0.0).any(axis=1))


def _fan(plane: FocalPlane, row: int, parts: Floats) -> Floats:
    """(K, 7) of one positioner: its parts at the points of a grid, each as wide as half a step asks for."""
    doubt = deg_to_rad(Handicaps.of(plane).doubt_deg[row])
    l_alpha = plane.l_alpha_mm[row]
    far = np.hypot(parts[:, 2:6:2], parts[:, 3:7:2]).max()
    # no point moves farther than this with alpha and with beta
    lever = np.array([l_alpha + far, far])
    steps = np.maximum(1, np.ceil(doubt * lever * 2.0 / _FAN_STEP_MM)).astype(np.int64)
    while np.prod(steps) > _MOST_IN_FAN:
        steps = np.maximum(1, steps // 2)
    middles = [width * (2.0 * np.arange(k) + 1.0 - k) / k for width, k in zip(doubt, steps, strict=True)]
    off = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, 2)
    angles = deg_to_rad(plane.offline_position_deg[row]) + off
    slack_mm = float((doubt / steps) @ lever)
    fans = []
    for part in parts:
        lines = part_lines_mm(plane.arms[[row]], part, angles)
        rest = np.tile([part[RADIUS] + slack_mm, part[LAYERS], float(row)], (len(lines), 1))
        fans.append(np.column_stack([lines, rest]))
    return np.vstack(fans)


def part_lines_mm(arms: Floats, part: Floats, angles_rad: Floats) -> Floats:
    """(n, 4) centre lines of a part (8,) of an arm (1, 5), or of n arms (n, 5), at angles (n, 2)."""
    n = len(angles_rad)
    arms = np.ascontiguousarray(np.broadcast_to(arms, (n, 5)))
    if part[1] != _BETA:  # the alpha arm is a beta arm on the alpha axis that does not turn against it
        arms = arms * [1.0, 1.0, 0.0, 1.0, 0.0]
        angles_rad = angles_rad * [1.0, 0.0]
    angles = np.ascontiguousarray(angles_rad)
    if part[3] == part[5] == 0.0:
        return geometry.beta_segment(arms, float(part[2]), float(part[4]), angles)
    ends = [geometry.forward(arms, np.tile(part[k : k + 2], (n, 1)), angles) for k in (2, 4)]
    return np.hstack(ends)


def obstacle_name(plane: FocalPlane, index: int) -> str:
    """The name of an obstacle by its index in `CollisionBodies.obstacles`, as in a sentence."""
    fixed = len(plane.fiducials)
    if index < fixed:
        return f"fiducial {index}"
    if index < fixed + len(plane.guide_cameras):
        return f"guide camera {index - fixed}"
    owners = doubt_obstacles(plane, parts_of(plane, 0.0))[:, 6]
    row = int(owners[index - fixed - len(plane.guide_cameras)])
    return f"positioner {plane.positioner_id[row]}, where it may be"
