"""Which spot belongs to which positioner, in the focal plane.

Nearest-neighbour rules give a dark positioner the spot of another, and a positioner that did not
move none. Here every pair has a price, minus the logarithm of a probability:

    as expected          d^2 / (2 s^2) + log(2 pi s^2)      d: spot from expected position
    stayed where it was  the same from there, less log of the share that stays
    anywhere in reach    log(area of the reach), less log of the share that goes astray
    dark                 less log of the share that is dark
    stray spot           less log of the density of stray spots

First the pairs are peeled that leave no doubt: each the other's only neighbour within `sure_mm`.
How many of the rest are strays is estimated from where they lie: strays are everywhere, spots of
positioners only where a positioner without a spot can reach. The rest falls into small groups
linked by reach; each is assigned as cheaply as possible, and for each pair the next best assignment
without it says how far it can be trusted: it is wrong with probability 1 / (1 + exp(doubt)). The
surest pairs are believed until the expected number of wrong ones in the image reaches
`wrong_pairs`; the others are ambiguous, and their positioners not seen. No positioner is moved by a guess.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fiberloom.errors import InputError
from fiberloom.timing import part
from fiberloom.typing import Flags, Floats, Ints

_NEVER = 1e6
"""Price of a pair that cannot be."""
_DARK_DOUBT = 0.05
"""A positioner is called dark, not ambiguous, below this probability of having a spot after all."""
_LARGE_GROUP = 60
"""Positioners in one group: beyond it nothing can be told apart, and nothing is guessed."""


class MatchStatus(IntEnum):
    """What is known of a positioner's spot."""

    MATCHED = 0
    DARK = 1
    """No spot that could be its own."""
    AMBIGUOUS = 2
    """Spots, but it cannot be told which one, or whether one at all."""


@dataclass(frozen=True)
class MatchSettings:
    """What is thought possible before the image is seen. Shares are of the positioners."""

    sigma_mm: float = 0.08
    """Scatter of a positioner about where it is expected, per coordinate."""
    sure_mm: float = 0.25
    """Spot and expected position nearer than this, with no other near, are a pair."""
    alone_mm: float = 0.5
    """... no other within this distance ..."""
    clear_ratio: float = 2.5
    """... nor within this many times their own."""
    stayed_share: float = 0.02
    """Share of the positioners that did not move when told to."""
    reach_margin_mm: float = 0.3
    """Reach of the arms counts this much larger: calibrations and measurements err."""
    wrong_pairs: float = 0.05
    """Expected number of wrong pairs in one image that is tolerated, among those not beyond doubt."""


@dataclass(frozen=True)
class Match:
    """Positioners to spots."""

    spot: Ints
    """(N,) index of the spot; -1 where dark or ambiguous."""
    status: NDArray[np.int8]
    """(N,) MatchStatus."""
    stray: Ints
    """Indices of spots that belong to no positioner, or to an unknown one."""

    @property
    def matched(self) -> Flags:
        """(N,) which positioners have a spot."""
        matched: Flags = self.status == MatchStatus.MATCHED
        return matched


@part("matching")
def match_spots(
    spots_mm: ArrayLike,
    expected_mm: ArrayLike,
    centres_mm: ArrayLike,
    reach_mm: ArrayLike,
    *,
    previous_mm: ArrayLike | None = None,
    settings: MatchSettings | None = None,
) -> Match:
    """Match n spots `spots_mm` (n, 2) to N positioners.

    `expected_mm` (N, 2): where each should be; NaN: anywhere in its reach. `reach_mm` (N, 2): inner and
    outer radius round `centres_mm`. `previous_mm` (N, 2): where each was seen last; NaN where not.
    `settings`: probabilities and errors. Positioners without any knowledge and without spots are dark.
    """
    s = settings or MatchSettings()
    spots, expected, centres = (np.asarray(a, float) for a in (spots_mm, expected_mm, centres_mm))
    reach = np.broadcast_to(np.asarray(reach_mm, float), (len(centres), 2))
    if expected.shape != centres.shape or spots.ndim != 2 or spots.shape[1] != 2:
        raise InputError("matching: spots (n, 2), expected positions and centres (N, 2) in mm")
    previous = np.full_like(expected, np.nan) if previous_mm is None else np.asarray(previous_mm)
    spot = _peel(spots, expected, s)
    status = np.where(spot >= 0, MatchStatus.MATCHED, MatchStatus.DARK).astype(np.int8)
    problem = _Problem(spots, expected, previous, centres, reach, s)
    problem.solve_rest(spot, status)
    claimed = np.zeros(len(spots), dtype=bool)
    claimed[spot[spot >= 0]] = True
    return Match(spot, status, np.flatnonzero(~claimed))


