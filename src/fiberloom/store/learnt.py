"""What was learnt of the maps in operation: a history per positioner that only grows.

A generation holds the states of the positioners that it changed; for all others an earlier one
stands. Going back makes a new generation with the old states, so that this can be undone too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Connection, delete, func, select

from fiberloom.errors import InputError
from fiberloom.store.database import Store
from fiberloom.store.schema import GENERATIONS, LEARNT
from fiberloom.store.sums import as_utc, check, checked, put, put_one
from fiberloom.version import __version__

OBSERVE, UNDO = "observe", "undo"


@dataclass(frozen=True)
class Learnt:
    """One positioner's state; `data` is None where it is the calibration itself."""

    moves: int
    shift_mdeg: float
    data: bytes | None


@dataclass(frozen=True)
class Generation:
    """A line of the history."""

    id: int
    utc: datetime
    origin: str
    kind: str
    note: str
    seed: int | None
    version: str
    n_positioners: int
    moves: int
    """Learnt from by its positioners since the calibration, the most of any."""
    rms_shift_mdeg: float


class LearntHistory:
    """The states that build on one calibration, `origin`, in a store."""

    def __init__(self, store: Store, origin: str) -> None:
        self._store, self.origin = store, origin

    def begin(
        self, kind: str, instrument: str, config_hash: str, seed: int | None = None, note: str = ""
    ) -> int:
        """A new generation without states; its number.

        `kind`: what taught it (an observation, a step back); `instrument` and `config_hash` of the
        layout; `seed` of the twin; `note`: free text.
        """
        values = {
            "utc": datetime.now(UTC),
            "origin": self.origin,
            "kind": kind,
            "instrument": instrument,
            "config_hash": config_hash,
            "seed": seed,
            "version": __version__,
            "note": note,
        }
        with self._store.transaction() as connection:
            return put_one(connection, GENERATIONS, values)

    def put(self, generation: int, states: Mapping[int, Learnt]) -> None:
        """States of positioners in a generation, in place of those that it had of them."""
        with self._store.transaction() as connection:
            _put(connection, generation, states)

    def latest(self, upto: int | None = None) -> dict[int, Learnt]:
        """The state of every positioner as of a generation, the newest when left out."""
        with self._store.transaction() as connection:
            return _as_of(connection, self.origin, upto)

    def of_generation(self, generation: int) -> dict[int, Learnt]:
        """The states that one generation changed."""
        query = select(LEARNT).where(LEARNT.c.generation_id == generation)
        with self._store.transaction() as connection:
            return _states(connection.execute(query).mappings().all())

    def generations(self) -> list[Generation]:
        """The history, oldest first."""
        return [g for g in generations(self._store) if g.origin == self.origin]

    def undo(self, to: int, positioner_id: Iterable[int] | None = None) -> int:
        """Goes back to a generation (0: the calibration), for some or all; the new generation."""
        known = {g.id: g for g in self.generations()}
        if to != 0 and to not in known:
            raise InputError(
                f"{self._store.name}: no generation {to} of this calibration; "
                f"there are 0 (the calibration) and {', '.join(map(str, known)) or 'no others'}"
            )
        now, then = self.latest(), self.latest(to)
        wanted = set(now) if positioner_id is None else set(map(int, positioner_id))
        missing = sorted(wanted - set(now))
        if missing:
            raise InputError(f"{self._store.name}: nothing was learnt of positioner {missing[0]}")
        nothing = Learnt(0, 0.0, None)
        states = {p: then.get(p, nothing) for p in sorted(wanted)}
        with self._store.transaction() as connection:
            mine = [row for row in checked(connection, GENERATIONS) if row["origin"] == self.origin]
            if not mine:
                raise InputError(f"{self._store.name}: nothing was learnt yet")
            values = {k: mine[-1][k] for k in ("origin", "instrument", "config_hash", "seed")}
            values |= {"utc": datetime.now(UTC), "kind": UNDO, "version": __version__}
            values["note"] = f"{len(states)} positioners back to generation {to}"
            made = put_one(connection, GENERATIONS, values)
            _put(connection, made, states)
        return made


def generations(store: Store) -> list[Generation]:
    """All generations of a store, of whatever calibration, oldest first."""
    columns = [GENERATIONS.c[k] for k in ("id", "utc", "origin", "kind", "note", "seed", "version")]
    counted = [
        func.count(LEARNT.c.id).label("n_positioners"),
        func.coalesce(func.max(LEARNT.c.moves), 0).label("moves"),
        func.coalesce(func.avg(LEARNT.c.shift_mdeg * LEARNT.c.shift_mdeg), 0.0).label("square"),
    ]
    query = (
        select(*columns, *counted)
        .join(LEARNT, LEARNT.c.generation_id == GENERATIONS.c.id, isouter=True)
        .group_by(*columns)
        .order_by(GENERATIONS.c.id)
    )
    with store.transaction() as connection:
        checked(connection, GENERATIONS)
        rows = [dict(row) for row in connection.execute(query).mappings()]
    return [_generation(row) for row in rows]


def _generation(row: dict[str, Any]) -> Generation:
    square = row.pop("square")
    utc = as_utc(row.pop("utc"))
    return Generation(**row, utc=utc, rms_shift_mdeg=float(square) ** 0.5)


def _put(connection: Connection, generation: int, states: Mapping[int, Learnt]) -> None:
    of_generation = LEARNT.c.generation_id == generation
    ids = list(states)
    for part in (ids[k : k + 500] for k in range(0, len(ids), 500)):  # databases limit their lists
        connection.execute(delete(LEARNT).where(of_generation, LEARNT.c.positioner_id.in_(part)))
    rows = [
        {
            "generation_id": generation,
            "positioner_id": int(p),
            "moves": int(state.moves),
            "shift_mdeg": float(state.shift_mdeg),
            "data": state.data,
        }
        for p, state in states.items()
    ]
    put(connection, LEARNT, rows)


def _as_of(connection: Connection, origin: str, upto: int | None) -> dict[int, Learnt]:
    checked(connection, GENERATIONS)  # one whose origin has changed by itself would be left out
    newest = (
        select(LEARNT.c.positioner_id, func.max(LEARNT.c.generation_id).label("generation"))
        .join(GENERATIONS, GENERATIONS.c.id == LEARNT.c.generation_id)
        .where(GENERATIONS.c.origin == origin)
        .group_by(LEARNT.c.positioner_id)
    )
    if upto is not None:
        newest = newest.where(LEARNT.c.generation_id <= upto)
    last = newest.subquery()
    query = select(LEARNT).join(
        last,
        (last.c.positioner_id == LEARNT.c.positioner_id) & (last.c.generation == LEARNT.c.generation_id),
    )
    return _states(connection.execute(query).mappings().all())


def _states(rows: Sequence[Mapping[Any, Any]]) -> dict[int, Learnt]:
    check(LEARNT, rows)
    return {row["positioner_id"]: Learnt(row["moves"], row["shift_mdeg"], row["data"]) for row in rows}
