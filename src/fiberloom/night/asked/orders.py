"""What people have changed in the queue of a night: on record, so that a resumed night has it too."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import ValidationError

from fiberloom.errors import InputError
from fiberloom.instruments.load import all_problems
from fiberloom.night.queue import FieldEntry, Queue
from fiberloom.store.service.commands import CommandRecord, CommandResult

SKIP, PRIORITY, ADD = "skip", "priority", "add field"
"""Commands that change the queue."""


@dataclass
class QueueOrders:
    """Changes of a queue, by the id of a field."""

    skipped: dict[str, str] = field(default_factory=dict)
    """Why each is left out."""
    priority: dict[str, float] = field(default_factory=dict)
    added: dict[str, FieldEntry] = field(default_factory=dict)

    @classmethod
    def of(cls, commands: Iterable[CommandRecord]) -> QueueOrders:
        """Of the commands of a night on record, in their order; those that were refused change nothing."""
        orders = cls()
        for command in commands:
            if command.result == CommandResult.DONE:
                orders._take(command)
        return orders

    def _take(self, command: CommandRecord) -> None:
        asked = json.loads(command.parameters)
        if command.command == SKIP:
            self.skipped[asked["field"]] = f"by {command.author}"
        elif command.command == PRIORITY:
            self.priority[asked["field"]] = asked["priority"]
        elif command.command == ADD:
            entry = FieldEntry.model_validate(asked)
            self.added[entry.id] = entry

    def applied(self, queue: Queue) -> Queue:
        """The `queue` of the file with these changes; a field that the file has by now comes from there."""
        there = {entry.id for entry in queue.fields}
        added = [entry for name, entry in self.added.items() if name not in there and entry.targets.is_file()]
        fields = tuple(map(self._changed, (*queue.fields, *added)))
        return queue.model_copy(update={"fields": fields})

    def _changed(self, entry: FieldEntry) -> FieldEntry:
        priority = self.priority.get(entry.id, entry.priority)
        skip = entry.skip or self.skipped.get(entry.id, "")
        return entry.model_copy(update={"priority": priority, "skip": skip})


def require_field(queue: Queue, name: str) -> FieldEntry:
    """The field with this `name` in a `queue`. InputError where there is none."""
    if (entry := queue.entry(name)) is None:
        raise InputError(f"field '{name}': not in the queue; it has {', '.join(e.id for e in queue.fields)}")
    return entry


def new_field(queue: Queue, asked: dict[str, object], targets: Path) -> FieldEntry:
    """A field that can be added to a `queue`: what was `asked`, with its list of `targets`.

    InputError where its id is there already, or a value is out of its range.
    """
    try:
        entry = FieldEntry.model_validate(asked | {"targets": targets})
    except ValidationError as error:
        raise InputError(f"field: {all_problems(error)}") from None
    if queue.entry(entry.id) is not None:
        raise InputError(f"field '{entry.id}': is in the queue already; give it another id")
    return entry
