"""What is kept of an array from one command to the next: exclusions, its state and owner, places.

An array is named by the address of its bus. Its row in `array_state` is the lock: one motion at a time,
across processes and machines that share the store.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from sqlalchemy import ColumnElement, Connection, delete, select
from sqlalchemy.exc import IntegrityError

from fiberloom.errors import InputError
from fiberloom.store.database import Store
from fiberloom.store.process import host_name, is_alive, process_start
from fiberloom.store.schema import ARRAY_STATE, EXCLUSIONS, PLACES
from fiberloom.store.sums import as_utc, change, checked, put
from fiberloom.typing import Flags, Floats, Ints

HEARTBEAT_S = 2.0
"""Between two signs of life of an owner."""
STALE_S = 20.0
"""An owner without a sign of life for so long is taken for gone, whatever its process does."""

SEEN, RIGHT, REPORTED, UNKNOWN = "seen", "right", "reported", "unknown"
"""How a place is known: by an image; by an image that shows it where it reports; by its report alone; not."""


class NotOwner(RuntimeError):
    """Another process owns the array by now."""


@dataclass(frozen=True)
class Exclusion:
    """One positioner that must not be moved."""

    id: int
    positioner_id: int
    since: datetime
    until: datetime | None
    who: str
    why: str
    cleared: datetime | None
    cleared_by: str

    def in_force(self, now: datetime) -> bool:
        """Neither cleared nor over."""
        return self.cleared is None and (self.until is None or self.until > now)


@dataclass(frozen=True)
class ArrayState:
    """The state of an array, and which process owns it."""

    state: str
    since: datetime
    text: str
    token: str
    command: str
    host: str
    pid: int
    process_start: str
    heartbeat: datetime | None
    stop_asked_by: str

    @property
    def owned(self) -> bool:
        """A process has it that is not certainly gone."""
        return bool(self.token) and not self.stale

    @property
    def stale(self) -> bool:
        """Its owner has ended without giving it back, or gives no sign of life."""
        if not self.token:
            return False
        return not is_alive(self.host, self.pid, self.process_start) or self.silent_s > STALE_S

    @property
    def silent_s(self) -> float:
        """Since the owner's last sign of life, s."""
        return 0.0 if self.heartbeat is None else (datetime.now(UTC) - self.heartbeat).total_seconds()

    @property
    def owner(self) -> str:
        """Who owns it, in words; empty: none."""
        return f"`{self.command}` (process {self.pid} on {self.host})" if self.token else ""


@dataclass(frozen=True, eq=False)
class ArrayPlaces:
    """Last known places of N positioners; rows in the order asked for."""

    angles_deg: Floats
    """(N, 2) alpha and beta; NaN where nothing is on record."""
    wire_deg: Floats
    """(N, 2) as reported on the bus; NaN where it did not answer."""
    how: list[str]
    """seen, right, reported or unknown."""
    datum: Flags
    """(N,) searched since power came on, as far as the record goes."""
    utc: list[datetime | None]


_FRESH = ArrayState("off", datetime.fromtimestamp(0, UTC), "", "", "", "", 0, "", None, "")


