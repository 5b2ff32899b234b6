"""Moves as groups: fold, turn with arms folded, unfold one group of non-neighbours after the other.

A folded arm stays within its own territory, however alpha turns. While one unfolds, each neighbour stands,
folded or at its goal; where its way touches that neighbour, this tells which of the two goes first. Units
that would have to wait for each other in a circle do not move. Folding is unfolding backwards.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fiberloom.drive.steppers.ways import ArmWays
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats, Ints


@dataclass
class Groups:
    """Angles of all N units, stage by stage."""

    stages: list[tuple[Ints, Floats]] = field(default_factory=list)
    """Rows that move, and angles (N, 2) in deg of all afterwards."""
    refused: dict[int, str] = field(default_factory=dict)
    """By row: why it does not move."""


@dataclass(frozen=True, eq=False)
class Unfolding:
    """Which way units unfold to their goals, and in which order."""

    ways: ArmWays
    goal_deg: Floats
    """(N, 2)."""
    moves: Flags
    """(N,) those that unfold; the others stand at their goals all the time."""
    folded_deg: float
    """Beta of a folded arm."""

    def ordered(self) -> tuple[list[Ints], dict[int, str]]:
        """Groups of rows, in turn; and who cannot unfold, with the reason."""
        first, why = self._precedence()
        left = {row for row in np.flatnonzero(self.moves).tolist() if row not in why}
        groups: list[Ints] = []
        while left:
            free = [row for row in sorted(left) if not (first[row] & left)]
            if not free:  # a circle: the one that most wait for stays folded
                row = max(sorted(left), key=lambda r: sum(r in first[other] for other in left))
                why[row] = "its way and those of its neighbours wait for each other"
                left.discard(row)
                why |= {
                    other: f"{_NAME.format(row)} is in its way" for other in left if self._blocks(row, other)
                }
                left -= set(why)
                continue
            groups.append(self.ways.apart(np.array(free, dtype=np.int64))[0])
            left -= set(groups[-1].tolist())
        return groups, why

    def _precedence(self) -> tuple[list[set[int]], dict[int, str]]:
        """Of each row those that have to unfold before it; and who touches one that does not move."""
        i, j = self.ways.pairs[self.moves[self.ways.pairs[:, 0]]].T
        unfolded, folded = self._hits(i, j, self.goal_deg), self._hits(i, j, self._folded())
        fixed = ~self.moves[j]
        why = {
            int(a): f"{_NAME.format(int(b))}, which does not move, is in its way"
            for a, b in zip(i[fixed & unfolded], j[fixed & unfolded], strict=True)
        }
        first: list[set[int]] = [set() for _ in range(len(self.moves))]
        for a, b in zip(i[folded & ~fixed], j[folded & ~fixed], strict=True):
            first[int(a)].add(int(b))
        for a, b in zip(i[unfolded & ~fixed], j[unfolded & ~fixed], strict=True):
            first[int(b)].add(int(a))
        return first, why

    def _folded(self) -> Floats:
        return np.column_stack([self.goal_deg[:, 0], np.full(len(self.goal_deg), self.folded_deg)])

    def _hits(self, rows: Ints, others: Ints, others_deg: Floats) -> Flags:
        corners = np.stack([self._folded()[rows], self.goal_deg[rows]], axis=1)
        return self.ways.hits(rows, corners, others, others_deg[others])

    def _blocks(self, row: int, other: int) -> bool:
        """Whether one that stays folded is in the way of another."""
        one = np.array([other]), np.array([row])
        return bool(self._hits(*one, self._folded())[0])


_NAME = "{{{}}}"
"""Of a row in a reason: numbers of the focal plane are put in later."""


def grouped(plane: FocalPlane, here_deg: Floats, goal_deg: Floats, moves: Flags) -> Groups:
    """Stages of a `plane` from `here_deg` to `goal_deg` (N, 2), of those that `moves` (N,) names."""
    ways, folded_deg = ArmWays(plane), plane.instrument.positioner.park_deg[1]
    out, moves = Groups(), moves.copy()
    out_of, why = Unfolding(ways, here_deg, moves, folded_deg).ordered()
    if why:
        return _without(plane, here_deg, goal_deg, moves, why)
    now = here_deg.copy()
    for rows in reversed(out_of):
        now = _turned(out, now, rows, 1, np.full(len(rows), folded_deg))
    into, why = Unfolding(ways, np.where(moves[:, None], goal_deg, here_deg), moves, folded_deg).ordered()
    if why:
        return _without(plane, here_deg, goal_deg, moves, why)
    every = np.flatnonzero(moves)
    now = _turned(out, now, every, 0, goal_deg[every, 0])
    for rows in into:
        now = _turned(out, now, rows, 1, goal_deg[rows, 1])
    return out


def _without(
    plane: FocalPlane, here_deg: Floats, goal_deg: Floats, moves: Flags, why: dict[int, str]
) -> Groups:
    """The same without those that cannot make their ways."""
    rest = moves.copy()
    rest[list(why)] = False
    out = grouped(plane, here_deg, goal_deg, rest)
    ids = plane.positioner_id
    named = {row: f"{_named(text, ids)}; it stays where it is" for row, text in why.items()}
    out.refused = named | out.refused
    return out


def _named(text: str, ids: Ints) -> str:
    """A reason with the number of the positioner whose row is in braces."""
    begin, end = text.find("{"), text.find("}")
    return (
        text if begin < 0 else f"{text[:begin]}positioner {ids[int(text[begin + 1 : end])]}{text[end + 1 :]}"
    )


def _turned(out: Groups, now: Floats, rows: Ints, axis: int, to_deg: Floats) -> Floats:
    """One axis of some rows turned; a stage, unless all are there."""
    after = now.copy()
    after[rows, axis] = to_deg
    turning = rows[np.abs(after[rows] - now[rows]).max(axis=1) > 0.0]
    if len(turning):
        out.stages.append((turning, after))
    return after
