"""Focal planes from an instrument alone: a hexagonal array with seeded, realistic units."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from fiberloom.errors import InputError
from fiberloom.instruments.arms import ALPHA_OFF, BETA_OFF, CENTRE, L_ALPHA
from fiberloom.instruments.focal_plane import FocalPlane
from fiberloom.instruments.model import (
    METROLOGY,
    MOST_POSITIONERS,
    Dots,
    Instrument,
    Layout,
    Modules,
    Scatter,
)
from fiberloom.instruments.outlines import KeepOut
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import deg_to_rad

SQRT_3_2 = math.sqrt(3.0) / 2.0
_OF_DOTS = 1
"""Stream of random numbers."""


@dataclass(frozen=True)
class Holes:
    """Holes of a hexagon, row by row from the bottom, each row from the left."""

    q: Ints
    """Steps along x."""
    r: Ints
    """Steps along the lattice direction at 60 deg."""
    rings: int

    def xy_mm(self, pitch_mm: float) -> Floats:
        """(n, 2) centres."""
        return pitch_mm * np.column_stack([self.q + 0.5 * self.r, SQRT_3_2 * self.r])

    def names(self) -> list[str]:
        """R+3C7: row 3 above the central one, seventh hole from the left."""
        first = -self.rings - np.minimum(self.r, 0)
        return [f"R{r:+d}C{c}" if r else f"R0C{c}" for r, c in zip(self.r, self.q - first + 1, strict=True)]


def hexagon(rings: int) -> Holes:
    """All holes within `rings` steps of the central one."""
    rows = [(q, r) for r in range(-rings, rings + 1) for q in range(-rings, rings + 1) if abs(q + r) <= rings]
    q, r = np.array(rows, dtype=np.int64).T
    return Holes(q, r, rings)


def generate(instrument: Instrument, seed: int, n_positioners: int | None = None) -> FocalPlane:
    """A focal plane of this instrument with units drawn from its scatter.

    `n_positioners` below the instrument's number takes the positioners nearest to the centre: the
    same units that the whole plane has there. Above it, the hexagon grows, and fiducials and guide
    cameras around the field move out with it. The same seed gives the same plane.
    """
    if n_positioners is not None and n_positioners > MOST_POSITIONERS:
        raise InputError(f"n_positioners = {n_positioners}: must be at most {MOST_POSITIONERS}")
    layout = _grown(instrument, n_positioners)
    keep_outs = instrument.bodies.keep_outs
    sites = _sites(layout, keep_outs)
    xy, free = sites.xy_mm, np.flatnonzero(~sites.fiducial)
    if len(free) < layout.n_positioners:
        raise InputError(
            f"{instrument.name}: layout.rings = {layout.rings} leaves {len(free)} holes "
            f"for n_positioners = {layout.n_positioners}"
        )
    full = _nearest(xy, free, layout.n_positioners)
    number = np.searchsorted(full, _nearest(xy, free, n_positioners or layout.n_positioners))
    units = _draw(instrument, xy[full], np.random.default_rng(seed))
    plane = FocalPlane(
        instrument=instrument,
        positioner_id=np.arange(1, len(full) + 1),
        hole=sites.name[full],
        arms=units[0],
        points=units[1],
        fiducials=_fiducials(instrument, layout, sites),
        guide_cameras=guide_camera_capsules(instrument, layout),
        offline=np.zeros(len(full), dtype=bool),
        offline_position_deg=np.tile(instrument.positioner.park_deg, (len(full), 1)),
        dots_mm=None if layout.dots is None else _draw_dots(layout.dots, xy[full], seed),
    )
    return plane.select(number)


def guide_camera_capsules(instrument: Instrument, layout: Layout) -> Floats:
    """(G, 5) mm: capsules along the edges of the guide cameras that face the field, x0, y0, x1, y1,
    radius.
    """
    cameras = layout.guide_cameras
    if cameras is None:
        return np.empty((0, 5))
    turn = 360.0 / max(cameras.number, 1)
    angle = deg_to_rad(cameras.first_direction_deg + turn * np.arange(cameras.number))
    out = np.column_stack([np.cos(angle), np.sin(angle)])
    along = cameras.half_width_mm * np.column_stack([-out[:, 1], out[:, 0]])
    edge = cameras.face_distance_mm * out
    radius = np.full((cameras.number, 1), instrument.bodies.guide_camera_radius_mm)
    return np.hstack([edge - along, edge + along, radius])


def _grown(instrument: Instrument, n_positioners: int | None) -> Layout:
    """The layout with as many rings as the positioners need, and all around it moved out."""
    layout, keep_outs = instrument.layout, instrument.bodies.keep_outs
    if n_positioners is None or n_positioners <= layout.n_positioners:
        if n_positioners is not None and n_positioners < 1:
            raise InputError(f"n_positioners = {n_positioners}: must be at least 1")
        return layout
    if layout.modules is not None:
        raise InputError(f"n_positioners = {n_positioners}: the modules have {layout.n_positioners}")
    wider = layout
    while np.count_nonzero(~_sites(wider, keep_outs).fiducial) < n_positioners:
        wider = _wider(wider)
    step = (wider.rings - layout.rings) * layout.pitch_mm
    update: dict[str, object] = {"n_positioners": n_positioners}
    if layout.outer_fiducial_radius_mm is not None:
        update["outer_fiducial_radius_mm"] = layout.outer_fiducial_radius_mm + step
    if (cameras := layout.guide_cameras) is not None:
        moved = {k: getattr(cameras, k) + step for k in ("face_distance_mm", "centre_distance_mm")}
        update["guide_cameras"] = cameras.model_copy(update=moved)
    return wider.model_copy(update=update)


def _wider(layout: Layout) -> Layout:
    """One more ring of holes."""
    update: dict[str, object] = {"rings": layout.rings + 1}
    if layout.field_radius_mm is not None:
        update["field_radius_mm"] = layout.field_radius_mm + layout.pitch_mm
    return layout.model_copy(update=update)


def module_sites(modules: Modules, pitch_mm: float) -> tuple[Floats, NDArray[np.str_]]:
    """(n, 2) mm centres of all positioners and their names, by field, module and place in the module.

    SC15P02: second positioner of the fifteenth module. The lattice of PFS: pfs_utils, grandfibermap.
    """
    field, module, place = np.indices((modules.fields, modules.per_field, modules.positioners)).reshape(3, -1)
    k, second_row = (part.astype(np.float64) for part in np.divmod(place, 2))
    x: Floats = -SQRT_3_2 * pitch_mm * (2.0 * module + 1.0 + second_row)
    y: Floats = pitch_mm * (module + 0.5 - k - 0.5 * second_row)
    number = modules.per_field * field + module + 1
    names = [f"SC{n:02d}P{p:02d}" for n, p in zip(number.tolist(), (place + 1).tolist(), strict=True)]
    turn: Floats = -2.0 * math.pi / modules.fields * field.astype(np.float64)
    return _turned(x, y, turn), np.array(names)


@dataclass(frozen=True)
class _Sites:
    """Holes of the whole field."""

    xy_mm: Floats
    name: NDArray[np.str_]
    fiducial: Flags
    """(n,) taken by a fiducial, not a positioner."""
    turn_rad: Floats
    """(n,) of the petal that the hole is in."""


def _sites(layout: Layout, keep_outs: tuple[KeepOut, ...] = ()) -> _Sites:
    """The holes inside the field, away from polygons among the keep-outs."""
    sites = _all_sites(layout)
    free = np.ones(len(sites.xy_mm), dtype=bool)
    for part in keep_outs if layout.keep_out_gap_mm else ():
        if part.polygon_mm:
            free &= part.distance_mm(sites.xy_mm) >= layout.keep_out_gap_mm
    return _Sites(sites.xy_mm[free], sites.name[free], sites.fiducial[free], sites.turn_rad[free])


def _all_sites(layout: Layout) -> _Sites:
    """The holes inside the field; with petals those of one wedge, about +x, turned round the field."""
    if layout.modules is not None:
        xy, names = module_sites(layout.modules, layout.pitch_mm)
        return _Sites(xy, names, np.zeros(len(xy), dtype=bool), np.zeros(len(xy)))
    holes = hexagon(layout.rings)
    xy, names, fiducial = holes.xy_mm(layout.pitch_mm), np.array(holes.names()), _is_fiducial(holes, layout)
    keep = np.ones(len(xy), dtype=bool)
    if layout.field_radius_mm is not None:
        keep &= np.hypot(*xy.T) <= layout.field_radius_mm
    if layout.petals == 1:
        return _Sites(xy[keep], names[keep], fiducial[keep], np.zeros(int(keep.sum())))
    half = math.pi / layout.petals
    to_edge = xy[:, 0] * math.sin(half) - np.abs(xy[:, 1]) * math.cos(half)
    keep &= to_edge >= max(0.5 * layout.petal_gap_mm, 1e-9)
    turns = 2.0 * half * np.arange(layout.petals)
    return _Sites(
        np.vstack([_turned(xy[keep, 0], xy[keep, 1], float(turn)) for turn in turns]),
        np.array([f"P{k}{name}" for k in range(layout.petals) for name in names[keep]]),
        np.tile(fiducial[keep], layout.petals),
        np.repeat(turns, int(keep.sum())),
    )


def _is_fiducial(holes: Holes, layout: Layout) -> Flags:
    """Holes on the sublattice spanned by (a, b) and its turn by 60 deg, (-b, a + b)."""
    if layout.fiducial_lattice is None:
        return np.zeros(len(holes.q), dtype=bool)
    a, b = layout.fiducial_lattice
    index = a * a + a * b + b * b
    first = (a + b) * holes.q + b * holes.r
    second = a * holes.r - b * holes.q
    fiducial: Flags = (first % index == 0) & (second % index == 0)
    return fiducial


def _nearest(xy: Floats, candidates: Ints, n: int) -> Ints:
    """The n candidates nearest to the centre, in the order of the holes."""
    # rounded, so that holes at equal distance stay in the order of their names on any machine
    distance = np.round(np.hypot(*xy[candidates].T), 6)
    return np.sort(candidates[np.argsort(distance, kind="stable")[:n]])


def _draw(instrument: Instrument, xy: Floats, rng: np.random.Generator) -> tuple[Floats, dict[str, Floats]]:
    """Arms and points of one unit per hole."""
    n, scatter = len(xy), instrument.scatter
    orientation = deg_to_rad(instrument.layout.orientation_deg)
    arms = np.empty((n, 5))
    arms[:, L_ALPHA] = _sample(scatter.l_alpha_mm, n, rng)
    arms[:, ALPHA_OFF] = orientation + deg_to_rad(_sample(scatter.alpha_offset_deg, n, rng))
    arms[:, BETA_OFF] = deg_to_rad(_sample(scatter.beta_offset_deg, n, rng))
    shift = _sample(scatter.base_x_mm, n, rng), _sample(scatter.base_y_mm, n, rng)
    arms[:, CENTRE] = xy + _turned(*shift, float(orientation))
    stretch = _sample(scatter.beta_length_mm, n, rng)
    return arms, {name: _draw_point(instrument, name, stretch, rng) for name in instrument.positioner.points}


def _draw_point(instrument: Instrument, name: str, stretch: Floats, rng: np.random.Generator) -> Floats:
    point, scatter, n = instrument.positioner.points[name], instrument.scatter, len(stretch)
    xy = np.column_stack([point.x_mm + stretch, np.full(n, point.y_mm)])
    if name != METROLOGY:
        xy[:, 0] += _sample(scatter.point_x_mm, n, rng)
        xy[:, 1] += _sample(scatter.point_y_mm, n, rng)
    xy[~spread(n, point.fraction)] = np.nan
    return xy


def _draw_dots(dots: Dots, xy: Floats, seed: int) -> Floats:
    """(n, 3): x, y, radius in mm, by numbers of their own: units are the same with and without them."""
    own = np.random.default_rng([seed, _OF_DOTS]).normal(0.0, dots.sd_mm, xy.shape)
    return np.column_stack([xy + np.array([dots.x_mm, dots.y_mm]) + own, np.full(len(xy), dots.radius_mm)])


def spread(n: int, fraction: float) -> Flags:
    """(n,) round(n fraction) times True, as evenly as whole numbers allow."""
    count = round(n * fraction)
    steps = np.arange(n + 1) * count // n
    return np.diff(steps) > 0


def _turned(x: Floats | float, y: Floats | float, angle_rad: Floats | float) -> Floats:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.column_stack([c * x - s * y, s * x + c * y])


def _sample(scatter: Scatter, n: int, rng: np.random.Generator) -> Floats:
    """Normal numbers cut at the bounds, by inverting the distribution: one draw per unit."""
    uniform = rng.random(n)
    if scatter.sd == 0.0:
        return np.full(n, scatter.mean)
    low, high = (ndtr((b - scatter.mean) / scatter.sd) for b in scatter.bounds)
    drawn: Floats = scatter.mean + scatter.sd * ndtri(low + uniform * (high - low))
    return drawn


def _beside_modules(modules: Modules | None) -> Floats:
    """(M, 2) mm: those of the first field, turned for the others."""
    if modules is None or not modules.fiducials_mm:
        return np.empty((0, 2))
    x, y = np.array(modules.fiducials_mm).T
    turns = -2.0 * math.pi / modules.fields * np.arange(modules.fields)
    return np.vstack([_turned(x, y, float(turn)) for turn in turns])


def _fiducials(instrument: Instrument, layout: Layout, sites: _Sites) -> Floats:
    """(M, 3): a row for every light, with the radius of the body round it."""
    inner, turn = sites.xy_mm[sites.fiducial], sites.turn_rad[sites.fiducial]
    lights = [inner + _turned(x, y, turn) for x, y in layout.fiducial_pinholes_mm]
    angle = deg_to_rad(np.array(layout.outer_fiducial_directions_deg, dtype=np.float64))
    radius = layout.outer_fiducial_radius_mm or 0.0
    outer = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    xy = np.vstack([np.stack(lights, axis=1).reshape(-1, 2), outer, _beside_modules(layout.modules)])
    return np.column_stack([xy, np.full(len(xy), instrument.bodies.fiducial_radius_mm)])
