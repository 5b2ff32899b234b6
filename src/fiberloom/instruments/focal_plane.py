"""A focal plane: every positioner with its own geometry, and everything that it can hit.

Angles in deg, lengths in mm, in the frames of docs/conventions.md. All calls take and return
arrays over positioners; `index` selects some of them (all when left out).
"""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from fiberloom._core import geometry
from fiberloom.errors import InputError
from fiberloom.instruments.model import METROLOGY, Instrument
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import RAD_PER_DEG, deg_to_rad, rad_to_deg

CENTRE = slice(0, 2)
L_ALPHA, ALPHA_OFF, BETA_OFF = 2, 3, 4
"""Columns of FocalPlane.arms."""


def elbows_mm(arms: Floats, alpha_deg: ArrayLike) -> Floats:
    """(n, 2, ...) mm: the beta axes of arms (n, 5) at alpha (n, ...) deg."""
    alpha = deg_to_rad(alpha_deg)
    more = (None,) * (alpha.ndim - 1)
    turn = alpha + arms[(slice(None), ALPHA_OFF, *more)]
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return arms[(slice(None), CENTRE, *more)] + arms[(slice(None), L_ALPHA, None, *more)] * along


class Inverse(NamedTuple):
    """Arm angles that put a fibre on its target."""

    alpha_deg: Floats
    beta_deg: Floats
    reachable: Flags
    gap_mm: Floats
    """How far the target lies outside the reach of the arms; 0 with reachable = False: only the
    axis limits prevent it; inf: the positioner lacks the fibre."""