def _peel(spots: Floats, expected: Floats, s: MatchSettings) -> Ints:
    """Pairs beyond doubt: (N,) spot index or -1."""
    out = np.full(len(expected), -1, dtype=np.int64)
    known = np.flatnonzero(np.isfinite(expected).all(axis=1))
    if not len(known) or not len(spots):
        return out
    to_spot, spot = _two_nearest(cKDTree(spots), expected[known])
    to_owner, owner = _two_nearest(cKDTree(expected[known]), spots)
    first = spot[:, 0]
    mutual = (first < len(spots)) & (owner[first.clip(max=len(spots) - 1), 0] == range(len(known)))
    distance = to_spot[:, 0]
    room = np.maximum(s.clear_ratio * distance, s.alone_mm)
    alone = (to_spot[:, 1] > room) & (to_owner[first.clip(max=len(spots) - 1), 1] > room)
    sure = mutual & alone & (distance < s.sure_mm)
    out[known[sure]] = first[sure]
    return out


def _two_nearest(tree: cKDTree, points: Floats) -> tuple[Floats, Ints]:
    distance, index = tree.query(points, k=2)
    return distance, index.astype(np.int64)


@dataclass(frozen=True)
class _Guess:
    """A positioner that was not beyond doubt: its cheapest spot (-1 dark), and by how much."""

    row: int
    spot: int
    doubt: float
    """Price of the next best assignment, less that of the best."""

    @property
    def wrong(self) -> float:
        """Probability that the guess is wrong."""
        return float(1.0 / (1.0 + np.exp(min(self.doubt, 700.0))))


