"""What the bodies of a focal plane are made of: capsules on arms, and capsules that do not move."""

import numpy as np

from fiberloom._core import geometry
from fiberloom.errors import InputError
from fiberloom.instruments import AXES, FocalPlane
from fiberloom.instruments.outlines import layer_bits
from fiberloom.instruments.single_units import handicaps_of
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import deg_to_rad

RADIUS, LAYERS = 6, 7
"""Columns of parts."""
FIRST_LAYER, ALL_LAYERS = 1.0, 2.0**32 - 1.0
BETA = 1.0

_FAN_STEP_MM = 0.25
"""An uncertain arm is covered by capsules at places so far apart that each is wider by this, or by more where
that would need too many."""
_MOST_IN_FAN = 1000


def parts_of(plane: FocalPlane, radius_mm: float) -> Floats:
    """(P, 8) parts of all positioners with a collision buffer in mm, for `_core.planning.Bodies`."""
    one = parts_of_one(plane, radius_mm)
    parts = np.tile(one, (plane.n, 1))
    parts[:, 0] = np.repeat(np.arange(plane.n), len(one))
    parts[:, RADIUS] += handicaps_of(plane).wider_mm[parts[:, 0].astype(np.int64)]
    return parts


def parts_of_one(plane: FocalPlane, radius_mm: float) -> Floats:
    """(P, 8) parts of a positioner that is no wider than others, with a collision buffer in mm; row 0."""
    bodies = plane.instrument.bodies
    if not bodies.parts:
        return plain_parts(1, plane.beta_segment_mm, radius_mm)
    wider_mm = radius_mm - bodies.collision_buffer_mm
    rows = []
    for outline in plane.instrument.bodies.parts:
        arm, bits = float(AXES.index(outline.arm)), float(layer_bits(outline.layers))
        rows += [[0.0, arm, *capsule[:4], capsule[4] + wider_mm, bits] for capsule in outline.capsules_mm]
    one = np.array(rows)
    if (one[:, RADIUS] <= 0.0).any():
        least = plane.instrument.bodies.collision_buffer_mm - one[:, RADIUS].min() - wider_mm
        raise InputError(f"collision_buffer_mm: parts of {plane.instrument.name} need more than {least:g}")
    return one


def meet(kinds: Floats, others: Floats) -> Flags:
    """Whether parts can touch, of their arms and layers (..., 2): they share a layer; not two alpha arms."""
    one, other = (np.asarray(k[..., 1], dtype=np.int64) for k in (kinds, others))
    arms = (kinds[..., 0] == BETA) | (others[..., 0] == BETA)
    return np.asarray((one & other != 0) & arms, dtype=np.bool_)


def plain_parts(n: int, segment_mm: tuple[float, float], radius_mm: float) -> Floats:
    """(n, 8): each of n positioners is one capsule on its beta arm, from and to, mm."""
    parts = np.zeros((n, 8))
    parts[:] = 0.0, BETA, segment_mm[0], 0.0, segment_mm[1], 0.0, radius_mm, FIRST_LAYER
    parts[:, 0] = np.arange(n)
    return parts


def on_all_layers(capsules_mm: Floats) -> Floats:
    """(K, 7) obstacles of capsules (K, 5) in mm: x0, y0, x1, y1, radius."""
    count = len(capsules_mm)
    return np.column_stack([capsules_mm, np.full(count, ALL_LAYERS), np.full(count, -1.0)])


def fixed_obstacles(plane: FocalPlane) -> Floats:
    """(K, 7) in mm: fiducials, then guide cameras, then keep-outs."""
    discs = plane.fiducials[:, [0, 1, 0, 1, 2]]
    fixed = [on_all_layers(np.vstack([discs, plane.guide_cameras.reshape(-1, 5)]))]
    fixed[0][: len(discs), 5] = np.where(discs[:, 4] > 0.0, ALL_LAYERS, _untouched_bits(plane))
    for keep_out in plane.instrument.bodies.keep_outs:
        edges = on_all_layers(keep_out.capsules_mm)
        edges[:, 5] = layer_bits(keep_out.layers)
        fixed.append(edges)
    return np.vstack(fixed)


def _untouched_bits(plane: FocalPlane) -> float:
    """The layers on which no arm has a part; those of what no arm can touch."""
    taken = [layer_bits(part.layers) for part in plane.instrument.bodies.parts] or [int(FIRST_LAYER)]
    return float(int(ALL_LAYERS) & ~int(np.bitwise_or.reduce(taken)))


def doubt_obstacles(plane: FocalPlane, parts: Floats) -> Floats:
    """(K, 7) capsules, in mm, that cover all places where offline positioners may be; parts (P, 8)."""
    fans = [_fan(plane, row, parts[parts[:, 0] == row]) for row in _doubtful(plane)]
    return np.vstack([np.zeros((0, 7)), *fans])


def _doubtful(plane: FocalPlane) -> Ints:
    return np.flatnonzero(plane.offline & (handicaps_of(plane).doubt_deg > 0.0).any(axis=1))


def _fan(plane: FocalPlane, row: int, parts: Floats) -> Floats:
    """(K, 7) of one positioner: its parts at the points of a grid, each as wide as half a step asks for."""
    doubt = deg_to_rad(handicaps_of(plane).doubt_deg[row])
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
    """(n, 4) centre lines in mm of a part (8,) of an arm (1, 5), or of n arms (n, 5), at n angles in rad."""
    n = len(angles_rad)
    arms = np.ascontiguousarray(np.broadcast_to(arms, (n, 5)))
    if part[1] != BETA:  # the alpha arm is a beta arm on the alpha axis that does not turn against it
        arms = arms * [1.0, 1.0, 0.0, 1.0, 0.0]
        angles_rad = angles_rad * [1.0, 0.0]
    angles = np.ascontiguousarray(angles_rad)
    if part[3] == part[5] == 0.0:
        return geometry.beta_segment(arms, float(part[2]), float(part[4]), angles)
    ends = [geometry.forward(arms, np.tile(part[k : k + 2], (n, 1)), angles) for k in (2, 4)]
    return np.hstack(ends)


def obstacle_name(plane: FocalPlane, index: int) -> str:
    """The name of an obstacle by its index in `CollisionBodies.obstacles`, as in a sentence."""
    discs, cameras = len(plane.fiducials), len(plane.guide_cameras)
    fixed = len(fixed_obstacles(plane))
    if index < discs:
        return f"fiducial {index}"
    if index < discs + cameras:
        return f"guide camera {index - discs}"
    if index < fixed:
        return f"keep-out {index - discs - cameras}"
    owners = doubt_obstacles(plane, parts_of(plane, plane.collision_buffer_mm))[:, 6]
    row = int(owners[index - fixed])
    return f"positioner {plane.positioner_id[row]}, where it may be"