@dataclass(frozen=True, eq=False)
class FocalPlane:
    """N positioners, M fiducials, G guide cameras. Read-only."""

    instrument: Instrument
    positioner_id: Ints
    """(N,) number on the bus, unique."""
    hole: NDArray[np.str_]
    """(N,) name of the hole."""
    arms: Floats
    """(N, 5): centre_x_mm, centre_y_mm, l_alpha_mm, alpha_off_rad, beta_off_rad."""
    points: dict[str, Floats]
    """(N, 2) mm in the frame of the beta arm, by fibre; NaN where a positioner lacks it."""
    fiducials: Floats
    """(M, 3): x_mm, y_mm, radius_mm."""
    guide_cameras: Floats
    """(G, 5): x0_mm, y0_mm, x1_mm, y1_mm, radius_mm (capsules)."""
    offline: Flags
    """(N,) does not move."""
    offline_position_deg: Floats
    """(N, 2) its alpha and beta if it does not move."""

    def __post_init__(self) -> None:
        n = len(self.positioner_id)
        if len(np.unique(self.positioner_id)) != n:
            raise InputError("focal plane: positioner_id must be unique")
        shapes = {"hole": (n,), "arms": (n, 5), "offline": (n,), "offline_position_deg": (n, 2)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise InputError(
                    f"focal plane: {name} has shape {getattr(self, name).shape}, {n} positioners need {shape}"
                )
        if METROLOGY not in self.points:
            self.points[METROLOGY] = self.points[self.instrument.seen_point]

    def __len__(self) -> int:
        return len(self.positioner_id)

    @property
    def n(self) -> int:
        """Number of positioners."""
        return len(self.positioner_id)

    @property
    def centres_mm(self) -> Floats:
        """(N, 2) alpha axes."""
        return self.arms[:, CENTRE]

    @property
    def l_alpha_mm(self) -> Floats:
        """(N,) from the alpha to the beta axis."""
        return self.arms[:, L_ALPHA]

    @property
    def l_beta_mm(self) -> Floats:
        """(N,) from the beta axis to the metrology fibre."""
        return np.hypot(*self.points[METROLOGY].T)

    @property
    def metrology_phi_rad(self) -> Floats:
        """(N,) direction of the metrology fibre in the frame of its beta arm."""
        return np.arctan2(self.points[METROLOGY][:, 1], self.points[METROLOGY][:, 0])

    @property
    def alpha_off_rad(self) -> Floats:
        """(N,) direction in the focal plane of alpha = 0."""
        return self.arms[:, ALPHA_OFF]

    @property
    def beta_off_rad(self) -> Floats:
        """(N,) direction of beta = 0 against the alpha arm."""
        return self.arms[:, BETA_OFF]

    @property
    def collision_buffer_mm(self) -> float:
        """Radius of the beta arm's capsule."""
        return self.instrument.bodies.collision_buffer_mm

    @property
    def beta_segment_mm(self) -> tuple[float, float]:
        """Centre line of that capsule, from and to along the arm."""
        return self.instrument.bodies.beta_segment_mm

    @property
    def limits_deg(self) -> Floats:
        """[[alpha_min, alpha_max], [beta_min, beta_max]] for targets."""
        return np.array([axis.target_range_deg for axis in self.instrument.axes])

    @property
    def hard_stops_deg(self) -> Floats:
        """[[alpha_min, alpha_max], [beta_min, beta_max]] of the mechanism."""
        return np.array([axis.hard_stop_deg for axis in self.instrument.axes])

    @property
    def science_fibres(self) -> tuple[str, ...]:
        """Fibres that targets can ask for."""
        return self.instrument.science_fibres

    def carries(self, fibre: str) -> Flags:
        """(N,) which positioners have this fibre."""
        return ~np.isnan(self._point(fibre)[:, 0])

    def forward(
        self,
        alpha_deg: ArrayLike,
        beta_deg: ArrayLike,
        fibre: str = METROLOGY,
        index: ArrayLike | None = None,
    ) -> Floats:
        """(n, 2) mm: position of a fibre. Kronig 2020, Eq. 1. NaN where a positioner lacks it.

        `alpha_deg`, `beta_deg`: one for all or (n,); `fibre`: a name in `points`; `index`: rows, all
        when left out.
        """
        rows = self._rows(index)
        angles = _columns(deg_to_rad(alpha_deg), deg_to_rad(beta_deg), len(rows))
        return geometry.forward(self.arms[rows], self._point(fibre)[rows], angles)

    def jacobian(
        self,
        alpha_deg: ArrayLike,
        beta_deg: ArrayLike,
        fibre: str = METROLOGY,
        index: ArrayLike | None = None,
    ) -> Floats:
        """(n, 2, 2) mm/deg: d(x, y)/d(alpha, beta) of a fibre.

        `alpha_deg`, `beta_deg`: one for all or (n,); `fibre`: a name in `points`; `index`: rows, all
        when left out.
        """
        rows = self._rows(index)
        angles = _columns(deg_to_rad(alpha_deg), deg_to_rad(beta_deg), len(rows))
        per_rad = geometry.jacobian(self.arms[rows], self._point(fibre)[rows], angles)
        return per_rad * RAD_PER_DEG

    def inverse(self, xy_mm: ArrayLike, fibre: str = METROLOGY, index: ArrayLike | None = None) -> Inverse:
        """Angles inside the limits that put a fibre on (n, 2) targets. Kronig 2020, Eq. 2.

        The right-handed elbow (beta in [0, 180]) first, then the lowest alpha; 0 where none.
        """
        rows = self._rows(index)
        xy = np.broadcast_to(np.asarray(xy_mm, dtype=np.float64), (len(rows), 2))
        has = self.carries(fibre)[rows] & np.isfinite(xy).all(axis=1)
        angles, reachable = np.zeros((len(rows), 2)), np.zeros(len(rows), dtype=bool)
        gap = np.where(has, 0.0, np.inf)
        found, count, gap[has] = geometry.inverse(
            self.arms[rows[has]],
            self._point(fibre)[rows[has]],
            np.ascontiguousarray(xy[has]),
            deg_to_rad(self.limits_deg),
        )
        reachable[has] = count > 0
        angles[has] = np.where(count[:, None] > 0, found[:, 0], 0.0)
        alpha, beta = np.clip(rad_to_deg(angles), *self.limits_deg.T).T
        alpha, beta = np.where(reachable, alpha, 0.0), np.where(reachable, beta, 0.0)
        return Inverse(alpha, beta, reachable, gap)

    def elbows_mm(self, alpha_deg: ArrayLike, index: ArrayLike | None = None) -> Floats:
        """(n, 2) mm: where the beta axes are at these angles, (n,) or one for all."""
        rows = self._rows(index)
        return elbows_mm(self.arms[rows], np.broadcast_to(alpha_deg, len(rows)))

    def beta_segments(
        self, alpha_deg: ArrayLike, beta_deg: ArrayLike, index: ArrayLike | None = None
    ) -> Floats:
        """(n, 4) mm: x0, y0, x1, y1 of the centre lines of the beta arms' capsules."""
        rows = self._rows(index)
        angles = _columns(deg_to_rad(alpha_deg), deg_to_rad(beta_deg), len(rows))
        ends = [np.broadcast_to([x, 0.0], (len(rows), 2)).copy() for x in self.beta_segment_mm]
        return np.hstack([geometry.forward(self.arms[rows], e, angles) for e in ends])

    @cached_property
    def body_reach_mm(self) -> Floats:
        """(N,) how far from its centre the arm of each positioner can touch something."""
        arm = max(map(abs, self.beta_segment_mm)) + self.collision_buffer_mm
        return self.l_alpha_mm + arm

    def neighbour_pairs(self, extra_mm: float = 0.0) -> Ints:
        """(P, 2) indices i < j, in order, of positioners whose arms can come within `extra_mm`."""
        reach = self.body_reach_mm
        tree = cKDTree(self.centres_mm)
        pairs = tree.query_pairs(2 * reach.max(initial=0.0) + extra_mm, output_type="ndarray")
        i, j = pairs[:, 0], pairs[:, 1]
        gap = np.linalg.norm(self.centres_mm[i] - self.centres_mm[j], axis=1)
        near = pairs[gap < reach[i] + reach[j] + extra_mm].astype(np.int64)
        return near[np.lexsort((near[:, 1], near[:, 0]))]

    def index_of(self, positioner_id: ArrayLike) -> Ints:
        """Rows of these positioners (an array for an array, one number for one)."""
        wanted = np.asarray(positioner_id, dtype=np.int64)
        if self.n == 0:
            raise InputError(f"positioner {wanted.flat[0]}: the focal plane is empty")
        order = np.argsort(self.positioner_id)
        place = np.searchsorted(self.positioner_id, wanted, sorter=order).clip(max=self.n - 1)
        rows = order[place]
        wrong = self.positioner_id[rows] != wanted
        if np.any(wrong):
            raise InputError(
                f"positioner {np.atleast_1d(wanted)[np.atleast_1d(wrong)][0]}: not in "
                f"this focal plane of {self.n} positioners"
            )
        return rows

    def select(self, index: ArrayLike) -> "FocalPlane":
        """The same plane with only some positioners; fiducials and cameras stay."""
        rows = self._rows(index)
        return replace(
            self,
            points={name: xy[rows] for name, xy in self.points.items()},
            **{k: getattr(self, k)[rows] for k in _PER_POSITIONER},
        )

    def with_offline(
        self, positioner_id: Iterable[int], position_deg: ArrayLike | None = None
    ) -> "FocalPlane":
        """The same plane with these positioners standing still, where told or folded."""
        rows = self.index_of(np.fromiter(positioner_id, dtype=np.int64))
        offline, position = self.offline.copy(), self.offline_position_deg.copy()
        offline[rows] = True
        if position_deg is not None:
            position[rows] = position_deg
        return replace(self, offline=offline, offline_position_deg=position)

    def with_collision_buffer(self, collision_buffer_mm: float) -> "FocalPlane":
        """The same plane with another radius of the beta arms' capsules."""
        bodies = self.instrument.bodies.model_copy(update={"collision_buffer_mm": collision_buffer_mm})
        return replace(self, instrument=self.instrument.model_copy(update={"bodies": bodies}))

    def config_hash(self) -> str:
        """16 hex digits that change with any number of the instrument or the layout."""
        digest = hashlib.sha256(self.instrument.model_dump_json().encode())
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                _feed(digest, field.name, value)
        for name in sorted(self.points):
            _feed(digest, name, self.points[name])
        return digest.hexdigest()[:16]

    def _point(self, fibre: str) -> Floats:
        try:
            return self.points[fibre]
        except KeyError:
            raise InputError(
                f"fibre '{fibre}': {self.instrument.name} has {', '.join(self.points)}"
            ) from None

    def _rows(self, index: ArrayLike | None) -> Ints:
        if index is None:
            return np.arange(self.n)
        rows = np.atleast_1d(np.asarray(index))
        return np.flatnonzero(rows) if rows.dtype == bool else rows.astype(np.int64)


_PER_POSITIONER = ("positioner_id", "hole", "arms", "offline", "offline_position_deg")


def _columns(first: Floats, second: Floats, n: int) -> Floats:
    pair = np.empty((n, 2))
    pair[:, 0], pair[:, 1] = first, second
    return pair


def _feed(digest: "hashlib._Hash", name: str, values: NDArray) -> None:
    # rounded to 1e-9 so that deg in a file and back is the same; adding 0.0 makes -0.0 to 0.0
    plain = np.ascontiguousarray(values.round(9) + 0.0 if values.dtype.kind == "f" else values)
    digest.update(name.encode())
    if plain.dtype.kind == "U":
        digest.update("\0".join(plain).encode())
    else:
        digest.update(plain.astype(plain.dtype.newbyteorder("<")).tobytes())
