"""A plan: the trajectory of every positioner, and its JSON form."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.errors import InputError
from fiberloom.files import parse_json, read_text, shown
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import COUNTS_PER_DEG
from fiberloom.wholefile import write_whole

KEYS = ("time_s", "alpha_deg", "beta_deg")

MOST_DEG = 3600.0
"""Ten turns: no axis goes there, and a proof along a longer way takes minutes to hours."""
MOST_S = 1e5
"""A day: no motion lasts longer."""
MOST_BUFFER_MM = 1e4


@dataclass(frozen=True)
class Approach:
    """How a positioner comes to its goal where it does not come as all others: alpha, then beta."""

    height_deg: tuple[float, float]
    """From how far above the goal the last leg of each axis comes; below it where this is negative."""
    begin_s: tuple[float, float]
    """When it begins; from then on the axis does not go back."""
    end_s: tuple[float, float]

    def __str__(self) -> str:
        legs = zip(AXES, self.height_deg, self.begin_s, strict=True)
        return ", ".join(f"{axis} from {height:.3g} deg at {begin:.2f} s" for axis, height, begin in legs)

    def to_dict(self) -> dict[str, list[float]]:
        """As in the JSON file: deg and s."""
        return {key: list(getattr(self, key)) for key in _LEGS}

    @classmethod
    def from_dict(cls, document: Any, where: str = "approach") -> "Approach":
        """From the object of the JSON file; InputError where it is not sound."""
        pairs = [_array(document, key, where).tolist() for key in _LEGS]
        if any(len(pair) != 2 for pair in pairs):
            raise InputError(f"{where}: {', '.join(_LEGS)} hold two numbers each, for alpha and beta")
        height, begin, end = ((pair[0], pair[1]) for pair in pairs)
        return cls(height, begin, end)


_STRAIGHT_DEG = 1e-8
"""A point so near to the line between its neighbours is on it: angles are rounded to 1e-9 deg."""
_LEGS = ("height_deg", "begin_s", "end_s")


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The trajectory of one positioner: linear between points; one point if it does not move."""

    positioner_id: int
    time_s: Floats
    alpha_deg: Floats
    beta_deg: Floats
    approach: Approach | None = None
    """Its own way to the goal; None: as all others."""

    @property
    def moves(self) -> bool:
        """Does it go anywhere?"""
        return len(self.time_s) > 1

    @property
    def points_deg(self) -> Floats:
        """(n, 2) alpha and beta at its points."""
        points = np.empty((len(self.time_s), 2))
        points[:, 0], points[:, 1] = self.alpha_deg, self.beta_deg
        return points

    def at(self, time_s: ArrayLike) -> Floats:
        """(n, 2) alpha and beta in deg at these times; constant before and after."""
        when = np.asarray(time_s, dtype=np.float64)
        angles = (self.alpha_deg, self.beta_deg)
        return np.stack([np.interp(when, self.time_s, a) for a in angles], axis=-1)

    def corners(self, axis: int) -> Ints:
        """Rows of the points that one axis needs, 0 alpha or 1 beta: as of `corners_of`."""
        return corners_of([self])[0][axis]

    def to_dict(self) -> dict[str, Any]:
        """As in the JSON file."""
        arrays = {k: getattr(self, k).tolist() for k in KEYS}
        own = {} if self.approach is None else {"approach": self.approach.to_dict()}
        return {"positioner_id": self.positioner_id} | arrays | own


def corners_of(robots: Sequence[Trajectory]) -> list[tuple[Ints, Ints]]:
    """For each of `robots` rows of the points that alpha needs, and beta: the first, the last, and those at
    which its speed changes. Within a count of the bus all others are on the straight lines between these.
    """
    if not robots:
        return []
    ends = np.cumsum([len(robot.time_s) for robot in robots])
    starts = np.concatenate([[0], ends[:-1]])
    time_s = np.concatenate([robot.time_s for robot in robots])
    alpha_deg = np.concatenate([robot.alpha_deg for robot in robots])
    beta_deg = np.concatenate([robot.beta_deg for robot in robots])
    needed = [_needed(time_s, angle_deg, starts, ends) for angle_deg in (alpha_deg, beta_deg)]
    both = zip(*(_rows_by_robot(axis, starts, ends) for axis in needed), strict=True)
    return list(both)


