"""A focal plane: every positioner with its own geometry, and everything that it can hit."""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiberloom._core import geometry
from fiberloom.errors import InputError
from fiberloom.instruments.arms import (
    Inverse,
    Solutions,
    arm_rows,
    columns_of,
    elbows_mm,
    pairs_within,
    rows_given,
    rows_of,
)
from fiberloom.instruments.axis import Ranges
from fiberloom.instruments.handicaps import Handicaps
from fiberloom.instruments.model import METROLOGY, Instrument
from fiberloom.instruments.views import Views, mark_of, marked_text
from fiberloom.richtext import html_rows
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import RAD_PER_DEG, deg_to_rad, rad_to_deg


@dataclass(frozen=True, eq=False)
class FocalPlane(Views):
    """N positioners, each with its own geometry, M fiducials and G guide cameras. Read-only.

    All calls take and return arrays over positioners; frames and signs: docs/conventions.md.

    Raises
    ------
    InputError
        A positioner_id that appears twice, or an array of another length.

    Examples
    --------
    >>> import fiberloom as fl
    >>> plane = fl.FocalPlane.of("sdssv", seed=0, n=50)
    >>> plane
    FocalPlane('sdssv', 50 positioners, 61 fiducials, 6 guide cameras)
    """

    instrument: Instrument
    """What all positioners have in common."""
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
    handicaps: Handicaps | None = None
    """Of units that are not known exactly, cold or worn; None: there are none."""
    ranges: Ranges | None = None
    """Of units whose axes turn otherwise than the nominal one's; None: all are as the instrument says."""
    dots_mm: Floats | None = None
    """(N, 3) x, y, radius of the opaque spot beside each; None: there are none."""

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
        if self.ranges is not None and len(self.ranges.stops_deg) != n:
            raise InputError(f"focal plane: ranges of {len(self.ranges.stops_deg)} for {n} positioners")
        if self.dots_mm is not None and self.dots_mm.shape != (n, 3):
            raise InputError(f"focal plane: dots_mm has shape {self.dots_mm.shape}, not ({n}, 3)")
        if METROLOGY not in self.points:
            self.points[METROLOGY] = self.points[self.instrument.seen_point]

    @classmethod
    def of(cls, name_or_toml: str | Path, seed: int = 0, n: int | None = None) -> "FocalPlane":
        """A focal plane of an instrument, with units drawn from its scatter.

        Parameters
        ----------
        name_or_toml : str or Path
            A preset (`fiberloom instruments` lists them), or a TOML file of your own.
        seed : int
            The same seed gives the same units.
        n : int, optional
            Only so many positioners, from the centre; all when left out. With more the hexagon grows.

        Returns
        -------
        FocalPlane
            In the order of the holes.

        Raises
        ------
        InputError
            Neither a preset nor a file, a file that does not hold an instrument, or n below 1.

        Examples
        --------
        >>> import fiberloom as fl
        >>> len(fl.FocalPlane.of("pfs", n=19))
        19
        """
        from fiberloom import instruments  # built on this class

        return instruments.generate(instruments.load_instrument(name_or_toml), seed, n)

    @classmethod
    def read(cls, folder: str | Path, instrument: str | Path = "sdssv") -> "FocalPlane":
        """The focal plane as built, from a folder of tables.

        Parameters
        ----------
        folder : str or Path
            A layout that fiberloom wrote (layout.toml), or calibration tables of SDSS-V.
        instrument : str or Path
            The preset or TOML file that the layout belongs to.

        Returns
        -------
        FocalPlane
            As in the tables: arms in mm, offsets in deg.

        Raises
        ------
        InputError
            No such folder, neither kind of layout in it, or a table that cannot be read.

        Examples
        --------
        >>> import fiberloom as fl
        >>> from fiberloom.instruments import write_layout
        >>> write_layout(fl.FocalPlane.of("sdssv", n=7), "layout")
        >>> fl.FocalPlane.read("layout")
        FocalPlane('sdssv', 7 positioners, 61 fiducials, 6 guide cameras)
        """
        from fiberloom import instruments  # built on this class

        return instruments.read_layout(folder, instruments.load_instrument(instrument))

    def __len__(self) -> int:
        return len(self.positioner_id)

    def __repr__(self) -> str:
        still = f", {int(self.offline.sum())} offline" if self.offline.any() else ""
        return (
            f"FocalPlane({self.instrument.name!r}, {self.n} positioners{still}, "
            f"{len(self.fiducials)} fiducials, {len(self.guide_cameras)} guide cameras)"
        )

    def _repr_html_(self) -> str:
        return html_rows(repr(self), arm_rows(self.positioner_id, self.hole, self.arms))

    def carries(self, fibre: str) -> Flags:
        """Which positioners have a fibre.

        Parameters
        ----------
        fibre : str
            By its name in the instrument, e.g. ``"BOSS"``; ``"metrology"`` is the one the camera sees.

        Returns
        -------
        (N,) bool

        Raises
        ------
        InputError
            The instrument has no such fibre.

        Examples
        --------
        >>> import fiberloom as fl
        >>> int(fl.FocalPlane.of("sdssv").carries("APOGEE").sum())
        300
        """
        return ~np.isnan(self._point(fibre)[:, 0])

    def forward(
        self,
        alpha_deg: ArrayLike,
        beta_deg: ArrayLike,
        fibre: str = METROLOGY,
        index: ArrayLike | None = None,
    ) -> Floats:
        """Where a fibre is. Kronig 2020, Eq. 1.

        Parameters
        ----------
        alpha_deg, beta_deg : array_like
            Arm angles, one for each positioner or one for all.
        fibre : str
            By its name in the instrument.
        index : array_like, optional
            Rows or a mask; all positioners when left out.

        Returns
        -------
        (n, 2) float
            x and y in the focal plane, mm; NaN where a positioner lacks the fibre.

        Raises
        ------
        InputError
            The instrument has no such fibre.

        Examples
        --------
        >>> import fiberloom as fl
        >>> plane = fl.FocalPlane.of("sdssv", n=7)
        >>> reach = plane.forward(0.0, 0.0) - plane.centres_mm
        >>> bool((abs((reach**2).sum(axis=1) ** 0.5 - 21.7) < 0.1).all())
        True
        """
        return geometry.forward(*self._posed(alpha_deg, beta_deg, fibre, index))

    def jacobian(
        self,
        alpha_deg: ArrayLike,
        beta_deg: ArrayLike,
        fibre: str = METROLOGY,
        index: ArrayLike | None = None,
    ) -> Floats:
        """How a fibre moves with the arm angles.

        Parameters
        ----------
        alpha_deg, beta_deg : array_like
            Arm angles, one for each positioner or one for all.
        fibre : str
            By its name in the instrument.
        index : array_like, optional
            Rows or a mask; all positioners when left out.

        Returns
        -------
        (n, 2, 2) float
            d(x, y)/d(alpha, beta), mm/deg; NaN where a positioner lacks the fibre.

        Raises
        ------
        InputError
            The instrument has no such fibre.

        Examples
        --------
        >>> import fiberloom as fl
        >>> fl.FocalPlane.of("sdssv", n=7).jacobian(10.0, 90.0).shape
        (7, 2, 2)
        """
        return geometry.jacobian(*self._posed(alpha_deg, beta_deg, fibre, index)) * RAD_PER_DEG

    def inverse(
        self,
        xy_mm: ArrayLike,
        fibre: str = METROLOGY,
        index: ArrayLike | None = None,
        near_deg: ArrayLike | None = None,
    ) -> Inverse:
        """Angles inside the limits that put a fibre on its target. Kronig 2020, Eq. 2.

        Parameters
        ----------
        xy_mm : array_like
            (n, 2) targets, or one for all.
        fibre : str
            By its name in the instrument.
        index : array_like, optional
            Rows or a mask; all positioners when left out.
        near_deg : array_like, optional
            (n, 2) alpha and beta: of several solutions the one nearest to these is wanted.

        Returns
        -------
        Inverse
            alpha_deg, beta_deg (0 where out of reach), reachable, gap_mm. Without `near_deg`, of several
            solutions the one with beta in [0, 180] comes first, then the lowest alpha.

        Raises
        ------
        InputError
            The instrument has no such fibre.

        Examples
        --------
        >>> import numpy as np
        >>> import fiberloom as fl
        >>> plane = fl.FocalPlane.of("sdssv", n=7)
        >>> found = plane.inverse(plane.forward(20.0, 100.0))
        >>> bool(np.allclose(found.alpha_deg, 20.0)), bool(np.allclose(found.beta_deg, 100.0))
        (True, True)
        """
        return self.solutions(xy_mm, fibre, index).one(near_deg)

    def solutions(
        self, xy_mm: ArrayLike, fibre: str = METROLOGY, index: ArrayLike | None = None
    ) -> Solutions:
        """All angles inside the limits of each positioner, both elbows and turns of alpha; else as `inverse`.

        Parameters
        ----------
        xy_mm : array_like
            (n, 2) targets, or one for all.
        fibre : str
            By its name in the instrument.
        index : array_like, optional
            Rows or a mask; all positioners when left out.

        Returns
        -------
        Solutions
            angles_deg (n, 4, 2), number (n,) of them that hold, gap_mm.

        Raises
        ------
        InputError
            The instrument has no such fibre.

        Examples
        --------
        >>> import fiberloom as fl
        >>> plane = fl.FocalPlane.of("moons", n=7)
        >>> plane.solutions(plane.forward(60.0, 100.0)).number.tolist()
        [2, 2, 2, 2, 2, 2, 2]
        """
        rows = rows_given(self.n, index)
        xy = np.broadcast_to(np.asarray(xy_mm, dtype=np.float64), (len(rows), 2))
        has = self.carries(fibre)[rows] & np.isfinite(xy).all(axis=1)
        limits = self.limits_of(rows[has])
        angles = np.zeros((len(rows), geometry.MAX_SOLUTIONS, 2))
        count, gap = np.zeros(len(rows), dtype=np.int64), np.where(has, 0.0, np.inf)
        point, target = self._point(fibre)[rows[has]], np.ascontiguousarray(xy[has])
        found, count[has], gap[has] = geometry.inverse_each(
            self.arms[rows[has]], point, target, np.ascontiguousarray(deg_to_rad(limits))
        )
        angles[has] = np.clip(rad_to_deg(found), limits[:, None, :, 0], limits[:, None, :, 1])
        return Solutions(angles, count, gap)

    def elbows_mm(self, alpha_deg: ArrayLike, index: ArrayLike | None = None) -> Floats:
        """Where the beta axes are.

        Parameters
        ----------
        alpha_deg : array_like
            One for each positioner or one for all.
        index : array_like, optional
            Rows or a mask; all positioners when left out.

        Returns
        -------
        (n, 2) float
            mm.

        Examples
        --------
        >>> import fiberloom as fl
        >>> fl.FocalPlane.of("sdssv", n=7).elbows_mm(90.0).shape
        (7, 2)
        """
        rows = rows_given(self.n, index)
        return elbows_mm(self.arms[rows], np.broadcast_to(alpha_deg, len(rows)))

    def beta_segments(
        self, alpha_deg: ArrayLike, beta_deg: ArrayLike, index: ArrayLike | None = None
    ) -> Floats:
        """Centre lines of the beta arms' capsules: what collides.

        Parameters
        ----------
        alpha_deg, beta_deg : array_like
            Arm angles, one for each positioner or one for all.
        index : array_like, optional
            Rows or a mask; all positioners when left out.

        Returns
        -------
        (n, 4) float
            x0, y0, x1, y1 in mm; the radius is `collision_buffer_mm`.

        Examples
        --------
        >>> import fiberloom as fl
        >>> fl.FocalPlane.of("sdssv", n=7).beta_segments(0.0, 180.0).shape
        (7, 4)
        """
        rows = rows_given(self.n, index)
        angles = columns_of(deg_to_rad(alpha_deg), deg_to_rad(beta_deg), len(rows))
        ends = [np.broadcast_to([x, 0.0], (len(rows), 2)).copy() for x in self.beta_segment_mm]
        return np.hstack([geometry.forward(self.arms[rows], e, angles) for e in ends])

    @cached_property
    def body_reach_mm(self) -> Floats:
        """(N,) how far from its centre the arm of each positioner can touch something."""
        beta, alpha = (self.instrument.bodies.reach_mm(arm) for arm in ("beta", "alpha"))
        return np.maximum(self.l_alpha_mm + beta, alpha) + (self.handicaps or Handicaps.none(self.n)).wider_mm

    def neighbour_pairs(self, extra_mm: float = 0.0) -> Ints:
        """Positioners whose arms can meet.

        Parameters
        ----------
        extra_mm : float
            Count those too that can come so near, mm.

        Returns
        -------
        (P, 2) int
            Rows i < j, in order.

        Examples
        --------
        >>> import fiberloom as fl
        >>> fl.FocalPlane.of("sdssv", n=3).neighbour_pairs().tolist()
        [[0, 1], [0, 2], [1, 2]]
        """
        return pairs_within(self.centres_mm, self.body_reach_mm, extra_mm)

    def index_of(self, positioner_id: ArrayLike) -> Ints:
        """Rows of positioners by their number on the bus.

        Parameters
        ----------
        positioner_id : array_like
            Numbers, or one.

        Returns
        -------
        int
            An array for an array, one number for one.

        Raises
        ------
        InputError
            A number that is not in this focal plane.

        Examples
        --------
        >>> import fiberloom as fl
        >>> plane = fl.FocalPlane.of("sdssv", n=7)
        >>> int(plane.index_of(plane.positioner_id[3]))
        3
        """
        return rows_of(self.positioner_id, positioner_id)

    def select(self, index: ArrayLike) -> "FocalPlane":
        """The same plane with only some positioners; fiducials and cameras stay.

        Parameters
        ----------
        index : array_like
            Rows, in the order that is wanted, or a mask.

        Returns
        -------
        FocalPlane

        Examples
        --------
        >>> import fiberloom as fl
        >>> len(fl.FocalPlane.of("sdssv", n=7).select([0, 3]))
        2
        """
        rows = rows_given(self.n, index)
        return replace(
            self,
            points={name: xy[rows] for name, xy in self.points.items()},
            handicaps=self.handicaps and self.handicaps.select(rows),
            ranges=self.ranges and self.ranges.select(rows),
            dots_mm=None if self.dots_mm is None else self.dots_mm[rows],
            **{k: getattr(self, k)[rows] for k in _PER_POSITIONER},
        )

    def with_offline(
        self, positioner_id: Iterable[int], position_deg: ArrayLike | None = None
    ) -> "FocalPlane":
        """The same plane with positioners that do not move.

        Parameters
        ----------
        positioner_id : iterable of int
            Their numbers on the bus.
        position_deg : array_like, optional
            (k, 2) where they are, alpha and beta; folded when left out.

        Returns
        -------
        FocalPlane

        Raises
        ------
        InputError
            A number that is not in this focal plane.

        Examples
        --------
        >>> import fiberloom as fl
        >>> plane = fl.FocalPlane.of("sdssv", n=7)
        >>> plane.with_offline(plane.positioner_id[:2], [[0.0, 180.0], [90.0, 170.0]])
        FocalPlane('sdssv', 7 positioners, 2 offline, 61 fiducials, 6 guide cameras)
        """
        rows = self.index_of(np.fromiter(positioner_id, dtype=np.int64))
        offline, position = self.offline.copy(), self.offline_position_deg.copy()
        offline[rows] = True
        if position_deg is not None:
            position[rows] = position_deg
        return replace(self, offline=offline, offline_position_deg=position)

    def with_collision_buffer(self, collision_buffer_mm: float) -> "FocalPlane":
        """The same plane with another radius of the beta arms' capsules.

        Parameters
        ----------
        collision_buffer_mm : float
            The radius, mm.

        Returns
        -------
        FocalPlane

        Examples
        --------
        >>> import fiberloom as fl
        >>> fl.FocalPlane.of("sdssv", n=7).with_collision_buffer(2.5).collision_buffer_mm
        2.5
        """
        bodies = self.instrument.bodies.model_copy(update={"collision_buffer_mm": collision_buffer_mm})
        return replace(self, instrument=self.instrument.model_copy(update={"bodies": bodies}))

    def config_hash(self) -> str:
        """A mark of the instrument and the layout, for result files and caches.

        Returns
        -------
        str
            16 hex digits that change with any number of either; but `care`, `expansion`, `drive` and `sky`
            make no other array of it.

        Examples
        --------
        >>> import fiberloom as fl
        >>> len(fl.FocalPlane.of("sdssv", n=7).config_hash())
        16
        """
        arrays = [(f.name, getattr(self, f.name)) for f in fields(self)] + sorted(self.points.items())
        arrays += self.handicaps.arrays.items() if self.handicaps else []
        arrays += self.ranges.arrays.items() if self.ranges else []
        return mark_of(marked_text(self.instrument), arrays)

    def _posed(
        self, alpha_deg: ArrayLike, beta_deg: ArrayLike, fibre: str, index: ArrayLike | None
    ) -> tuple[Floats, Floats, Floats]:
        rows = rows_given(self.n, index)
        angles = columns_of(deg_to_rad(alpha_deg), deg_to_rad(beta_deg), len(rows))
        return self.arms[rows], self._point(fibre)[rows], angles

    def _point(self, fibre: str) -> Floats:
        if fibre not in self.points:
            raise InputError(f"fibre '{fibre}': {self.instrument.name} has {', '.join(self.points)}")
        return self.points[fibre]


_PER_POSITIONER = ("positioner_id", "hole", "arms", "offline", "offline_position_deg")
