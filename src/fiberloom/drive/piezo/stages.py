"""What each cobra does in the next iteration, so that none can meet another.

A cobra that has to turn theta does so with phi folded so far that its arm stays in its own territory,
whatever theta does. Then it goes out along phi. What it may sweep is checked against what its neighbours
may (`swept`); who cannot go takes a shorter way, or waits for the next iteration.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple, Protocol

import numpy as np

from fiberloom.drive.piezo.cobras import CobraArms
from fiberloom.drive.piezo.scatter import SIGMAS
from fiberloom.drive.piezo.swept import MARGIN_MM, SweptCheck, box_of
from fiberloom.drive.piezo.ways_out import ROOM_DEG as ROOM_BEYOND_DEG
from fiberloom.drive.piezo.ways_out import ROOM_OF_SCATTER_DEG, leg_share
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import rad_to_deg

THETA, PHI = 0, 1


class CobraStage(IntEnum):
    """What a cobra does, the best first."""

    GOAL = 0
    """To its goal."""
    MOST = 1
    """Theta to its goal, phi a part of its way: of a wild one so much that its tube keeps within its room."""
    HALF = 2
    LITTLE = 3
    TURN = 4
    """Theta to its goal within the territory, phi folded before where it is out."""
    FOLD = 5
    """Phi into the territory."""
    STAY = 6


FAR_DEG = 5.0
"""A cobra whose phi lacks more has still to go out."""
ASIDE_DEG = (0.0, 15.0, -15.0, 30.0, -30.0, 45.0, -45.0, 60.0, -60.0)
"""By which theta may be turned aside while phi goes out."""
ROOM_DEG = 2.0
"""Around such ways, for what motors miss: less would be found free and then be blocked."""
TURN_DEG = 30.0
"""A cobra whose theta lacks more has still to turn."""
INWARD = np.linspace(0.0, 1.0, 19) ** 2
"""From the most open phi of a turn inwards: the first whose tube stays within the territory is taken."""
SPREAD_WAY_DEG, SPREAD_DIGITS = 20.0, 1
"""Motors are compared by what they miss in such a way, in tenths of a degree: nearer ones are equals."""
SHARES = (1.0, 0.65, 0.4, 0.2)
"""Of phi's way, for the first stages."""
MOST_WILD = 0.8
"""At most the second of them, of a motor whose tube would not keep within its room."""


class Motors(Protocol):
    """What is known of 2 n motors: rows theta, phi, theta, ..."""

    place_deg: Floats | None
    """(M,) where they are believed to be."""
    place_variance: Floats
    """(M,) deg^2."""

    def limited_deg(self, way_deg: Floats) -> Floats:
        """(M,) ways in deg as far as one move goes."""
        ...

    def aimed_deg(self, way_deg: Floats) -> Floats:
        """(M,) the part of ways in deg to aim at so that least is left of them."""
        ...

    def tube_deg(self, way_deg: Floats, sigmas: float) -> Floats:
        """(M,) deg that ways (M,) miss their ends by, but for as rarely as normal ones by `sigmas`."""
        ...


@dataclass(frozen=True)
class StageSettings:
    """How careful moves are."""

    sigmas: float = SIGMAS
    """Half of a tube, in standard deviations of where a move ends."""
    least_share: float = 0.05
    """The same, of the way: no motor is believed to be better."""
    direct_deg: float = 60.0
    """[A] A cobra whose theta may end farther off than this turns it first, within its territory."""
    dot_margin_mm: float = 0.1
    """A fibre that turns stays so far from its dot."""
    margin_mm: float = MARGIN_MM
    """Between territories."""


class Chosen(NamedTuple):
    """One iteration of n cobras."""

    stage: Ints
    """(n,) CobraStage."""
    target_deg: Floats
    """(n, 2) to move to; where they are for one that stays."""
    phi_first: Flags
    """(n,) theta waits until phi has ended; else phi waits for theta."""
    boxes_deg: Floats
    """(n, 2, 2, 2) what each may sweep: two boxes of theta and phi, from low to high."""