class ArrayBook:
    """What a store keeps of one array."""

    def __init__(self, store: Store, address: str) -> None:
        self.store, self.address = store, address

    # state and owner

    def state(self) -> ArrayState:
        """As it is now; `off` for an array that was never owned."""
        with self.store.transaction() as connection:
            row = self._state_row(connection)
        return _FRESH if row is None else _state_of(row)

    def _state_row(self, connection: Connection) -> Mapping[Any, Any] | None:
        # of all arrays: a row whose address has changed by itself would not be found by it
        rows = checked(connection, ARRAY_STATE)
        return next((row for row in rows if row["address"] == self.address), None)

    def take(self, command: str, state: str) -> tuple[str, ArrayState]:
        """Makes this process the owner: its token, and how the array was before.

        `command`: what the operator typed; `state`: that it has from now on. InputError, which names the
        owner, where another process has it. One that is gone, or silent for STALE_S, loses it.
        """
        for _ in range(3):
            before = self.state()
            if before.owned:
                raise InputError(
                    f"{self.address}: in use by {before.owner}, {before.state}; wait for its end, or "
                    "`fiberloom stop`"
                )
            token = uuid.uuid4().hex
            if self._swap(before.token, token, command, state):
                return token, before
        raise InputError(f"{self.address}: other processes take it at the same time; try again")

    def _swap(self, old: str, token: str, command: str, state: str) -> bool:
        """Takes it from the owner `old`, unless another process was quicker."""
        now = datetime.now(UTC)
        values = {
            "state": state,
            "since": now,
            "text": "",
            "token": token,
            "command": command,
            "host": host_name(),
            "pid": os.getpid(),
            "process_start": process_start(os.getpid()),
            "heartbeat": now,
            "stop_asked_by": "",
        }
        with self.store.transaction() as connection:
            if change(connection, ARRAY_STATE, self._owned_by(old), values):
                return True
            if old or self._state_row(connection) is not None:
                return False
            return _inserted(connection, {"address": self.address, **values})

    def _owned_by(self, token: str) -> ColumnElement[bool]:
        return (ARRAY_STATE.c.address == self.address) & (ARRAY_STATE.c.token == token)

    def enter(self, token: str, state: str, text: str = "") -> None:
        """The owner says what the array is doing, and why. NotOwner where it lost it meanwhile."""
        self._as_owner(token, {"state": state, "since": datetime.now(UTC), "text": text})

    def release(self, token: str, state: str, text: str = "") -> None:
        """The owner gives it back in a state, with the reason; nothing where it lost it meanwhile."""
        values = {"state": state, "since": datetime.now(UTC), "text": text, "token": "", "stop_asked_by": ""}
        with self.store.transaction() as connection:
            change(connection, ARRAY_STATE, self._owned_by(token), values)

    def beat(self, token: str) -> None:
        """A sign of life of the owner. NotOwner where it lost the array meanwhile."""
        self._as_owner(token, {"heartbeat": datetime.now(UTC)})

    def _as_owner(self, token: str, values: Mapping[str, Any]) -> None:
        with self.store.transaction() as connection:
            if not change(connection, ARRAY_STATE, self._owned_by(token), values):
                raise NotOwner(f"{self.address}: another process owns it by now; nothing more is moved")

    def ask_stop(self, who: str) -> bool:
        """Asks the owner to stop everything; False where there is none."""
        owned = (ARRAY_STATE.c.address == self.address) & (ARRAY_STATE.c.token != "")
        with self.store.transaction() as connection:
            return bool(change(connection, ARRAY_STATE, owned, {"stop_asked_by": who}))

    def note_stopped(self, text: str, state: str) -> None:
        """A process that does not own the array has stopped it: none is owner any more."""
        values = {"state": state, "since": datetime.now(UTC), "text": text, "token": "", "stop_asked_by": ""}
        with self.store.transaction() as connection:
            if not change(connection, ARRAY_STATE, ARRAY_STATE.c.address == self.address, values):
                empty = {"command": "", "host": "", "pid": 0, "process_start": "", "heartbeat": None}
                put(connection, ARRAY_STATE, [{"address": self.address, **values, **empty}])

    # exclusions

    def exclude(
        self, positioner_id: Iterable[int], who: str, why: str, until: datetime | None = None
    ) -> None:
        """Positioners that must not be moved from now on.

        `positioner_id`: their numbers; `who`: says so; `why`: the reason, for the record; `until`: UTC,
        None: until it is cleared. An exclusion that is there stays, with its own reason.
        """
        there = {e.positioner_id for e in self.exclusions()}
        common = {
            "address": self.address,
            "since": datetime.now(UTC),
            "until": until,
            "who": who,
            "why": why,
            "cleared": None,
            "cleared_by": "",
        }
        rows = [{**common, "positioner_id": int(p)} for p in positioner_id if int(p) not in there]
        if rows:
            with self.store.transaction() as connection:
                put(connection, EXCLUSIONS, rows)

    def clear(self, positioner_id: Iterable[int], who: str) -> list[int]:
        """Ends exclusions; the positioners that were excluded. InputError where one was not."""
        wanted = sorted({int(p) for p in positioner_id})
        there = {e.positioner_id for e in self.exclusions()}
        if missing := [p for p in wanted if p not in there]:
            raise InputError(f"positioner {missing[0]} is not excluded; `fiberloom exclude list`")
        open_ = (
            (EXCLUSIONS.c.address == self.address)
            & EXCLUSIONS.c.positioner_id.in_(wanted)
            & EXCLUSIONS.c.cleared.is_(None)
        )
        with self.store.transaction() as connection:
            change(connection, EXCLUSIONS, open_, {"cleared": datetime.now(UTC), "cleared_by": who})
        return wanted

    def exclusions(self, *, past: bool = False) -> list[Exclusion]:
        """Those in force now, by positioner; with `past` also those that have ended."""
        with self.store.transaction() as connection:
            rows = checked(connection, EXCLUSIONS)  # of all arrays, as of their states
        known = [_exclusion_of(row) for row in rows if row["address"] == self.address]
        now = datetime.now(UTC)
        chosen = [e for e in known if past or e.in_force(now)]
        return sorted(chosen, key=lambda e: (e.positioner_id, e.id))

    # places

    def note_places(self, positioner_id: Ints, places: ArrayPlaces) -> None:
        """Where positioners are now, in place of what was known. Rows of `places` as `positioner_id`.

        Raises nothing for NaN: an angle that is not known is no place, and that positioner keeps its row.
        """
        now = datetime.now(UTC)
        known = np.asarray(np.isfinite(places.angles_deg).all(axis=1))
        rows = [self._place_row(int(p), places, k, now) for k, p in enumerate(positioner_id) if known[k]]
        if not rows:
            return
        with self.store.transaction() as connection:
            ids = [row["positioner_id"] for row in rows]
            connection.execute(
                delete(PLACES).where(PLACES.c.address == self.address, PLACES.c.positioner_id.in_(ids))
            )
            put(connection, PLACES, rows)

    def forget_datum(self, positioner_id: Ints) -> None:
        """The datum of these is not known any more; where they were last stays on record."""
        asked = PLACES.c.positioner_id.in_([int(p) for p in positioner_id])
        these = (PLACES.c.address == self.address) & PLACES.c.datum.is_(True) & asked
        with self.store.transaction() as connection:
            change(connection, PLACES, these, {"datum": False})

    def _place_row(self, positioner: int, places: ArrayPlaces, row: int, now: datetime) -> dict[str, Any]:
        wire = [float(v) if np.isfinite(v) else None for v in places.wire_deg[row]]
        return {
            "address": self.address,
            "positioner_id": positioner,
            "utc": now,
            "alpha_deg": float(places.angles_deg[row, 0]),
            "beta_deg": float(places.angles_deg[row, 1]),
            "wire_alpha_deg": wire[0],
            "wire_beta_deg": wire[1],
            "how": places.how[row],
            "datum": bool(places.datum[row]),
        }

    def known_positioners(self) -> Ints:
        """Numbers of all that have a place on record, sorted."""
        query = select(PLACES.c.positioner_id).where(PLACES.c.address == self.address)
        with self.store.transaction() as connection:
            return np.array(sorted(connection.execute(query).scalars()), dtype=np.int64)

    def places(self, positioner_id: Ints) -> ArrayPlaces:
        """Last known places of these positioners."""
        n = len(positioner_id)
        with self.store.transaction() as connection:
            # all of them: a row whose address has changed by itself would not be found by it
            found = checked(connection, PLACES)
        rows = {row["positioner_id"]: row for row in found if row["address"] == self.address}
        angles, wire = np.full((n, 2), np.nan), np.full((n, 2), np.nan)
        how, datum = [UNKNOWN] * n, np.zeros(n, dtype=bool)
        when: list[datetime | None] = [None] * n
        for k, p in enumerate(positioner_id):
            if (row := rows.get(int(p))) is None:
                continue
            angles[k] = row["alpha_deg"], row["beta_deg"]
            if row["wire_alpha_deg"] is not None:
                wire[k] = row["wire_alpha_deg"], row["wire_beta_deg"]
            how[k], datum[k], when[k] = row["how"], row["datum"], as_utc(row["utc"])
        return ArrayPlaces(angles, wire, how, datum, when)


def _inserted(connection: Connection, values: Mapping[str, Any]) -> bool:
    try:
        with connection.begin_nested():
            put(connection, ARRAY_STATE, [values])
    except IntegrityError:  # another process was quicker
        return False
    return True


def _state_of(row: Mapping[Any, Any]) -> ArrayState:
    return ArrayState(**_utc({name: row[name] for name in ArrayState.__dataclass_fields__}))


def _exclusion_of(row: Mapping[Any, Any]) -> Exclusion:
    return Exclusion(**_utc({name: row[name] for name in Exclusion.__dataclass_fields__}))


def _utc(values: dict[str, Any]) -> dict[str, Any]:
    """The row with its times in UTC."""
    return {k: as_utc(v) if isinstance(v, datetime) else v for k, v in values.items()}


def arrays_of(store: Store) -> list[str]:
    """Addresses of the arrays that a store knows."""
    with store.transaction() as connection:
        found: set[str] = set()
        for table in (ARRAY_STATE, PLACES, EXCLUSIONS):
            found |= set(connection.execute(select(table.c.address).distinct()).scalars())
    return sorted(found)
