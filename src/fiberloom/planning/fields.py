"""Random configurations without collisions: for tests, benchmarks and trials without targets."""

import numpy as np

from fiberloom._core import geometry
from fiberloom._core import planning as core
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.planning.bodies import CollisionBodies, approach_rad, beside
from fiberloom.planning.planner import PlanSettings, plan
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import deg_to_rad, rad_to_deg

_DRAWS = 400
_DISPLACED = 20
_REDRAWS = 50


def random_configuration(
    plane: FocalPlane,
    seed: int,
    *,
    margin_mm: float = 0.2,
    approach_deg: float | None = None,
    collision_buffer_mm: float | None = None,
) -> Floats:
    """(N, 2) deg: every metrology fibre anywhere in its patrol area (uniform in area).

    The positioners of `plane` are placed one after the other in random order (`seed`), so that all
    places and approaches to them (`approach_deg`, the instrument's when left out) are free with
    `margin_mm` between two arms, and between arm and obstacle. `collision_buffer_mm`: radius of the
    arms, the instrument's when left out. Offline positioners stay.
    """
    rng = np.random.default_rng(seed)
    return _Drawing(plane, rng, margin_mm, approach_deg, collision_buffer_mm).all()


def random_pair(
    plane: FocalPlane,
    seed: int,
    *,
    margin_mm: float = 0.2,
    collision_buffer_mm: float | None = None,
) -> tuple[Floats, Floats]:
    """Two random configurations (N, 2) in deg such that each positioner, alone, can get from one to the
    other.

    That is, no place lies in a pocket behind a fiducial. `plane`, `seed`, `margin_mm` and
    `collision_buffer_mm` as in `random_configuration`.
    """
    rng = np.random.default_rng(seed)
    start, goal = (_Drawing(plane, rng, margin_mm, None, collision_buffer_mm) for _ in range(2))
    ends = [start.all(), goal.all()]
    settings = PlanSettings(collision_buffer_mm=collision_buffer_mm)
    for row in map(int, np.flatnonzero(start.near_obstacles() & ~plane.offline)):
        for attempt in range(_REDRAWS):
            if _passes_alone(plane, row, ends[0], ends[1], settings):
                break
            which = attempt % 2  # the pocket may be at either end
            ends[1 - which][row] = (goal, start)[which].draw(row)
        else:
            raise InputError(f"positioner {plane.positioner_id[row]}: found no way for it alone")
    return ends[0], ends[1]


def _passes_alone(
    plane: FocalPlane, row: int, start_deg: Floats, goal_deg: Floats, settings: PlanSettings
) -> bool:
    alone = plane.select([row])
    return not plan(alone, start_deg[[row]], goal_deg[[row]], settings=settings).refused


class _Drawing:
    """Positioners placed so far, and room for the next."""

    def __init__(
        self,
        plane: FocalPlane,
        rng: np.random.Generator,
        margin_mm: float,
        approach_deg: float | None,
        collision_buffer_mm: float | None,
    ) -> None:
        self.plane, self.rng = plane, rng
        bodies = CollisionBodies.of(plane, collision_buffer_mm)
        # half of the margin between two arms is each one's own; an obstacle has none
        self.pairs, self.alone = bodies.wider(margin_mm / 2).compiled, bodies.wider(margin_mm).compiled
        self.obstacles = bodies.obstacles
        self.approach = beside(plane, approach_rad(plane, approach_deg).max(initial=0.0)).tolist()
        self.angles = deg_to_rad(plane.offline_position_deg)
        self.placed = plane.offline.copy()

    def near_obstacles(self) -> Flags:
        """(N,) which can touch a fiducial or guide camera."""
        n, k = self.plane.n, len(self.obstacles)
        points = np.repeat(np.tile(self.plane.centres_mm, (1, 2)), k, axis=0)
        lines = np.tile(self.obstacles[:, :4], (n, 1))
        gaps = geometry.segment_distance(points, lines).reshape(n, k) - self.obstacles[:, 4]
        return np.asarray((self.plane.body_reach_mm + 1.0 > gaps.T).any(axis=0), dtype=np.bool_)

    def all(self) -> Floats:
        """All in random order; one without room displaces a neighbour, which is drawn anew."""
        waiting = list(map(int, self.rng.permutation(np.flatnonzero(~self.plane.offline))))
        for _ in range(_DISPLACED * self.plane.n):
            if not waiting:
                return rad_to_deg(self.angles)
            row = waiting.pop()
            if not self._place(row):
                displaced = self._displace_neighbour(row)
                waiting = [row, *waiting] if displaced is None else [displaced, *waiting, row]
        raise InputError(f"found no room for positioner {self.plane.positioner_id[waiting[-1]]}")

    def draw(self, row: int) -> Floats:
        """A new free place for one positioner, in deg."""
        self.placed[row] = False
        if not self._place(row):
            raise InputError(f"positioner {self.plane.positioner_id[row]}: found no free place")
        return rad_to_deg(self.angles[row])

    def _placed_near(self, row: int) -> Ints:
        """Rows that have a place and can touch this one, nearest first."""
        gaps = np.hypot(*(self.plane.centres_mm - self.plane.centres_mm[row]).T)
        near = np.flatnonzero(self.placed & (gaps < 2.0 * self.plane.body_reach_mm.max() + 1.0))
        return near[np.argsort(gaps[near], kind="stable")]

    def _place(self, row: int) -> bool:
        near = self._placed_near(row)
        for _ in range(_DRAWS):
            angles = self._anywhere(row)
            if self._free(row, angles, near):
                self.angles[row], self.placed[row] = angles, True
                return True
        return False

    def _displace_neighbour(self, row: int) -> int | None:
        near = [int(k) for k in self._placed_near(row)[:6] if not self.plane.offline[k]]
        if not near:
            return None
        chosen = int(self.rng.choice(near))
        self.placed[chosen] = False
        return chosen

    def _anywhere(self, row: int) -> Floats:
        l_alpha = self.plane.l_alpha_mm[row]
        l_beta = float(self.plane.l_beta_mm[row])
        low, high = deg_to_rad(self.plane.limits_of(np.array([row]))[0]).T
        inner, outer = abs(l_alpha - l_beta), l_alpha + l_beta
        while True:
            reach2 = self.rng.uniform(inner**2, outer**2)
            cosine = (reach2 - l_alpha**2 - l_beta**2) / (2.0 * l_alpha * l_beta)
            alpha, elbow = self.rng.uniform(low[0], high[0]), np.arccos(cosine)
            beta = [b for b in (elbow, -elbow, 2.0 * np.pi - elbow) if low[1] <= b <= high[1]]
            if beta:
                return np.array([alpha, beta[0] if len(beta) == 1 else self.rng.choice(beta)])

    def _free(self, row: int, angles: Floats, near: Ints) -> bool:
        if not core.static_ok(self.alone, np.array([row]), angles[None], self.approach)[0]:
            return False
        rows, places = np.full(len(near), row), np.repeat(angles[None], len(near), axis=0)
        clear = core.pairs_clear(
            self.pairs,
            rows,
            places,
            near,
            self.angles[near],
            self.approach,
        )
        return bool(clear.all())
