"""The choice over many exposures as a linear programme in whole numbers.

Columns are candidates (exposure, positioner, target, fibre). In an exposure a positioner takes one target, a
target one positioner, and two arms that touch are not both chosen: as in the assignment of one exposure. Over
all exposures a target has no more visits than it wants, and every sector of every exposure has its minimum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import block_diag, csc_array, csr_array, vstack

from fiberloom.assignment.choose import exclusions
from fiberloom.typing import Array, Flags, Floats, Ints


@dataclass(frozen=True)
class Minimum:
    """Of a role in a sector of an exposure: the least number, and the columns that count."""

    exposure: int
    sector: int
    role: str
    number: int
    columns: Ints

    def __str__(self) -> str:
        return f"exposure {self.exposure + 1}, sector {self.sector + 1}"


@dataclass(frozen=True, eq=False)
class VisitModel:
    """C candidates over E exposures."""

    exposure: Ints
    """(C,) from 0 up."""
    target: Ints
    """(C,) row of the list of the survey."""
    value: Floats
    """(C,) of a visit: whole numbers, dimensionless."""
    alone: csc_array
    """(R, C) sets of candidates of which one at most is chosen."""
    visits: Ints
    """(n,) that each target wants; of calibration targets as many as there are exposures."""
    minimums: tuple[Minimum, ...]

    def __len__(self) -> int:
        return len(self.target)

    @cached_property
    def repeated(self) -> tuple[csc_array, Ints]:
        """(Q, C), (Q,): candidates of each target that could have more visits than it wants, and the most."""
        places = np.unique(np.column_stack([self.target, self.exposure]), axis=0)[:, 0]
        there = np.bincount(places, minlength=len(self.visits))
        rows = np.flatnonzero(there > self.visits)
        number = np.full(len(self.visits), -1)
        number[rows] = np.arange(len(rows))
        mine = np.flatnonzero(number[self.target] >= 0)
        ones = np.ones(len(mine))
        shape = (len(rows), len(self))
        return csc_array((ones, (number[self.target[mine]], mine)), shape=shape), self.visits[rows]

    @cached_property
    def least(self) -> tuple[csr_array, Ints]:
        """(M, C) and (M,): candidates that count for each minimum, and that minimum."""
        column = np.concatenate([np.empty(0, np.int64), *(m.columns for m in self.minimums)])
        row = np.repeat(np.arange(len(self.minimums)), [len(m.columns) for m in self.minimums])
        shape = (len(self.minimums), len(self))
        numbers = np.array([m.number for m in self.minimums], dtype=np.int64)
        return csr_array((np.ones(len(row)), (row, column.astype(np.int64))), shape=shape), numbers

    def shuffled(self, order: Ints) -> VisitModel:
        """The same with its columns in another order: (C,) numbers of the old ones."""
        back = np.argsort(order)
        minimums = tuple(replace(m, columns=np.sort(back[m.columns])) for m in self.minimums)
        columns = (self.exposure[order], self.target[order], self.value[order])
        return VisitModel(*columns, self.alone[:, order], self.visits, minimums)

    def only(self, exposure: int, visits: Ints) -> tuple[VisitModel, Ints]:
        """One exposure of it, and the numbers of its columns; `visits` (n,): those that are still wanted."""
        rows = np.flatnonzero((self.exposure == exposure) & (visits[self.target] > 0))
        number = np.full(len(self), -1)
        number[rows] = np.arange(len(rows))
        mine = [m for m in self.minimums if m.exposure == exposure]
        kept = [replace(m, columns=number[m.columns][number[m.columns] >= 0]) for m in mine]
        columns = (self.exposure[rows], self.target[rows], self.value[rows])
        return VisitModel(*columns, self.alone[:, rows], visits, tuple(kept)), rows

    def allowed(self, chosen: Flags) -> bool:
        """Does a choice (C,) keep every rule?"""
        x = chosen.astype(np.float64)
        many, most = self.repeated
        few, least = self.least
        return bool((self.alone @ x <= 1.0).all() and (many @ x <= most).all() and (few @ x >= least).all())

    def worth(self, chosen: Flags) -> float:
        """Sum of values of a choice (C,), dimensionless."""
        return float(self.value[chosen].sum())


@dataclass(frozen=True, eq=False)
class Choices:
    """The candidates of one exposure that nothing fixed blocks; arrays (C,)."""

    positioner: Ints
    target: Ints
    """Row of the list of the survey."""
    sector: Ints
    """Of the positioner."""
    pairs: tuple[Ints, Ints]
    """Candidates that exclude each other."""


def build(
    exposures: Sequence[Choices],
    value: Floats,
    visits: Ints,
    role: Array,
    minimum: dict[str, int],
    sectors: int,
) -> VisitModel:
    """The programme of all exposures.

    `exposures`: candidates of each; `value` (dimensionless), `visits`, `role` (n,) of each target;
    `minimum`: by role, in each of the `sectors` of each exposure.
    """
    target = np.concatenate([c.target for c in exposures])
    number = np.repeat(np.arange(len(exposures)), [len(c.target) for c in exposures])
    sector = np.concatenate([c.sector for c in exposures])
    parts = [exclusions(c.positioner, c.target, c.pairs) for c in exposures if len(c.target)]
    alone = csc_array(block_diag(parts)) if parts else csc_array((0, 0))
    minimums = [
        Minimum(e, s, name, least, np.flatnonzero((number == e) & (sector == s) & (role[target] == name)))
        for e in range(len(exposures))
        for s in range(sectors)
        for name, least in minimum.items()
        if least
    ]
    return VisitModel(number, target, value[target], alone, visits, tuple(minimums))


def stacked(model: VisitModel) -> tuple[csr_array, Floats, Floats]:
    """(K, C) rules, with the least and the most of each, (K,); all dimensionless."""
    many, most = model.repeated
    few, least = model.least
    low = np.concatenate([np.full(model.alone.shape[0] + len(most), -np.inf), least])
    high = np.concatenate([np.ones(model.alone.shape[0]), most, np.full(len(least), np.inf)])
    return csr_array(vstack([model.alone, many, few])), low, high