def _needed(time_s: Floats, angle_deg: Floats, starts: Ints, ends: Ints) -> Flags:
    """Which points of an axis are corners; the trajectories follow each other, from `starts` to `ends`."""
    needed = np.zeros(len(time_s), dtype=bool)
    needed[starts] = needed[ends - 1] = True
    inner = np.flatnonzero(~needed)
    share = (time_s[inner] - time_s[inner - 1]) / (time_s[inner + 1] - time_s[inner - 1])
    straight_deg = angle_deg[inner - 1] + share * (angle_deg[inner + 1] - angle_deg[inner - 1])
    needed[inner] = np.abs(straight_deg - angle_deg[inner]) > _STRAIGHT_DEG
    left = np.flatnonzero(~needed)
    corners = np.flatnonzero(needed)
    behind = np.searchsorted(corners, left)  # both ends of a trajectory are corners
    a, b = corners[behind - 1], corners[behind]
    slope = (angle_deg[b] - angle_deg[a]) / (time_s[b] - time_s[a])
    off_deg = slope * (time_s[left] - time_s[a]) + angle_deg[a] - angle_deg[left]
    far = left[~(np.abs(off_deg) * COUNTS_PER_DEG < 0.5)]
    for robot in np.unique(np.searchsorted(ends, far, side="right")):
        needed[starts[robot] : ends[robot]] = True
    return needed


def _rows_by_robot(needed: Flags, starts: Ints, ends: Ints) -> list[Ints]:
    rows = np.flatnonzero(needed)
    own = rows - np.repeat(starts, np.add.reduceat(needed, starts, dtype=np.int64))
    cuts = np.searchsorted(rows, ends).tolist()
    return [own[first:last] for first, last in zip([0, *cuts[:-1]], cuts, strict=True)]


