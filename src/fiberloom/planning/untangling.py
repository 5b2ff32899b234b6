"""From a collision to a goal: bodies that overlap are taken apart first, by motions proven to part them."""

import time
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.instruments import FocalPlane
from fiberloom.planning.bodies import CollisionBodies, angles_rad, travel_rad
from fiberloom.planning.overlaps import Surroundings
from fiberloom.planning.planner import DECIMALS_DEG, PlanSettings, plan
from fiberloom.planning.retreat import Retreat, SearchWindow, find_retreat, find_room, find_way_towards
from fiberloom.planning.trajectories import Plan, Trajectory
from fiberloom.planning.verification import MotionLimits, verify
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import TICK_S, deg_to_rad, rad_to_deg

WINDOWS = (
    SearchWindow(0.25, 4.0, 0.08),
    SearchWindow(0.25, 12.0, 0.08),
    SearchWindow(0.25, 12.0, 0.02),
    SearchWindow(0.5, 40.0, 0.02),
    SearchWindow(0.5, 40.0, 0.002),
    SearchWindow(0.5, 40.0, 0.0),
)
"""Where a way out is looked for, in this order: near and steep first. At 0.08 mm per degree the bodies part
at more than 15 deg to where they touch, so an error of the angles of some tenths of a degree does no
harm. The last lets a gap stay as it is for a step: where an arm presses on the end of another alpha
arm, in its direction, the gap grows only with the square of the way."""

ALONE = SearchWindow(0.5, 90.0, 0.0)
"""Where a positioner that `plan` has refused looks for a way, all others at rest."""

ASIDE = SearchWindow(0.5, 40.0, 0.0)
"""Where one that overlaps nothing looks for a place out of the way of those that do."""

_EFFORT = 0.02
"""Of what `plan` usually takes before it gives a positioner up: knots that it does not undo soon, one that
moves alone on a finer grid does."""
_SHIFTS = ((1.0, 0.0), (0.0, 1.0), (1.0, -1.0))
_NEIGHBOURS_MM = 1.0
"""Positioners are neighbours if they can come so near."""
_FENCE_MM = 2.0
"""One that is so near to an arm that overlaps something may be what keeps it from parting."""
_ROUNDS = 3
"""How often all is tried again when others have moved on to their goals."""


@dataclass(frozen=True)
class UntangleSettings:
    """How to untangle."""

    plan: PlanSettings = field(default_factory=PlanSettings)
    """For everything but the retreats, and the collision buffer of all."""
    speed_deg_s: float = 1.0
    """Of retreats."""
    margin_mm: float = 0.2
    """Beyond the buffer, after a retreat: room for the planner."""
    uncertainty_deg: float = 0.2
    """A retreat is also proven for positioners that are this far from where they are said to be, on
    both axes. The backlash of SDSS-V's alpha is 0.25 deg; an arm that is pressed bends by some tenths."""


@dataclass(frozen=True, eq=False)
class Stage:
    """One motion on the way apart."""

    what: str
    plan: Plan
    uncertainty_deg: float | None = None
    """For a retreat: proven for angles that are off by this. None: an ordinary plan."""

    @property
    def separates(self) -> bool:
        """Bodies that overlap move in it: verify with `MotionLimits(separating=True)`, and send it with the
        approach of the firmware (precise moves) off."""
        return self.uncertainty_deg is not None


