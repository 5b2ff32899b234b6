"""Passages of positioners as a store remembers them, for `fiberloom.health.monitor`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fiberloom.health.monitor import ObservedMove
from fiberloom.health.status import FibreStatus
from fiberloom.instruments import FocalPlane
from fiberloom.store import Store
from fiberloom.store.run import CUT_SHORT, START, STOPPED
from fiberloom.typing import Array, Floats

Columns = dict[str, Array]

_NOT_ARRIVED = (
    *(FibreStatus.DEAD, FibreStatus.DISCONNECTED),
    *(FibreStatus.BLOCKED, FibreStatus.OFFLINE),
)
_NEAR_DEG = 1.0
"""A report farther than this from the command is no arrival: gears are linear to 0.6 deg."""
_STAYS_DEG = 1e-6
_STOPPED_EARLY = (CUT_SHORT, "recovery")
"""Events that follow a move that was stopped; runs of before have the second one alone."""


def passages(store: Store, run_id: int, plane: FocalPlane) -> Iterator[ObservedMove]:
    """The moves of one run in order. Positioners that the plane does not have are left out."""
    columns, cut_short = store.measurements(run_id), _cut_short(store, run_id)
    before = np.full((len(plane), 2), np.nan)
    for move_id in dict.fromkeys(columns["move_id"].tolist()):
        here = columns["move_id"] == move_id
        move = _Move({name: column[here] for name, column in columns.items()}, plane)
        if np.all(move.kind == STOPPED):  # nothing was seen: only where each was left
            before = np.where(move.known[:, None], move.believed_deg, before)
            continue
        begins = bool(np.all(move.kind == START))
        if begins:
            before = move.believed_deg
        passage = move.passage(before, begins)
        # within the approach of its goal a report does not show that it was stopped
        whole = move_id not in cut_short
        yield replace(passage, arrived=passage.arrived & whole)
        before = np.where(move.known[:, None], move.believed_deg if whole else np.nan, before)


def _cut_short(store: Store, run_id: int) -> set[int]:
    """Numbers of the moves in which not all have arrived."""
    moves, events = store.moves(run_id), store.events(run_id)
    after = [utc for utc, kind in zip(events["utc"], events["kind"], strict=True) if kind in _STOPPED_EARLY]
    made = [(moves["utc"] <= utc).sum() for utc in after]
    return {int(moves["id"][k - 1]) for k in made if k}


class _Move:
    """One move's columns, by rows of the plane."""

    def __init__(self, columns: Columns, plane: FocalPlane) -> None:
        of_plane = np.isin(columns["positioner_id"], plane.positioner_id)
        self.rows = plane.index_of(columns["positioner_id"][of_plane].astype(np.int64))
        self.n = len(plane)
        self._columns = {name: column[of_plane] for name, column in columns.items()}
        self.kind = columns["kind"]
        self.known = np.zeros(self.n, dtype=bool)
        self.known[self.rows] = True
        self.believed_deg = self._pair("alpha_deg", "beta_deg")
        self.wire_deg = self._pair("wire_alpha_deg", "wire_beta_deg")

    def passage(self, before_deg: Floats, begins: bool = False) -> ObservedMove:
        """What operation saw of it; `begins`: before the first move of a run."""
        seen_mm = self._pair("x_mm", "y_mm")
        seen_mm[self.rows[~self._columns["seen"].astype(bool)]] = np.nan
        stays = np.all(np.abs(self.believed_deg - before_deg) < _STAYS_DEG, axis=1)
        status = np.full(self.n, str(FibreStatus.OFFLINE), dtype=object)
        status[self.rows] = self._columns["status"]
        near = np.all(np.abs(self.wire_deg - self.believed_deg) < _NEAR_DEG, axis=1)
        arrived = near & ~np.isin(status.astype(str), [str(s) for s in _NOT_ARRIVED])
        gave_up = status.astype(str) == str(FibreStatus.DEAD)
        asked = self.known & ~stays
        collided = gave_up & asked
        return ObservedMove(
            before_deg, self.believed_deg, seen_mm, asked, arrived, collided=collided, begins=begins
        )

    def _pair(self, first: str, second: str) -> Floats:
        out = np.full((self.n, 2), np.nan)
        out[self.rows] = np.column_stack([self._columns[first], self._columns[second]])
        return out
