"""Every command to an array that came by the service: its author, what was asked, how it ended."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any

from sqlalchemy import func, select

from fiberloom.store.arrays import ArrayBook
from fiberloom.store.schema import COMMANDS
from fiberloom.store.sums import change, checked, put_one, record_of

LONGEST = 2000
"""Of the parameters and of the text that are kept, letters."""


class CommandResult(StrEnum):
    """How a command ended."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    STOPPED = "stopped"
    REFUSED = "refused"  # nothing was done


@dataclass(frozen=True)
class CommandRecord:
    """One command."""

    id: int
    utc: datetime
    author: str
    role: str
    command: str
    parameters: str
    """JSON."""
    key: str
    """Of idempotency; empty: none."""
    utc_end: datetime | None
    result: str
    text: str

    def as_dict(self) -> dict[str, Any]:
        """For JSON; times as ISO 8601, UTC."""
        times = {"utc": self.utc.isoformat(), "utc_end": self.utc_end and self.utc_end.isoformat()}
        return {**self.__dict__, **times, "parameters": json.loads(self.parameters)}


class CommandBook:
    """The commands to one array in its store."""

    def __init__(self, book: ArrayBook) -> None:
        self._store, self._address = book.store, book.address

    def begin(
        self,
        author: str,
        role: str,
        command: str,
        parameters: Mapping[str, Any],
        key: str = "",
        night: int | None = None,
    ) -> int:
        """Writes a command that begins now; its number.

        `author` and `role`: of the person or program; `command`: its name; `parameters`: what was asked;
        `key`: of idempotency; `night`: to which it is given, None: to the array.
        """
        text = json.dumps(parameters, default=str)
        values = {
            "address": self._address,
            "night_id": night,
            "utc": datetime.now(UTC),
            "author": author,
            "role": role,
            "command": command,
            "parameters": text if len(text) <= LONGEST else json.dumps({"letters": len(text)}),
            "key": key,
            "utc_end": None,
            "result": CommandResult.RUNNING.value,
            "text": "",
        }
        with self._store.transaction() as connection:
            return put_one(connection, COMMANDS, values)

    def end(self, number: int, result: CommandResult, text: str = "") -> None:
        """Writes how command `number` has ended: its `result`, and a `text` for the operator."""
        values = {"utc_end": datetime.now(UTC), "result": result.value, "text": text[:LONGEST]}
        with self._store.transaction() as connection:
            change(connection, COMMANDS, COMMANDS.c.id == number, values)

    def abandon(self) -> int:
        """Books commands as failed that run on record though their process has ended; how many."""
        running = (COMMANDS.c.address == self._address) & (COMMANDS.c.result == CommandResult.RUNNING.value)
        values = {"utc_end": datetime.now(UTC), "result": CommandResult.FAILED.value}
        with self._store.transaction() as connection:
            return change(
                connection, COMMANDS, running, values | {"text": "its process ended without a word"}
            )

    def get(self, number: int) -> CommandRecord | None:
        """The command with this number; None: there is none."""
        return next(iter(self._rows(COMMANDS.c.id == number)), None)

    def by_key(self, author: str, key: str) -> CommandRecord | None:
        """The command that an author has given with this key of idempotency; None: there is none.

        One that was refused does not count: nothing was done, and it may be given again.
        """
        given = (COMMANDS.c.key == key) & (COMMANDS.c.author == author)
        given &= COMMANDS.c.result != CommandResult.REFUSED.value
        return next(iter(self._rows(given)), None) if key else None

    def last(self, most: int = 50) -> list[CommandRecord]:
        """The last commands, newest first."""
        newest = select(func.max(COMMANDS.c.id)).where(COMMANDS.c.address == self._address)
        with self._store.transaction() as connection:
            top = connection.execute(newest).scalar() or 0
        return self._rows(COMMANDS.c.id > top - most)[::-1]

    def _rows(self, where: Any) -> list[CommandRecord]:
        with self._store.transaction() as connection:
            rows = checked(connection, COMMANDS, where)
        return [record_of(CommandRecord, row) for row in rows if row["address"] == self._address]