class _Problem:
    """What peeling left: spots and positioners linked by reach."""

    def __init__(
        self,
        spots: Floats,
        expected: Floats,
        previous: Floats,
        centres: Floats,
        reach: Floats,
        s: MatchSettings,
    ) -> None:
        self.spots, self.expected, self.previous = spots, expected, previous
        self.centres, self.reach, self.s = centres, reach, s
        self.area_mm2 = np.pi * (reach[:, 1] ** 2 - reach[:, 0].clip(min=0) ** 2)

    def solve_rest(self, spot: Ints, status: NDArray[np.int8]) -> None:
        """Fills `spot` and `status` of the positioners that have none yet."""
        rows = np.flatnonzero(spot < 0)
        columns = np.setdiff1d(np.arange(len(self.spots)), spot[spot >= 0])
        if not len(rows) or not len(columns):
            return
        p, k = self._links(rows, columns)
        if not len(p):
            return
        self._take_stock(rows, columns, len(np.unique(k)))
        guesses: list[_Guess] = []
        for some_rows, some_columns in _groups(rows, columns, p, k):
            if len(some_rows) > _LARGE_GROUP:
                status[some_rows] = MatchStatus.AMBIGUOUS
            elif len(some_rows) and len(some_columns):
                guesses += self._solve_group(some_rows, some_columns)
        self._believe(guesses, spot, status)

    def _believe(self, guesses: list[_Guess], spot: Ints, status: NDArray[np.int8]) -> None:
        tolerated = self.s.wrong_pairs
        for guess in sorted(guesses, key=lambda g: (-g.doubt, g.row)):
            if guess.spot < 0:
                sure = guess.wrong < _DARK_DOUBT
                status[guess.row] = MatchStatus.DARK if sure else MatchStatus.AMBIGUOUS
                continue
            tolerated -= guess.wrong
            status[guess.row] = MatchStatus.MATCHED if tolerated >= 0 else MatchStatus.AMBIGUOUS
            if tolerated >= 0:
                spot[guess.row] = guess.spot

    def _take_stock(self, rows: Ints, columns: Ints, n_within: int) -> None:
        """How many of the free spots are strays, how many of the free positioners dark or astray.

        Strays lie in reach of a free positioner as often as any point of the field does.
        """
        field, covered = self._field_area_mm2(rows)
        inside = self._reached(self.spots[columns], np.arange(len(self.centres)))
        n_field = int(inside.sum())
        outside = max(n_field - n_within, 0)
        clear = max(1.0 - covered, 0.05)
        # one more than seen, and the scatter of a count: better too many strays than too few
        strays = min((outside + 1.0 + np.sqrt(outside)) / clear, n_field + 1.0)
        astray = np.clip(n_within - covered * strays, 0.5, len(rows))
        n = len(self.centres)
        self.stray_price = -np.log(strays / field)
        self.astray_share = float(astray) / n
        self.dark_share = max(len(rows) - float(astray), 0.5) / n

    def _field_area_mm2(self, rows: Ints) -> tuple[float, float]:
        """Area in reach of anybody, and the share of it in reach of `rows`: on a grid of points."""
        low = self.centres.min(axis=0) - self.reach[:, 1].max()
        high = self.centres.max(axis=0) + self.reach[:, 1].max()
        step = max(float(np.sqrt(np.prod(high - low) / 20000)), 1e-6)
        axes = [np.arange(a + 0.5 * step, b, step) for a, b in zip(low, high, strict=True)]
        grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        anybody = self._reached(grid, np.arange(len(self.centres)))
        covered = self._reached(grid[anybody], rows).mean() if anybody.any() else 1.0
        return max(float(anybody.sum()), 1.0) * step**2, float(covered)

    def _reached(self, points: Floats, rows: Ints) -> Flags:
        """Which points are in the outer reach of one of these positioners."""
        radius = float(self.reach[rows, 1].max()) + self.s.reach_margin_mm
        distance, _ = cKDTree(self.centres[rows]).query(points, distance_upper_bound=radius)
        near: Flags = np.isfinite(distance)
        return near

    def _links(self, rows: Ints, columns: Ints) -> tuple[Ints, Ints]:
        """Pairs (index into rows, index into columns) inside reach."""
        near = cKDTree(self.centres[rows]).query_ball_point(
            self.spots[columns], self.reach[rows, 1].max() + self.s.reach_margin_mm
        )
        k = np.repeat(np.arange(len(columns)), [len(n) for n in near])
        p = np.concatenate([np.asarray(n, dtype=np.int64) for n in near])
        radius = np.hypot(*(self.spots[columns[k]] - self.centres[rows[p]]).T)
        inside = self._inside(radius, rows[p])
        return p[inside], k[inside].astype(np.int64)

    def _inside(self, radius_mm: Floats, rows: Ints) -> Flags:
        low, high = self.reach[rows].T
        margin = self.s.reach_margin_mm
        within: Flags = (radius_mm > low - margin) & (radius_mm < high + margin)
        return within

    def _prices(self, rows: Ints, columns: Ints) -> Floats:
        """(rows, columns): what it costs that this spot is this positioner's."""
        delta = self.spots[columns][:, None] - self.centres[rows]
        inside = self._inside(np.hypot(delta[..., 0], delta[..., 1]), rows).T
        usual = max(1.0 - self.astray_share - self.s.stayed_share - self.dark_share, 0.1)
        anywhere = np.full(len(rows), self.astray_share)
        anywhere[~np.isfinite(self.expected[rows]).all(axis=1)] += usual
        chance = np.repeat((anywhere / self.area_mm2[rows])[:, None], len(columns), axis=1)
        for places, share in ((self.expected, usual), (self.previous, self.s.stayed_share)):
            chance += share * self._density(places[rows], columns)
        return np.where(inside, -np.log(chance), _NEVER)

    def _density(self, places: Floats, columns: Ints) -> Floats:
        """Gaussian about each place at each spot, per mm^2; 0 where the place is not known."""
        square = np.sum((self.spots[columns][None] - places[:, None]) ** 2, axis=2)
        variance = self.s.sigma_mm**2
        known = np.isfinite(square)
        return np.exp(-0.5 * np.where(known, square, np.inf) / variance) / (2 * np.pi * variance)

    def _solve_group(self, rows: Ints, columns: Ints) -> list[_Guess]:
        price = self._prices(rows, columns)
        best, total = self._assign(price)
        out = []
        for i, row in enumerate(rows):
            without = price.copy()
            if best[i] >= 0:
                without[i, best[i]] = _NEVER
                doubt = self._assign(without)[1] - total
            else:
                doubt = self._cheapest_lit(price, i) - total
            out.append(_Guess(int(row), int(columns[best[i]]) if best[i] >= 0 else -1, doubt))
        return out

    def _cheapest_lit(self, price: Floats, i: int) -> float:
        """Total price if positioner i had to have a spot."""
        if not (price[i] < _NEVER).any():
            return np.inf
        forced = price.copy()
        forced[i] -= _NEVER / 2
        return self._assign(forced)[1] + _NEVER / 2

    def _assign(self, price: Floats) -> tuple[Ints, float]:
        """Cheapest assignment: spot of each row or -1, and the total price.

        Every row may be dark and every column a stray: a square matrix with those as partners.
        """
        n, m = price.shape
        square = np.full((n + m, n + m), _NEVER)
        square[:n, :m] = price
        square[np.arange(n), m + np.arange(n)] = -np.log(self.dark_share)
        square[n + np.arange(m), np.arange(m)] = self.stray_price
        square[n:, m:] = 0.0
        r, c = linear_sum_assignment(square)
        best = np.where(c[:n] < m, c[:n], -1)
        return best.astype(np.int64), float(square[r, c].sum())


def _groups(rows: Ints, columns: Ints, p: Ints, k: Ints) -> Iterator[tuple[Ints, Ints]]:
    """Connected groups of the links (p into rows, k into columns)."""
    n = len(rows) + len(columns)
    graph = coo_array((np.ones(len(p)), (p, k + len(rows))), shape=(n, n))
    _, group = connected_components(graph, directed=False)
    order = np.argsort(group, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        is_row = members < len(rows)
        yield rows[members[is_row]], columns[members[~is_row] - len(rows)]