@dataclass(frozen=True, eq=False)
class Plan:
    """Trajectories of all positioners of a focal plane on a common clock. Made by `plan`.

    Examples
    --------
    >>> import fiberloom as fl
    >>> plane = fl.FocalPlane.of("sdssv", n=7)
    >>> fl.plan(plane, plane.park_deg, plane.park_deg - [0.0, 30.0])
    Plan('sdssv', 7 positioners, 7 move, 3.00 s)
    """

    instrument: str
    collision_buffer_mm: float
    robots: tuple[Trajectory, ...]
    refused: dict[int, str] = field(default_factory=dict)
    """Reason for each positioner that does not arrive, by positioner_id. It stays, or goes out of the way."""
    cpu_s: float = 0.0
    """What it took to plan and verify; not part of the JSON form."""
    statistics: dict[str, Any] = field(default_factory=dict)
    """How hard it was; not part of the JSON form."""

    def __repr__(self) -> str:
        moving = sum(robot.moves for robot in self.robots)
        refused = f", {len(self.refused)} refused" if self.refused else ""
        return (
            f"Plan({self.instrument!r}, {len(self.robots)} positioners, {moving} move, "
            f"{self.duration_s:.2f} s{refused})"
        )

    @property
    def duration_s(self) -> float:
        """When the last positioner has arrived."""
        return max((float(r.time_s[-1]) for r in self.robots), default=0.0)

    @property
    def points_per_axis(self) -> list[int]:
        """How many points each axis gets over the bus, of those that move."""
        return [len(robot.corners(axis)) for robot in self.robots if robot.moves for axis in (0, 1)]

    @property
    def approaches(self) -> dict[int, Approach]:
        """By positioner_id, of those that come to their goals in a way of their own: less high, later, or one
        axis after the other, because the usual approach would touch something."""
        return {r.positioner_id: r.approach for r in self.robots if r.approach is not None}

    @property
    def late_s(self) -> float:
        """How late any one positioner may be in all pairs but `not_late`, as the planner has it; 0 if it was
        not asked for, or had to be given up so that all arrive. `verify_late` proves it. Not part of the JSON
        form."""
        return float(self.statistics.get("late_s", 0.0))

    @property
    def not_late(self) -> tuple[tuple[int, int], ...]:
        """Pairs of positioner_id that were planned as if both were on time; most of them bear it none the
        less."""
        return tuple(self.statistics.get("not_late", ()))

    @property
    def end_deg(self) -> Floats:
        """(N, 2) of every positioner afterwards, in the order of `robots`."""
        return np.array([[r.alpha_deg[-1], r.beta_deg[-1]] for r in self.robots]).reshape(-1, 2)

    def unmoved(self, why: str) -> "Plan":
        """All positioners where they begin; those that would have moved are refused.

        Those refused before keep their own reason.

        Parameters
        ----------
        why : str
            The reason, in words.

        Returns
        -------
        Plan
            Of the same positioners, at rest.

        Examples
        --------
        >>> import fiberloom as fl
        >>> plane = fl.FocalPlane.of("sdssv", n=7)
        >>> made = fl.plan(plane, plane.park_deg, plane.park_deg - [0.0, 30.0]).unmoved("not now")
        >>> made.duration_s, len(made.refused)
        (0.0, 7)
        """
        moving = [robot.positioner_id for robot in self.robots if robot.moves]
        stands = (
            Trajectory(robot.positioner_id, np.zeros(1), robot.alpha_deg[:1], robot.beta_deg[:1])
            for robot in self.robots
        )
        refused = {number: f"positioner {number}: {why}" for number in moving} | self.refused
        return replace(self, robots=tuple(stands), refused=refused)

    def to_dict(self) -> dict[str, Any]:
        """The object of trajectories.json.

        Returns
        -------
        dict
            instrument, collision_buffer_mm, robots (times in s, angles in deg), not_arrived.

        Examples
        --------
        >>> import fiberloom as fl
        >>> plane = fl.FocalPlane.of("sdssv", n=3)
        >>> sorted(fl.plan(plane, plane.park_deg, plane.park_deg).to_dict())
        ['collision_buffer_mm', 'instrument', 'not_arrived', 'robots']
        """
        return {
            "instrument": self.instrument,
            "collision_buffer_mm": self.collision_buffer_mm,
            "robots": [robot.to_dict() for robot in self.robots],
            "not_arrived": {str(k): why for k, why in self.refused.items()},
        }

    def to_json(self) -> str:
        """One line of JSON: the same plan gives the same bytes.

        Returns
        -------
        str

        Examples
        --------
        >>> import fiberloom as fl
        >>> plane = fl.FocalPlane.of("sdssv", n=3)
        >>> made = fl.plan(plane, plane.park_deg, plane.park_deg)
        >>> fl.Plan.from_json(made.to_json()).to_json() == made.to_json()
        True
        """
        return json.dumps(self.to_dict(), separators=(",", ":"))

    def save(self, path: str | Path, **marks: Any) -> None:
        """Writes the JSON form.

        Parameters
        ----------
        path : str or Path
            The file; written over.
        **marks
            Added to the object: version, seed, ...

        Examples
        --------
        >>> import fiberloom as fl
        >>> plane = fl.FocalPlane.of("sdssv", n=3)
        >>> fl.plan(plane, plane.park_deg, plane.park_deg).save("trajectories.json", seed=0)
        """
        document = marks | self.to_dict()
        write_whole(path, json.dumps(document, separators=(",", ":")) + "\n")

    @classmethod
    def from_dict(cls, document: Mapping[str, Any], where: str = "plan") -> "Plan":
        """From the object of trajectories.json; keys that it does not know are left out.

        Parameters
        ----------
        document : mapping
            As of `to_dict`.
        where : str
            Names the object in errors.

        Returns
        -------
        Plan

        Raises
        ------
        InputError
            A key that is missing, a value of the wrong type, a positioner that appears twice.

        Examples
        --------
        >>> import fiberloom as fl
        >>> fl.Plan.from_dict({"instrument": "sdssv", "collision_buffer_mm": 2.0, "robots": []})
        Plan('sdssv', 0 positioners, 0 move, 0.00 s)
        """
        robots = tuple(
            _robot(entry, f"{where}, robots[{k}]")
            for k, entry in enumerate(_get(document, "robots", list, where))
        )
        ids = [robot.positioner_id for robot in robots]
        twice = sorted({p for p in ids if ids.count(p) > 1}) if len(set(ids)) < len(ids) else []
        if twice:
            raise InputError(f"{where}: positioner {twice[0]} appears twice; keep one of them")
        buffer_mm = _get(document, "collision_buffer_mm", (int, float), where)
        if not 0.0 < buffer_mm < MOST_BUFFER_MM:
            raise InputError(f"{where}: collision_buffer_mm = {shown(buffer_mm)} must be above 0")
        return cls(
            instrument=str(_get(document, "instrument", str, where)),
            collision_buffer_mm=float(buffer_mm),
            robots=robots,
            refused=_refused(document, where),
        )

    @classmethod
    def from_json(cls, text: str, where: str = "plan") -> "Plan":
        """From one JSON object.

        Parameters
        ----------
        text : str
            As of `to_json`.
        where : str
            Names the text in errors.

        Returns
        -------
        Plan

        Raises
        ------
        InputError
            Not JSON (line and column), or as `from_dict`.

        Examples
        --------
        >>> import fiberloom as fl
        >>> fl.Plan.from_json('{"instrument": "sdssv"}')
        Traceback (most recent call last):
        fiberloom.errors.InputError: plan: no 'robots'; it has instrument
        """
        return cls.from_dict(_parse(text, where), where)


