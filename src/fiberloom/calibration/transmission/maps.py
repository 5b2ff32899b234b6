"""Transmission maps: which motor position puts an arm at an angle. Kronig 2020, Eq. 6 and 7.

Per positioner, axis and direction of contact a map is a polyline through knots (output angle, wire
position), both in deg and rising. The wire position is the motor angle over the nominal gear n_bar;
with T the motor angle that belongs to the output angle theta:

    wire = T(theta) / n_bar,   delta(theta) = wire - theta,   B = n_bar (delta+ - delta-)

Exact at the knots; the inverse is that of the same polyline; straight on beyond the ends.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.errors import InputError, one_line
from fiberloom.files import check_zip, parse_json, shown
from fiberloom.instruments.model import AXES
from fiberloom.typing import Array, Floats, Ints
from fiberloom.units import GEAR
from fiberloom.version import __version__
from fiberloom.wholefile import whole

NEGATIVE, POSITIVE = -1, 1
"""Directions of contact: the side from which the last move came."""

CONTACTS = ("negative", "positive")

MOST_DEG = 3600.0
"""No axis turns farther, either way."""
MOST_GEAR = 1e6

FORMAT = "fiberloom transmission maps"
FORMAT_VERSION = 1


@dataclass(frozen=True)
class Provenance:
    """Where maps come from."""

    config_hash: str = ""
    seed: int | None = None
    gear: float = GEAR
    version: str = __version__
    utc: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    note: str = ""

    def check(self) -> None:
        """Raises InputError for what a file may hold and no calibration writes: a gear that is none, ..."""
        if not (type(self.gear) in (int, float) and 0.0 < self.gear <= MOST_GEAR):
            raise InputError(f"gear = {shown(self.gear)}: must be a ratio above 0")
        if not (self.seed is None or type(self.seed) is int):
            raise InputError(f"seed = {shown(self.seed)}: must be a whole number")
        for name in ("config_hash", "version", "utc", "note"):
            if not isinstance(getattr(self, name), str):
                raise InputError(f"{name} = {shown(getattr(self, name))}: must be a text")


@dataclass(frozen=True, eq=False)
class TransmissionMaps:
    """Which motor position puts an arm at an angle, for N positioners. Kronig 2020, Eq. 6 and 7.

    Made by `Field.calibrate`. Per positioner, axis and direction of contact a map is a polyline through
    knots (output angle, wire position), both in deg and rising; the wire position is the motor angle over
    the nominal gear. Read-only.

    Raises
    ------
    InputError
        Arrays of another shape, or knots that do not rise: positioner, axis and contact are named.

    Examples
    --------
    >>> import fiberloom as fl
    >>> maps = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7)).run.calibrate()
    >>> maps
    TransmissionMaps(7 positioners, 200 knots, gear 1024)
    >>> bool((abs(maps.to_output(maps.to_wire(90.0)) - 90.0) < 1e-9).all())
    True
    """

    positioner_id: Ints
    """(N,) number on the bus; the order of the rows."""
    wire_deg: Floats
    """(N, 2 axes, 2 directions, K knots); direction 0 is negative contact."""
    output_deg: Floats
    """(N, 2 axes, 2 directions, K knots)."""
    provenance: Provenance = field(default_factory=Provenance)
    """Where the maps come from."""

    def __post_init__(self) -> None:
        n = len(self.positioner_id)
        for name, knots in (("wire_deg", self.wire_deg), ("output_deg", self.output_deg)):
            if knots.ndim != 4 or knots.shape[:3] != (n, 2, 2) or knots.shape[3] < 2:
                raise InputError(
                    f"transmission maps: {name} has the shape {knots.shape}, "
                    f"{n} positioners need ({n}, 2, 2, at least 2)"
                )
            self._refuse_unless_rising(name, knots)
            self._refuse_unless_angles(name, knots)
        if self.wire_deg.shape != self.output_deg.shape:
            raise InputError("transmission maps: wire_deg and output_deg differ in shape")

    def _refuse_unless_angles(self, name: str, knots: Floats) -> None:
        bad = np.argwhere(~(np.abs(knots) <= MOST_DEG))
        if len(bad):
            row, axis, side, k = bad[0]
            raise InputError(
                f"transmission map of positioner {self.positioner_id[row]}, {AXES[axis]}, "
                f"{CONTACTS[side]} contact: {name} of knot {k} is {knots[row, axis, side, k]:g} deg; "
                f"within {MOST_DEG:g} deg either way is wanted; calibrate this positioner again"
            )

    def _refuse_unless_rising(self, name: str, knots: Floats) -> None:
        # NaN compares False, so it is caught here too
        bad = np.argwhere(~(np.diff(knots, axis=-1) > 0.0))
        if len(bad) == 0:
            return
        row, axis, side, k = bad[0]
        pair = knots[row, axis, side, k : k + 2]
        raise InputError(
            f"transmission map of positioner {self.positioner_id[row]}, {AXES[axis]}, "
            f"{CONTACTS[side]} contact: {name} does not rise from knot {k} to "
            f"{k + 1} ({pair[0]:.6f} to {pair[1]:.6f} deg); calibrate this positioner again"
        )

    def __len__(self) -> int:
        return len(self.positioner_id)

    def __repr__(self) -> str:
        knots, gear = self.wire_deg.shape[-1], self.provenance.gear
        return f"TransmissionMaps({len(self)} positioners, {knots} knots, gear {gear:g})"

    @classmethod
    def read(cls, path: str | Path) -> TransmissionMaps:
        """The maps of a file that `save` wrote.

        Parameters
        ----------
        path : str or Path
            An .npz file, also that of `fiberloom calibrate transmission`.

        Returns
        -------
        TransmissionMaps

        Raises
        ------
        InputError
            No such file, or not a file of maps that this version reads.

        Examples
        --------
        >>> import fiberloom as fl
        >>> maps = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7)).run.calibrate()
        >>> maps.save("maps.npz")
        >>> fl.TransmissionMaps.read("maps.npz")
        TransmissionMaps(7 positioners, 200 knots, gear 1024)
        """
        return load(path)

    def to_wire(
        self, theta_deg: ArrayLike, index: ArrayLike | None = None, direction: int = NEGATIVE
    ) -> Floats:
        """Wire positions that bring the arms to output angles.

        Parameters
        ----------
        theta_deg : array_like
            Output angles (n, 2) or (n, 2, M): alpha and beta of n positioners, deg.
        index : array_like, optional
            Rows; all when left out.
        direction : int
            Contact: -1 negative (the approach from above), +1 positive.

        Returns
        -------
        (n, 2) or (n, 2, M) float
            Motor angle over the nominal gear, deg.

        Raises
        ------
        ValueError
            Another direction.

        Examples
        --------
        >>> import fiberloom as fl
        >>> maps = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7)).run.calibrate()
        >>> maps.to_wire([[10.0, 170.0]] * 7).shape
        (7, 2)
        """
        return self._map(self.output_deg, self.wire_deg, theta_deg, index, direction)

    def to_output(
        self, wire_deg: ArrayLike, index: ArrayLike | None = None, direction: int = NEGATIVE
    ) -> Floats:
        """Output angles at wire positions: the inverse of `to_wire`, exact to rounding.

        Parameters
        ----------
        wire_deg : array_like
            Wire positions (n, 2) or (n, 2, M), deg.
        index : array_like, optional
            Rows; all when left out.
        direction : int
            Contact: -1 negative (the approach from above), +1 positive.

        Returns
        -------
        (n, 2) or (n, 2, M) float
            Angles of alpha and beta, deg.

        Raises
        ------
        ValueError
            Another direction.

        Examples
        --------
        >>> import fiberloom as fl
        >>> maps = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7)).run.calibrate()
        >>> bool((abs(maps.to_output(90.0) - 90.0) < 1.0).all())
        True
        """
        return self._map(self.wire_deg, self.output_deg, wire_deg, index, direction)

    def path_to_wire(self, row: int, theta_deg: ArrayLike, direction: int = NEGATIVE) -> Floats:
        """The path of one positioner in wire positions: as `to_wire`, in one go.

        Parameters
        ----------
        row : int
            The positioner.
        theta_deg : array_like
            (M, 2) output angles, deg.
        direction : int
            Contact: -1 negative, +1 positive.

        Returns
        -------
        (M, 2) float
            Wire positions, deg.

        Examples
        --------
        >>> import fiberloom as fl
        >>> maps = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7)).run.calibrate()
        >>> maps.path_to_wire(0, [[0.0, 180.0], [30.0, 150.0], [60.0, 120.0]]).shape
        (3, 2)
        """
        return self.paths_to_wire([row], [np.asarray(theta_deg, dtype=np.float64)], direction)[0]

    def paths_to_wire(
        self, rows: Sequence[int], paths_deg: Sequence[Floats], direction: int = NEGATIVE
    ) -> list[Floats]:
        """Paths of several positioners in wire positions: to the bit as `path_to_wire` of each.

        Parameters
        ----------
        rows : sequence of int
            Their n rows, each as often as it has paths.
        paths_deg : sequence of array
            For each (M, 2) output angles, deg; each may have as many points as it likes.
        direction : int
            Contact: -1 negative, +1 positive.

        Returns
        -------
        list of (M, 2) float
            Wire positions, deg.

        Examples
        --------
        >>> import fiberloom as fl
        >>> import numpy as np
        >>> maps = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7)).run.calibrate()
        >>> paths = [np.array([[0.0, 180.0], [30.0, 150.0]]), np.array([[60.0, 120.0]])]
        >>> [path.shape for path in maps.paths_to_wire([4, 2], paths)]
        [(2, 2), (1, 2)]
        """
        side = _side(direction)
        if not rows:
            return []
        counts = [len(path) for path in paths_deg]
        all_deg, row = np.concatenate(list(paths_deg)), np.repeat(np.asarray(rows, dtype=np.int64), counts)
        ends = np.cumsum(counts).tolist()
        ways = [slice(start, end) for start, end in zip([0, *ends[:-1]], ends, strict=True)]
        wire = np.empty(all_deg.shape)
        for axis in range(all_deg.shape[1]):
            x = all_deg[:, axis]
            source, goal = self.output_deg[:, axis, side], self.wire_deg[:, axis, side]
            k = np.concatenate([_segments(source[at], x[way]) for at, way in zip(rows, ways, strict=True)])
            k = k.clip(0, source.shape[-1] - 2)
            wire[:, axis] = _between(x, source[row, k], source[row, k + 1], goal[row, k], goal[row, k + 1])
        return [wire[way] for way in ways]

    def _map(
        self,
        source: Floats,
        goal: Floats,
        values: ArrayLike,
        index: ArrayLike | None,
        direction: int,
    ) -> Floats:
        rows = np.arange(len(self)) if index is None else np.atleast_1d(np.asarray(index, dtype=np.int64))
        side = _side(direction)
        given = np.asarray(values, dtype=np.float64)
        given = np.broadcast_to(given, (len(rows), 2, *given.shape[2:]))
        x_knots = source[rows, :, side]
        x = given if given.ndim > 2 else given[..., None]
        k = np.empty(x.shape, dtype=np.int64)
        for place in np.ndindex(len(rows), 2):
            k[place] = _segments(x_knots[place], x[place])
        return _along(x_knots, goal[rows, :, side], k, x).reshape(given.shape)

    def delta_deg(self, theta_deg: ArrayLike, direction: int = NEGATIVE) -> Floats:
        """Deviation from a linear gear, delta(theta) of Eq. 7.

        Parameters
        ----------
        theta_deg : array_like
            (M,) output angles, deg.
        direction : int
            Contact: -1 negative, +1 positive.

        Returns
        -------
        (N, 2, M) float
            Of all positioners, alpha and beta, deg.

        Examples
        --------
        >>> import fiberloom as fl
        >>> maps = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7)).run.calibrate()
        >>> bool(abs(maps.delta_deg([30.0, 60.0, 90.0])).max() < 1.0)
        True
        """
        theta = np.atleast_1d(np.asarray(theta_deg, dtype=np.float64))
        grid = np.broadcast_to(theta, (len(self), 2, len(theta)))
        return self.to_wire(grid, direction=direction) - theta

    def backlash_motor_deg(self, theta_deg: ArrayLike) -> Floats:
        """Backlash B(theta) of Eq. 7.

        Parameters
        ----------
        theta_deg : array_like
            (M,) output angles, deg.

        Returns
        -------
        (N, 2, M) float
            Of all positioners, alpha and beta, motor deg.

        Examples
        --------
        >>> import fiberloom as fl
        >>> maps = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7)).run.calibrate()
        >>> backlash = maps.backlash_motor_deg([90.0])
        >>> bool((backlash > 30.0).all() and (backlash < 300.0).all())
        True
        """
        delta = [self.delta_deg(theta_deg, direction) for direction in (NEGATIVE, POSITIVE)]
        return self.provenance.gear * (delta[1] - delta[0])

    def linear(self) -> TransmissionMaps:
        """What is left without the maps: the nominal ratio and one offset per axis and contact.

        Returns
        -------
        TransmissionMaps
            With two knots.

        Examples
        --------
        >>> import fiberloom as fl
        >>> maps = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7)).run.calibrate()
        >>> maps.linear()
        TransmissionMaps(7 positioners, 2 knots, gear 1024)
        """
        offset = np.mean(self.wire_deg - self.output_deg, axis=-1, keepdims=True)
        ends = self.output_deg[..., [0, -1]]
        return replace(self, output_deg=ends, wire_deg=ends + offset)

    def select(self, index: ArrayLike) -> TransmissionMaps:
        """The maps of some positioners, by row.

        Parameters
        ----------
        index : array_like
            Rows, in the order that is wanted.

        Returns
        -------
        TransmissionMaps

        Examples
        --------
        >>> import fiberloom as fl
        >>> maps = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7)).run.calibrate()
        >>> len(maps.select([0, 3]))
        2
        """
        rows = np.atleast_1d(np.asarray(index))
        return replace(
            self,
            positioner_id=self.positioner_id[rows],
            wire_deg=self.wire_deg[rows],
            output_deg=self.output_deg[rows],
        )

    def rows_of(self, positioner_id: ArrayLike) -> Ints:
        """Rows of positioners by their number on the bus.

        Parameters
        ----------
        positioner_id : array_like
            Numbers, or one.

        Returns
        -------
        (n,) int

        Raises
        ------
        InputError
            A positioner without a map.

        Examples
        --------
        >>> import fiberloom as fl
        >>> maps = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7)).run.calibrate()
        >>> maps.rows_of(maps.positioner_id[[2, 0]]).tolist()
        [2, 0]
        """
        places = {int(p): row for row, p in enumerate(self.positioner_id)}
        wanted = np.atleast_1d(np.asarray(positioner_id)).tolist()
        missing = [p for p in wanted if p not in places]
        if missing:
            raise InputError(
                f"no transmission map for positioner {missing[0]} ({len(missing)} missing): "
                "calibrate the transmission of this layout"
            )
        return np.array([places[p] for p in wanted], dtype=np.int64)

    def save(self, path: str | Path) -> None:
        """Writes one .npz file, at once or not at all.

        Parameters
        ----------
        path : str or Path
            The file; its folder is made where it does not exist.

        Raises
        ------
        InputError
            It cannot be written there.

        Examples
        --------
        >>> import fiberloom as fl
        >>> maps = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7)).run.calibrate()
        >>> maps.save("maps.npz")
        """
        path = Path(path)
        meta = {"format": FORMAT, "format_version": FORMAT_VERSION, **asdict(self.provenance)}
        with whole(path, folders=True) as part, part.open("wb") as file:
            np.savez_compressed(
                file,
                meta=np.array(json.dumps(meta)),
                positioner_id=self.positioner_id,
                wire_deg=self.wire_deg,
                output_deg=self.output_deg,
            )


def polyline(x_knots: Floats, y_knots: Floats, x: ArrayLike) -> Floats:
    """Piecewise linear through rising knots, extended straight beyond both ends; exact at the knots.

    Knots (K,) and values of any unit, usually deg.
    """
    x = np.asarray(x, dtype=np.float64)
    flat = x.ravel()
    return _along(x_knots, y_knots, _segments(x_knots, flat), flat).reshape(x.shape)


def _segments(x_knots: Floats, x: Floats) -> Ints:
    """For each of `x` (M,) the number of the last knot (K,) that is not above it; -1 before the first."""
    found: Ints = x_knots.searchsorted(x, side="right") - 1
    return found


def _along(x_knots: Floats, y_knots: Floats, k: Ints, x: Floats) -> Floats:
    """Polylines (..., K) at `x` (..., M); `k` (..., M) as `_segments` has them."""
    k = k.clip(0, x_knots.shape[-1] - 2)
    before, after = (np.take_along_axis(x_knots, at, axis=-1) for at in (k, k + 1))
    low, high = (np.take_along_axis(y_knots, at, axis=-1) for at in (k, k + 1))
    return _between(x, before, after, low, high)


def _between(x: Floats, before: Floats, after: Floats, low: Floats, high: Floats) -> Floats:
    """On the straight line from `low` at `before` to `high` at `after`: arrays of the same shape."""
    t = (x - before) / (after - before)
    # from the nearer knot: exact at both, and the inverse polyline undoes it to rounding
    return np.where(t <= 0.5, low + t * (high - low), high - (1.0 - t) * (high - low))


def _side(direction: int) -> int:
    if direction not in (NEGATIVE, POSITIVE):
        raise ValueError(f"direction {direction}: -1 for negative contact, +1 for positive")
    return (direction + 1) // 2


def identity(
    positioner_id: ArrayLike, span_deg: tuple[float, float] = (0.0, 360.0), gear: float = GEAR
) -> TransmissionMaps:
    """Maps of perfect gears: wire position and output angle are the same."""
    ids = np.asarray(positioner_id, dtype=np.int64)
    knots = np.broadcast_to(np.array(span_deg), (len(ids), 2, 2, 2)).copy()
    return TransmissionMaps(ids, knots, knots.copy(), Provenance(gear=gear, note="identity"))


def load(path: str | Path) -> TransmissionMaps:
    """Reads what save() wrote; anything else is an InputError."""
    path = Path(path)
    try:
        check_zip(path)
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            parts = {name: np.asarray(file[name]) for name in file.files}
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; make one with 'fiberloom calibrate transmission'") from None
    except Exception as error:  # numpy, zipfile and zlib raise many kinds for a broken file
        raise InputError(f"{path}: not a file of transmission maps, or broken: {one_line(error)}") from None
    return _from_parts(path, parts)


def _from_parts(path: Path, parts: dict[str, Array]) -> TransmissionMaps:
    try:
        meta = parse_json(str(parts["meta"]), "meta")
        if meta.pop("format") != FORMAT:
            raise KeyError("format")
        found = meta.pop("format_version")
        if found != FORMAT_VERSION:
            raise InputError(
                f"transmission maps of format {shown(found)}; this version reads {FORMAT_VERSION}: "
                "calibrate again"
            )
        provenance = Provenance(**meta)
        provenance.check()
        return TransmissionMaps(_numbers(parts["positioner_id"]), *_knots(parts), provenance)
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: not a file of transmission maps ({one_line(repr(error))})") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _numbers(ids: Array) -> Ints:
    if ids.ndim != 1 or ids.dtype.kind not in "iu":
        raise InputError(f"positioner_id: {ids.ndim} dimensions of {ids.dtype}, 1 of whole numbers is needed")
    if len(np.unique(ids)) < len(ids):
        raise InputError("positioner_id: a positioner appears twice")
    return ids


def _knots(parts: dict[str, Array]) -> tuple[Floats, Floats]:
    """Wire and output, deg."""
    for name in ("wire_deg", "output_deg"):
        if parts[name].dtype != np.float64:
            raise InputError(f"{name}: numbers of the type {parts[name].dtype}, float64 is needed")
    return parts["wire_deg"], parts["output_deg"]