@dataclass(frozen=True, eq=False)
class Untangled:
    """A way from a collision to the goal, in stages; made by `untangle`.

    Examples
    --------
    >>> import fiberloom as fl
    >>> from fiberloom.planning import untangle
    >>> plane = fl.FocalPlane.of("sdssv", n=7)
    >>> untangle(plane, plane.park_deg)
    Untangled(0 overlaps, 0 stages, 0 stuck, 0 refused)
    """

    stages: tuple[Stage, ...]
    """In order; each begins where the one before ends."""
    start_deg: Floats
    overlaps: dict[tuple[str, str], float]
    """Bodies that overlap at the start, and by how much: mm below the collision buffer."""
    stuck: dict[int, str]
    """Why a positioner still overlaps something, by positioner_id."""
    refused: dict[int, str]
    """Why a positioner that overlaps nothing is not at its goal."""
    cpu_s: float = 0.0

    def __repr__(self) -> str:
        counts = f"{len(self.overlaps)} overlaps, {len(self.stages)} stages"
        return f"Untangled({counts}, {len(self.stuck)} stuck, {len(self.refused)} refused)"

    @property
    def free(self) -> bool:
        """Nothing overlaps any more."""
        return not self.stuck

    @property
    def end_deg(self) -> Floats:
        """(N, 2) where all are afterwards."""
        return self.stages[-1].plan.end_deg if self.stages else self.start_deg

    @property
    def duration_s(self) -> float:
        """Of all stages, one after the other."""
        return sum(stage.plan.duration_s for stage in self.stages)


def untangle(
    plane: FocalPlane,
    start_deg: ArrayLike,
    goal_deg: ArrayLike | None = None,
    *,
    seed: int = 0,
    settings: UntangleSettings | None = None,
) -> Untangled:
    """A verified way out of a collision, and on to a goal.

    First the positioners that overlap something retreat, one after the other, slowly and by as little as
    frees them; the gaps of what overlaps only grow, all others keep the buffer. Where no retreat is found,
    their neighbours fold, and it is tried again. Then `plan` takes all to their goals.

    Parameters
    ----------
    plane : FocalPlane
        N positioners; offline ones do not move and are where the plane says.
    start_deg : array_like
        (N, 2) where they are, deg: arms may overlap each other, fiducials and guide cameras.
    goal_deg : array_like, optional
        (N, 2), deg; folded when left out.
    seed : int
        Of the planner: the same input and seed give the same stages.
    settings : UntangleSettings, optional
        Speed, margin and uncertainty of retreats.

    Returns
    -------
    Untangled
        Stages to be carried out one after the other, each of which has passed `verify`; what still
        overlaps and what did not reach its goal, with the reasons.

    Raises
    ------
    InputError
        Angles of another shape.

    Examples
    --------
    >>> import fiberloom as fl
    >>> from fiberloom.planning import untangle
    >>> plane = fl.FocalPlane.of("sdssv", n=7)
    >>> start_deg = plane.park_deg
    >>> start_deg[0] = [255.0, 35.0]  # over its neighbours
    >>> found = untangle(plane, start_deg)
    >>> found.free, found.refused
    (True, {})
    >>> [stage.what for stage in found.stages]
    ['...']
    """
    return _Untangling(plane, start_deg, goal_deg, seed, settings or UntangleSettings()).run()