def read_plans(
    path: str | Path, plane: FocalPlane | None = None, *, buffer_mm: float | None = None
) -> list[Plan]:
    """All plans of a trajectories.json: one object, or {"plans": [...]} as `observe` writes it.

    InputError where there is none. With a focal plane: every positioner of a plan must be in it, the
    instrument must be its own, and the collision buffer no smaller than it keeps (`least_buffer_mm`),
    unless `buffer_mm` says with which one they are to be checked.
    """
    where = str(path)
    document = _parse(read_text(Path(path)), where)
    if "plans" not in document:
        plans = [Plan.from_dict(document, where)]
    else:
        entries = _get(document, "plans", list, where)
        plans = [Plan.from_dict(e, f"{where}, plans[{k}]") for k, e in enumerate(entries)]
    if not plans:
        raise InputError(f"{where}: 'plans' is empty: there is nothing in it to check or to carry out")
    if plane is not None:
        for made in plans:
            _belongs(made, plane, where, buffer_mm)
    return plans


def least_buffer_mm(plane: FocalPlane) -> float:
    """The smallest collision buffer with which plans of this focal plane are made, mm."""
    return plane.collision_buffer_mm - plane.instrument.bodies.collision_shrink_mm


def _belongs(made: Plan, plane: FocalPlane, where: str, asked_mm: float | None) -> None:
    name = plane.instrument.name
    if made.instrument != name:
        raise InputError(f"{where}: planned for {made.instrument}, not for {name}; name the --instrument")
    try:
        plane.index_of([robot.positioner_id for robot in made.robots])
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    least_mm, has_mm = least_buffer_mm(plane), made.collision_buffer_mm
    if asked_mm is None and has_mm < least_mm - 1e-9:
        raise InputError(
            f"{where}: planned with a collision buffer of {has_mm:g} mm, {name} keeps {least_mm:g} mm or "
            f"more; plan anew, or name the buffer to check with: --buffer {least_mm:g}"
        )


def _parse(text: str, where: str) -> dict[str, Any]:
    document = parse_json(text, where)
    if not isinstance(document, dict):
        raise InputError(f"{where}: a JSON object is expected, found {type(document).__name__}")
    return document


def _get(document: Mapping[str, Any], key: str, kind: type | tuple[type, ...], where: str) -> Any:
    if not isinstance(document, Mapping):
        raise InputError(f"{where}: a JSON object is expected")
    if key not in document:
        raise InputError(f"{where}: no '{key}'; it has {', '.join(map(str, document)) or 'nothing'}")
    value = document[key]
    if not isinstance(value, kind) or isinstance(value, bool):
        raise InputError(f"{where}: '{key}' has the wrong type ({type(value).__name__})")
    return value


def _refused(document: Mapping[str, Any], where: str) -> dict[int, str]:
    refused = document.get("not_arrived") or {}
    if not isinstance(refused, Mapping):
        raise InputError(f"{where}: 'not_arrived' has the wrong type ({type(refused).__name__})")
    wrong = [key for key in refused if not (key.isascii() and key.isdigit() and len(key) < 10)]
    if wrong:
        raise InputError(f"{where}: 'not_arrived' names {shown(wrong[0])}, which is no positioner")
    return {int(key): str(why) for key, why in refused.items()}


def _robot(entry: Any, where: str) -> Trajectory:
    number = _get(entry, "positioner_id", int, where)
    if not 0 <= number < 2**31:
        raise InputError(f"{where}: positioner_id = {shown(number)} is no number of a positioner")
    where = f"{where} (positioner {number})"
    time_s, alpha_deg, beta_deg = (_array(entry, key, where) for key in KEYS)
    if not len(time_s) == len(alpha_deg) == len(beta_deg) > 0:
        raise InputError(
            f"{where}: {len(time_s)} times, {len(alpha_deg)} alphas, {len(beta_deg)} betas; "
            "there must be as many of each, at least one"
        )
    told = entry.get("approach")
    approach = None if told is None else Approach.from_dict(told, f"{where}, approach")
    return Trajectory(number, time_s, alpha_deg, beta_deg, approach)


def _array(entry: Mapping[str, Any], key: str, where: str) -> Floats:
    values = _get(entry, key, list, where)
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: '{key}' must be a list of numbers") from None
    if array.ndim != 1 or not np.isfinite(array).all():
        raise InputError(f"{where}: '{key}' must be a flat list of finite numbers")
    most, unit = (MOST_S, "s") if key.endswith("_s") else (MOST_DEG, "deg")
    far = np.flatnonzero(np.abs(array) > most)
    if len(far):
        raise InputError(f"{where}: '{key}' holds {array[far[0]]:g} {unit}; at most {most:g} {unit} is sound")
    if any(isinstance(value, bool | str) for value in values):  # numpy makes numbers of them
        raise InputError(f"{where}: '{key}' must be a list of numbers")
    return array