@dataclass(frozen=True, eq=False)
class _Option:
    target_deg: Floats
    phi_first: Flags
    boxes_deg: Floats
    may: Flags


@dataclass(eq=False)
class Stages:
    """Chooses stages for n cobras among fixed discs."""

    arms: CobraArms
    check: SweptCheck
    settings: StageSettings = field(default_factory=StageSettings)
    dots_mm: Floats | None = None
    """(n, 3) x, y, radius in mm of the dot of each; None: there are none."""

    def __post_init__(self) -> None:
        self.phi_in_deg = self.arms.phi_within_deg(self.check.territory_mm(self.settings.margin_mm))

    @classmethod
    def of(
        cls,
        arms: CobraArms,
        discs_mm: Floats,
        settings: StageSettings | None = None,
        dots_mm: Floats | None = None,
    ) -> Stages:
        """`arms` of n cobras; `discs_mm` (m, 3): x, y, radius of what stands between them; `settings`;
        `dots_mm` (n, 3): x, y, radius of the dot of each."""
        return cls(arms, SweptCheck.of(arms, discs_mm), settings or StageSettings(), dots_mm)

    def touching(self, goal_deg: Floats) -> Ints:
        """(t, 2) pairs of rows that would touch at their goals (n, 2) in deg; a disc is a row beyond n."""
        boxes = box_of(goal_deg, goal_deg)[:, None]
        found: Ints = self.check.pairs[self.check.meeting(boxes, boxes)]
        return found

    def out_freely(self, theta_deg: Floats, within_deg: float) -> Flags:
        """(n,) cobras that touch no disc whatever phi does, with theta `within_deg` of `theta_deg` (n,)."""
        low = np.column_stack([theta_deg - within_deg, np.zeros(len(theta_deg))])
        high = np.column_stack([theta_deg + within_deg, self.arms.range_deg[:, PHI]])
        boxes = box_of(low, high)[:, None]
        discs = np.flatnonzero(self.check.pairs[:, 1] >= self.check.cobras)
        free = np.ones(len(theta_deg), dtype=bool)
        free[self.check.pairs[discs[self.check.meeting(boxes, boxes, discs)], 0]] = False
        return free

    def choose(self, motors: Motors, goal_deg: Floats, active: Flags, seed: int = 0) -> Chosen:
        """The next iteration.

        `motors`: what is known of them; `goal_deg` (n, 2): angles wanted; `active` (n,): cobras that shall
        move; `seed`: decides between equals.
        """
        assert motors.place_deg is not None
        far = active & (np.abs(goal_deg - _by_cobra(motors.place_deg))[:, PHI] > FAR_DEG)
        goal_deg = np.where(far[:, None], self._approach(goal_deg, active), goal_deg)
        options = self._options(motors, goal_deg)
        waits = self._waits(goal_deg, far) | self._lets_turn(motors, goal_deg, active)
        for out in options[: len(SHARES)]:
            out.may[waits] = False
        rank = self._rank(motors, seed)
        stage = self._agree(options, np.where(active, CobraStage.GOAL, CobraStage.STAY), goal_deg, rank)
        stage = self._promote(options, stage, active, rank)
        stage = self._make_way(options, stage, far, goal_deg, rank)
        rows = np.arange(len(stage))
        return Chosen(
            stage,
            np.stack([o.target_deg for o in options])[stage, rows],
            np.stack([o.phi_first for o in options])[stage, rows],
            np.stack([o.boxes_deg for o in options])[stage, rows],
        )

    def _rank(self, motors: Motors, seed: int) -> Ints:
        """(n,) who goes first of two that could meet: whose motors scatter more, since it needs more moves.

        `seed` decides between equals.
        """
        n = self.check.cobras
        spread = _by_cobra(motors.tube_deg(np.full(2 * n, SPREAD_WAY_DEG), 1.0)).max(axis=1)
        order = np.lexsort((np.random.default_rng(seed).random(n), -np.round(spread, SPREAD_DIGITS)))
        rank = np.empty(n, dtype=np.int64)
        rank[order] = np.arange(n)
        return rank

    # options

    def _options(self, motors: Motors, goal_deg: Floats) -> list[_Option]:
        """One for each CobraStage."""
        assert motors.place_deg is not None
        here, doubt = _by_cobra(motors.place_deg), np.sqrt(_by_cobra(motors.place_variance))
        way = self._limited(motors, _by_cobra(motors.aimed_deg((goal_deg - here).ravel())))
        turn, turns_safely = self._turn(motors, here, goal_deg)
        fold = np.column_stack([here[:, THETA], turn[:, PHI]])
        inside, always = self.inside(here, doubt), np.ones(len(here), dtype=bool)
        # who folds does so first, who goes out last
        out = [
            self._option(motors, here, here + way * np.column_stack([always, share]), way[:, PHI] < 0.0)
            for share in self._shares(motors, goal_deg - here, way)
        ]
        options = [
            *out,
            self._option(motors, here, turn, ~inside),
            self._option(motors, here, fold, always),
            self._option(motors, here, here, always),
        ]
        direct = self._tube(motors, way)[:, THETA] <= self.settings.direct_deg
        for option in out:
            option.may[:] = direct
        # who is out and has still to go far may fold where the way is barred
        folds = ~direct | (np.abs(goal_deg - here) > FAR_DEG).any(axis=1)
        options[CobraStage.TURN].may[:] = turns_safely & (inside | folds)
        options[CobraStage.FOLD].may[:] = ~inside & folds
        return options

    def _shares(self, motors: Motors, left: Floats, way: Floats) -> list[Floats]:
        """(n,) of the way of phi, for each of SHARES; `left` (n, 2) deg to the goal, `way` (n, 2) of it."""
        one_way = np.full(way.shape, ROOM_OF_SCATTER_DEG / self.settings.sigmas)
        room = np.maximum(self._tube(motors, one_way)[:, PHI], ROOM_BEYOND_DEG)
        left, told, tube = (np.abs(a)[:, PHI] for a in (left, way, self._tube(motors, way)))
        within = leg_share(left, told, tube, room)
        shares = [np.full(len(way), share) for share in SHARES]
        shares[CobraStage.MOST] = np.where(
            within < 1.0, np.minimum(within, MOST_WILD), SHARES[CobraStage.MOST]
        )
        return shares

    def _option(self, motors: Motors, here: Floats, target: Floats, phi_first: Flags) -> _Option:
        """Boxes of both legs: the first motor moves, then the second."""
        start = self.settings.sigmas * np.sqrt(_by_cobra(motors.place_variance))
        ends = self._tube(motors, target - here)
        top = self.arms.range_deg
        around = box_of(np.clip(here - start, 0.0, top), np.clip(here + start, 0.0, top))
        after = box_of(np.clip(target - ends, 0.0, top), np.clip(target + ends, 0.0, top))
        way = np.stack(
            [np.minimum(around[..., 0], after[..., 0]), np.maximum(around[..., 1], after[..., 1])], 2
        )
        first, second = np.empty((2, len(here), 2, 2))
        # what moves first: its way, at the other's start; what moves second: its way, at the first's end
        first[:, THETA] = np.where(phi_first[:, None], around[:, THETA], way[:, THETA])
        first[:, PHI] = np.where(phi_first[:, None], way[:, PHI], around[:, PHI])
        second[:, THETA] = np.where(phi_first[:, None], way[:, THETA], after[:, THETA])
        second[:, PHI] = np.where(phi_first[:, None], after[:, PHI], way[:, PHI])
        boxes = np.stack([first, second], axis=1)
        return _Option(target, phi_first, boxes, np.ones(len(here), dtype=bool))

    def _turn(self, motors: Motors, here: Floats, goal: Floats) -> tuple[Floats, Flags]:
        """Targets (n, 2): theta at its goal, phi as near to it as the territory allows; where that holds."""
        most = np.minimum(self.phi_in_deg, self._short_of_dot_deg(motors, here, goal))
        low = -0.5 * self.arms.range_deg[:, PHI]
        safe, seen, end = np.zeros(len(here), dtype=bool), np.zeros(len(here), dtype=bool), here.copy()
        for share in INWARD:  # into the stop and beyond, where that is what it takes: the stop holds
            target = np.column_stack([goal[:, THETA], np.minimum(goal[:, PHI], most)])
            target[:, PHI] += share * (low - target[:, PHI])
            way = self._limited(motors, target - here)
            top = np.clip((here + way + self._tube(motors, way))[:, PHI], 0.0, None)
            shows, stays = top <= most + 1e-6, top <= self.phi_in_deg + 1e-6
            # a fibre behind its dot is no danger: a turn within the territory is better than none
            better = (shows & ~seen) | ~safe
            end[better] = (here + way)[better]
            safe, seen = safe | stays, seen | shows
        return end, safe

    def _short_of_dot_deg(self, motors: Motors, here: Floats, goal: Floats) -> Floats:
        """(n,) the most open phi in deg at which a fibre is seen, where theta may end at its dot."""
        if self.dots_mm is None:
            return self.arms.range_deg[:, PHI]
        off = self.dots_mm[:, :2] - self.arms.centre_mm
        far, radius = np.hypot(*off.T), self.dots_mm[:, 2] + self.settings.dot_margin_mm
        short = self.arms.phi_within_deg(np.maximum(far - radius, 0.0))
        way = self._limited(motors, np.column_stack([goal[:, THETA] - here[:, THETA], 0.0 * far]))
        ends = (here + way)[:, THETA]
        # the fibre stands off the first link by about half of phi
        fibre = (
            ends
            + self.arms.zero_deg[:, THETA]
            + 0.5 * self.arms.fibre_deg(np.stack([ends, short], 1))[:, PHI]
        )
        beside = np.abs((fibre - rad_to_deg(np.arctan2(off[:, 1], off[:, 0])) + 180.0) % 360.0 - 180.0)
        wide = rad_to_deg(np.arcsin(np.minimum(radius / np.maximum(far, radius), 1.0)))
        clear = beside > wide + self._tube(motors, way)[:, THETA] + 0.5 * self.phi_in_deg
        return np.where(clear, self.arms.range_deg[:, PHI], short)

    def _limited(self, motors: Motors, way: Floats) -> Floats:
        return _by_cobra(motors.limited_deg(way.ravel()))

    def _tube(self, motors: Motors, way: Floats) -> Floats:
        """(n, 2) deg beside where ways (n, 2) end, half a tube."""
        doubt = _by_cobra(motors.tube_deg(way.ravel(), self.settings.sigmas))
        return np.maximum(doubt, self.settings.least_share * np.abs(way))

    def inside(self, here: Floats, doubt: Floats) -> Flags:
        """(n,) cobras within their territories, at (n, 2) deg from the stops, known to `doubt` (n, 2)."""
        inside: Flags = here[:, PHI] + self.settings.sigmas * doubt[:, PHI] <= self.phi_in_deg
        return inside

    def _approach(self, goal: Floats, active: Flags) -> Floats:
        """Goals (n, 2) in deg with theta turned aside where phi could not go out past a neighbour's goal.

        From there theta turns to its goal once phi is out. As little aside as keeps clear of all neighbours
        where they will be; as it is where no way does.
        """
        ends, found = box_of(goal - ROOM_DEG, goal + ROOM_DEG)[:, None], np.zeros(len(goal))
        tries = active & (goal[:, PHI] > self.phi_in_deg)
        i, j = self.check.pairs.T
        for aside in ASIDE_DEG:
            turned = np.clip(goal[:, THETA] + aside, 0.0, self.arms.range_deg[:, THETA])
            near = np.flatnonzero(
                np.append(tries, np.zeros(len(self.check.arms) - len(goal), bool))[self.check.pairs].any(
                    axis=1
                )
            )
            ways = self._ways_aside(goal, turned)
            meets = np.zeros(len(self.check.arms), dtype=bool)
            meets[i[near[self.check.meeting(ways, ends, near)]]] = True
            meets[j[near[self.check.meeting(ends, ways, near)]]] = True
            free = tries & ~meets[: len(goal)]
            found[free] = (turned - goal[:, THETA])[free]
            tries &= ~free
        return goal + np.column_stack([found, np.zeros(len(goal))])

    def _ways_aside(self, goal: Floats, turned: Floats) -> Floats:
        """(n, 2, 2, 2) boxes: phi out with theta at `turned` (n,), then theta to its goal."""
        phi_in = np.minimum(self.phi_in_deg, goal[:, PHI])
        out = box_of(np.column_stack([turned, phi_in]), np.column_stack([turned, goal[:, PHI]]))
        across = box_of(np.column_stack([turned, goal[:, PHI]]), goal)
        ways = np.stack([out, across], axis=1)
        ways[..., 0] -= ROOM_DEG
        ways[..., 1] += ROOM_DEG
        return ways

    # agreement

    def _waits(self, goal: Floats, far: Flags) -> Flags:
        """(n,) cobras that would stand in the way out of a neighbour that is `far` (n,) from its goal."""
        way_out = box_of(np.column_stack([goal[:, THETA], np.minimum(self.phi_in_deg, goal[:, PHI])]), goal)
        ends = box_of(goal, goal)
        i, j = self.check.pairs.T
        first_i = self.check.meeting(way_out[:, None], ends[:, None])
        first_j = self.check.meeting(ends[:, None], way_out[:, None])
        waits, far = (
            np.zeros(len(self.check.arms), dtype=bool),
            np.append(far, np.zeros(len(self.check.arms), bool)),
        )
        waits[j[first_i & ~first_j & far[i]]] = True
        waits[i[first_j & ~first_i & far[j]]] = True
        return waits[: self.check.cobras]

    def _lets_turn(self, motors: Motors, goal: Floats, active: Flags) -> Flags:
        """(n,) cobras that would stand in the way of a neighbour that has still to turn theta."""
        assert motors.place_deg is not None
        here = _by_cobra(motors.place_deg)
        turns = active & (np.abs(goal - here)[:, THETA] > TURN_DEG)
        reach = np.minimum(goal[:, PHI], self.phi_in_deg)
        sweep = box_of(
            np.column_stack([here[:, THETA], 0.0 * reach]), np.column_stack([goal[:, THETA], reach])
        )
        sweep[:, THETA] += np.array([-ROOM_DEG, ROOM_DEG])
        ends = box_of(goal, goal)
        i, j = self.check.pairs.T
        turning = np.append(turns, np.zeros(len(self.check.arms) - len(goal), dtype=bool))
        lets = np.zeros(len(turning), dtype=bool)
        for own, other, flip in ((i, j, False), (j, i, True)):
            near = np.flatnonzero(turning[own])
            pair = (ends, sweep) if flip else (sweep, ends)
            lets[other[near[self.check.meeting(pair[0][:, None], pair[1][:, None], near)]]] = True
        return lets[: len(goal)]

    def _make_way(self, options: list[_Option], stage: Ints, far: Flags, goal: Floats, rank: Ints) -> Ints:
        """Of two that stand in each other's way the one that is out folds."""
        goes, stands = options[CobraStage.GOAL].boxes_deg, options[CobraStage.STAY].boxes_deg
        stuck = np.append(far & (stage == CobraStage.STAY), np.zeros(len(self.check.arms), dtype=bool))
        i, j = self.check.pairs.T
        both = np.flatnonzero(stuck[i] & stuck[j])
        in_way_j = self.check.meeting(goes, stands, both)
        in_way_i = self.check.meeting(stands, goes, both)
        out = _by_cobra(options[CobraStage.STAY].target_deg)[:, PHI] > self.phi_in_deg
        i, j = i[both], j[both]
        in_way_i, in_way_j = in_way_i & out[i], in_way_j & out[j]
        yields_i = in_way_i & (~in_way_j | (rank[i] > rank[j]))
        yields = np.concatenate([i[yields_i], j[in_way_j & ~yields_i]])
        if len(yields) == 0:
            return stage
        options[CobraStage.FOLD].may[yields] = True
        stage = stage.copy()
        stage[yields] = CobraStage.FOLD
        return self._agree(options, stage, goal, rank)

    def _agree(self, options: list[_Option], stage: Ints, goal: Floats, rank: Ints) -> Ints:
        """Stages (n,) of which no two can meet, but for those that stand."""
        may = np.stack([o.may for o in options])
        boxes = np.stack([o.boxes_deg for o in options])
        stage = _next_that_may(stage, may)
        rows, open_ = np.arange(len(stage)), np.arange(len(self.check.pairs))
        while len(open_):
            now = boxes[stage, rows]
            meets = open_[self.check.meeting(now, now, open_)]
            losers = self._losers(meets, stage, now, goal, rank)
            if len(losers) == 0:
                return stage
            stage[losers] = _next_that_may(stage + 1, may)[losers]
            changed = np.zeros(len(self.check.arms), dtype=bool)
            changed[losers] = True
            open_ = np.flatnonzero(changed[self.check.pairs].any(axis=1))
        return stage

    def _promote(self, options: list[_Option], stage: Ints, active: Flags, rank: Ints) -> Ints:
        """Cobras that gave way to one that gave way itself take a better option that is free now."""
        stage, n = stage.copy(), self.check.cobras
        boxes, rows = np.stack([o.boxes_deg for o in options]), np.arange(n)
        order = np.append(rank, np.full(len(self.check.arms) - n, n))
        for level in range(CobraStage.STAY):
            tries = np.append(active & (stage > level) & options[level].may, np.zeros(len(order) - n, bool))
            i, j = self.check.pairs.T
            near = np.flatnonzero(tries[i] | tries[j])
            now = boxes[stage, rows]
            better = np.where(tries[:n, None, None, None], boxes[level], now)
            # each against its neighbours as they are, then those that try against one another
            blocked = np.zeros(len(order), dtype=bool)
            blocked[i[near[self.check.meeting(better, now, near)]]] = True
            blocked[j[near[self.check.meeting(now, better, near)]]] = True
            goes = tries & ~blocked
            both = np.flatnonzero(goes[i] & goes[j])
            met = both[self.check.meeting(better, better, both)]
            goes[np.where(order[i[met]] < order[j[met]], j[met], i[met])] = False
            stage[goes[:n]] = level
        return stage

    def _losers(self, meets: Ints, stage: Ints, now: Floats, goal: Floats, rank: Ints) -> Ints:
        """Rows that take their next option: one of each pair that could meet."""
        i, j = self.check.pairs[meets].T
        n = self.check.cobras
        kind = np.concatenate([stage, np.full(len(self.check.arms) - n, CobraStage.STAY)])
        order = np.concatenate([rank, np.full(len(self.check.arms) - n, n)])
        ends = box_of(goal, goal)[:, None]
        # the one that would sweep where the other ends has to go before it
        blocked_j = self.check.meeting(ends, now, meets)
        blocked_i = self.check.meeting(now, ends, meets)
        i_wins = order[i] < order[j]
        i_wins = np.where(blocked_i != blocked_j, blocked_i, i_wins)
        turns_i, turns_j = _turns(kind[i]), _turns(kind[j])
        i_wins = np.where(turns_i != turns_j, turns_i, i_wins)
        stands_i, stands_j = kind[i] == CobraStage.STAY, kind[j] == CobraStage.STAY
        i_wins = np.where(stands_i != stands_j, stands_i, i_wins)
        losers = np.where(i_wins, j, i)[~(stands_i & stands_j)]
        return np.unique(losers)


def _turns(kind: Ints) -> Flags:
    turns: Flags = (kind == CobraStage.TURN) | (kind == CobraStage.FOLD)
    return turns


def _by_cobra(values: Floats) -> Floats:
    return values.reshape(-1, 2)


def _next_that_may(stage: Ints, may: Flags) -> Ints:
    """(n,) the first of the stages from `stage` on that is open to each."""
    later = np.arange(len(may))[:, None] >= np.minimum(stage, CobraStage.STAY)
    found: Ints = np.argmax(later & may, axis=0)
    return found