class _Untangling:
    def __init__(
        self,
        plane: FocalPlane,
        start_deg: ArrayLike,
        goal_deg: ArrayLike | None,
        seed: int,
        settings: UntangleSettings,
    ) -> None:
        self.plane, self.seed, self.settings = plane, seed, settings
        self.planning = settings.plan.of(plane)
        still = plane.offline[:, None]
        start = rad_to_deg(angles_rad("start_deg", start_deg, plane))
        goal = rad_to_deg(angles_rad("goal_deg", plane.park_deg if goal_deg is None else goal_deg, plane))
        self.here = np.where(still, plane.offline_position_deg, start)
        self.goal = np.where(still, plane.offline_position_deg, goal)
        bodies = CollisionBodies.of(plane, self.planning.collision_buffer_mm)
        self.around = Surroundings(plane, bodies)
        self.travel = travel_rad(plane)
        self.stages: list[Stage] = []

    def run(self) -> Untangled:
        begin = time.thread_time()
        start = self.here.copy()
        overlaps = self._overlapping()
        for _ in range(_ROUNDS):
            self._part()
            stuck = self._stuck()
            before = len(self.stages)
            refused = self._on_to_goal(stuck)
            if not stuck or len(self.stages) == before:
                break
        return Untangled(
            stages=tuple(self.stages),
            start_deg=start,
            overlaps={(self.around.name(i), self.around.name(j)): d for (i, j), d in overlaps.items()},
            stuck=stuck,
            refused=refused,
            cpu_s=time.thread_time() - begin,
        )

    def _part(self) -> None:
        """Takes apart what overlaps, until nothing does or nothing helps any more."""
        folded, aside = set[frozenset[tuple[int, int]]](), set[frozenset[tuple[int, int]]]()
        while pairs := self._overlapping():
            which = frozenset(pairs)
            if self._retreat(pairs, whole=True):
                continue
            if which not in folded:
                folded.add(which)
                if self._fold_round(pairs):
                    continue
            if which not in aside:
                aside.add(which)
                if self._step_aside(pairs):
                    continue
            if not self._retreat(pairs, whole=False):
                return
            aside.discard(which)  # it gained: those around it may have more room now, too

    def _overlapping(self) -> dict[tuple[int, int], float]:
        return self.around.overlapping(deg_to_rad(self.here))

    def _able(self, pairs: dict[tuple[int, int], float]) -> list[int]:
        """Rows that overlap something and can move; those that overlap most first."""
        count: dict[int, int] = {}
        for pair in pairs:
            for row in pair:
                if row < self.plane.n and not self.plane.offline[row]:
                    count[row] = count.get(row, 0) + 1
        return sorted(count, key=lambda row: (-count[row], row))

    def _retreat(self, pairs: dict[tuple[int, int], float], whole: bool) -> bool:
        """Carries out the shortest retreat that can be proven; whole: only one that frees its positioner."""
        for window in WINDOWS:
            found = [self._way(row, window) for row in self._able(pairs)]
            ways = sorted(
                (way for way in found if way is not None and way.free >= whole),
                key=lambda way: (not way.free, way.travel_deg, way.row),
            )
            if any(self._take(way, pairs) for way in ways):
                return True
        return False

    def _way(self, row: int, window: SearchWindow) -> Retreat | None:
        here = deg_to_rad(self.here)
        return find_retreat(self.around, here, row, self.travel, window, self.settings.margin_mm)

    def _take(self, way: Retreat, pairs: dict[tuple[int, int], float]) -> bool:
        """Adds a retreat if it passes the verifier, for the greatest uncertainty for which it does."""
        made = self._plan_of(way, self.settings.speed_deg_s)
        if not self._proven(self.plane, made, self.here):
            return False
        wanted = self.settings.uncertainty_deg
        partners = [other for pair in pairs if way.row in pair for other in pair if other != way.row]
        for uncertainty in (wanted, wanted / 2.0, wanted / 4.0, 0.0):
            if uncertainty == 0.0 or self._proven_off_by(uncertainty, made, way.row, partners):
                self._add(f"retreat of positioner {self.plane.positioner_id[way.row]}", made, uncertainty)
                return True
        return False

    def _plan_of(self, way: Retreat, speed_deg_s: float) -> Plan:
        """One positioner moves evenly, step by step of its grid; all others are at rest."""
        acceleration = self.planning.acceleration_deg_s2 or 0.0
        by_acceleration = np.sqrt(0.5 * acceleration * way.step_deg)  # a reversal within a step
        speed = min(speed_deg_s, self.planning.speed_deg_s or 0.0, by_acceleration)
        ticks = np.ceil(way.step_deg / speed / TICK_S - 1e-9)
        keep = _corners(way.points_deg)
        times = np.round(keep * ticks * TICK_S, 6)
        robots = [_at_rest(int(p), here) for p, here in zip(self.plane.positioner_id, self.here, strict=True)]
        points = np.round(way.points_deg[keep], DECIMALS_DEG)
        robots[way.row] = Trajectory(robots[way.row].positioner_id, times, *points.T)
        buffer_mm = self.around.bodies.radius_mm
        return Plan(self.plane.instrument.name, buffer_mm, tuple(robots))

    def _proven(self, plane: FocalPlane, made: Plan, start_deg: Floats) -> bool:
        limits = MotionLimits(self.planning.speed_deg_s, self.planning.acceleration_deg_s2, separating=True)
        return verify(plane, made, start_deg=start_deg, limits=limits).ok

    def _proven_off_by(self, off_deg: float, made: Plan, row: int, partners: list[int]) -> bool:
        """Do the bodies part too if they are not quite where they are said to be?

        At every corner of what is possible, for the one that moves, for those that it overlaps, and for both
        against each other.
        """
        arms = [k for k in partners if k < self.plane.n]
        small = self._cut_out([row, *arms], [k - self.plane.n for k in partners if k >= self.plane.n])
        mine = [made.robots[k] for k in (row, *arms)]
        for (first, rest), signs in product(_SHIFTS, product((-1.0, 1.0), repeat=2)):
            shift = off_deg * np.array(signs)
            robots = [_shifted(r, (rest if k else first) * shift) for k, r in enumerate(mine)]
            there = np.array([r.points_deg[0] for r in robots])
            if not self._parts(small, replace(made, robots=tuple(robots)), there):
                return False
        return True

    def _parts(self, small: FocalPlane, made: Plan, start_deg: Floats) -> bool:
        limits = MotionLimits(separating=True, collision_buffer_mm=self.around.bodies.radius_mm)
        found = verify(small, made, start_deg=start_deg, limits=limits)
        return not found.collisions

    def _cut_out(self, rows: list[int], obstacles: list[int]) -> FocalPlane:
        """These positioners and obstacles alone, none offline."""
        discs = len(self.plane.fiducials)
        small = replace(
            self.plane,
            fiducials=self.plane.fiducials[[k for k in obstacles if k < discs]],
            guide_cameras=self.plane.guide_cameras[[k - discs for k in obstacles if k >= discs]],
            offline=np.zeros(self.plane.n, dtype=bool),
        )
        return small.select(rows)

    def _fold_round(self, pairs: dict[tuple[int, int], float]) -> bool:
        """Folds the neighbours of what overlaps; False if none of them moves."""
        folding = self._neighbours(pairs)
        goal = np.where(folding[:, None], self.plane.park_deg, self.here)
        before = len(self.stages)
        self._planned(goal, "fold the neighbours", 0, {})
        return len(self.stages) > before

    def _neighbours(self, pairs: dict[tuple[int, int], float]) -> Flags:
        tangled = [row for pair in pairs for row in pair if row < self.plane.n]
        near = self.plane.neighbour_pairs(_NEIGHBOURS_MM)
        out = np.zeros(self.plane.n, dtype=bool)
        for i, j in (near.T, near[:, ::-1].T):
            out[j[np.isin(i, tangled)]] = True
        out[tangled] = False
        return out & ~self.plane.offline

    def _step_aside(self, pairs: dict[tuple[int, int], float]) -> bool:
        """Those that overlap nothing, but fence in what does, make room one by one; False if none can."""
        tangled = np.unique([row for pair in pairs for row in pair if row < self.plane.n])
        moved = False
        for row in self._fences(tangled):
            way = find_room(self.around, deg_to_rad(self.here), row, tangled, self.travel, ASIDE)
            moved |= way is not None and self._alone(way, "aside")
        return moved

    def _fences(self, tangled: Ints) -> list[int]:
        """Rows near those that overlap something; the nearest first."""
        here, nearest = deg_to_rad(self.here), dict[int, float]()
        for row in map(int, tangled):
            others = self.around.near[row]
            others = others[others < self.plane.n]
            gaps = self.around.gaps_mm(row, here[[row]], here, others)[0]
            for other, gap in zip(others.tolist(), gaps.tolist(), strict=True):
                nearest[other] = min(gap, nearest.get(other, np.inf))
        able = [r for r in nearest if r not in tangled and not self.plane.offline[r]]
        return sorted((r for r in able if nearest[r] < _FENCE_MM), key=lambda r: (nearest[r], r))

    def _alone(self, way: Retreat, what: str) -> bool:
        """Adds the motion of one that overlaps nothing, if it passes the verifier."""
        made = self._plan_of(way, self.planning.speed_deg_s or 0.0)
        proven = self._proven(self.plane, made, self.here)
        if proven:
            self._add(f"positioner {self.plane.positioner_id[way.row]} {what}", made, None)
        return proven

    def _on_to_goal(self, stuck: dict[int, str]) -> dict[int, str]:
        """All that are free to their goals; the reasons of those that did not get there."""
        refused = self._planned(self.goal, "to the goal", 0, stuck)
        if refused and self._loosen(refused):
            refused = self._planned(self.goal, "to the goal, again", 1, stuck)
        park = np.where(self.plane.offline[:, None], self.here, self.plane.park_deg)
        if refused and not np.array_equal(park, self.goal):
            self._planned(park, "fold all", 2, stuck)
            refused = self._planned(self.goal, "to the goal, from the folded field", 3, stuck)
        return refused

    def _planned(self, goal_deg: Floats, what: str, attempt: int, stuck: dict[int, str]) -> dict[int, str]:
        """Adds an ordinary plan if it moves anything; why some that are free are refused."""
        settings = replace(self.settings.plan, effort=_EFFORT * self.settings.plan.effort)
        made = plan(self.plane, self.here, goal_deg, seed=self.seed + attempt, settings=settings)
        if any(robot.moves for robot in made.robots):
            self._add(what, made, None)
        return {k: why for k, why in made.refused.items() if k not in stuck}

    def _loosen(self, refused: dict[int, str]) -> bool:
        """Those that were refused go, alone and on a finer grid, as near to their goals as they can."""
        moved = False
        for row in map(int, self.plane.index_of(list(refused))):
            goal = deg_to_rad(self.goal[row])
            here = deg_to_rad(self.here)
            way = find_way_towards(self.around, here, row, goal, self.travel, ALONE)
            moved |= way is not None and self._alone(way, "alone")
        return moved

    def _add(self, what: str, made: Plan, uncertainty_deg: float | None) -> None:
        self.stages.append(Stage(what, made, uncertainty_deg))
        self.here = made.end_deg

    def _stuck(self) -> dict[int, str]:
        out: dict[int, str] = {}
        for (i, j), depth in self._overlapping().items():
            for row, other in ((i, j), (j, i)):
                if row < self.plane.n:
                    name = self.around.name(row)
                    fixed = ", and is offline" if self.plane.offline[row] else ""
                    why = f"overlaps {self.around.name(other)} by {depth:.3f} mm{fixed}"
                    out[int(self.plane.positioner_id[row])] = f"{name}: {why}; no way apart was found"
        return out


def _at_rest(positioner_id: int, here_deg: Floats) -> Trajectory:
    return Trajectory(positioner_id, np.zeros(1), here_deg[:1].copy(), here_deg[1:].copy())


def _shifted(robot: Trajectory, shift_deg: Floats) -> Trajectory:
    return replace(robot, alpha_deg=robot.alpha_deg + shift_deg[0], beta_deg=robot.beta_deg + shift_deg[1])


def _corners(points_deg: Floats) -> Ints:
    """Where the direction changes, and both ends."""
    ways = np.diff(points_deg, axis=0)
    turns = np.flatnonzero(np.abs(np.diff(ways, axis=0)).max(axis=1) > 1e-9) + 1
    return np.array([0, *turns, len(points_deg) - 1], dtype=np.int64)
