"""Units that start together: whether all can be reached before, and whether all have started after.

Their ways are planned together, so one that stands is in the way of the others.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Sequence
from typing import NamedTuple

from fiberloom.bus.links import LinkPatience, cut_off, links_of
from fiberloom.bus.outcome import Outcome

Say = Callable[[str], None]


def unsaid(text: str) -> None:
    """For a caller that does not want to know a `text`."""


class NotStarted(NamedTuple):
    """Who has not started with the others."""

    ids: set[int]
    text: str
    """By the names of their lines; empty: all have started."""


def down_before(transport: object, ids: Iterable[int]) -> str:
    """Which links of a `transport` to units `ids` are down, and why; empty: every unit can be reached."""
    cut = cut_off(transport, ids)
    if not cut:
        return ""
    find = getattr(transport, "link_of", lambda positioner: None)
    behind = {str(link) for number in cut if (link := find(number)) is not None}
    return ", ".join(sorted(behind or {str(link) for link in links_of(transport) if not link.up}))


def line_of(transport: object, number: int) -> str:
    """The name of the line that a unit hangs at: its port, else its link, else the whole bus."""
    name = getattr(transport, "line_of", lambda positioner: "")(number)
    link = getattr(transport, "link_of", lambda positioner: None)(number)
    return str(name or getattr(link, "name", "the bus"))


def not_started(
    ids: Sequence[int], stand: set[int], silent: set[int], line: Callable[[int], str]
) -> NotStarted:
    """Of units `ids` that were told to start those that `stand` by their own word.

    Also all of a line of which none has said that it goes: some are `silent`, or all. `line`: name of the
    line of a unit. One that is silent where others have started is taken to have started too.
    """
    members: dict[str, set[int]] = {}
    for number in ids:
        members.setdefault(line(number), set()).add(number)
    still = {name: units for name, units in members.items() if units <= stand | silent}
    whole = set().union(*still.values())
    single = sorted(stand.intersection(ids) - whole)
    told = [f"{name} has not confirmed its start" for name in sorted(still)]
    told += [f"units {', '.join(map(str, single))} have not started"] if single else []
    return NotStarted(whole | set(single), "; ".join(told))


async def start(
    transport: object,
    ids: Iterable[int],
    begin: Callable[[], Awaitable[None]],
    late: Callable[[], Awaitable[NotStarted]],
    say: Say,
) -> NotStarted | None:
    """Starts units `ids` by `begin`; None: they go. Else who, by `late`, does not: the rest is to be held.

    None is started where a link of the `transport` to one of them is down. `say` is told why.
    """
    if down := down_before(transport, ids):
        say(f"{down}: no unit is started")
        return NotStarted(set(), "")
    await begin()
    found = await late()
    if not found.ids:
        return None
    say(f"{found.text}: all are stopped")
    return found


async def hold(stop: Callable[[], Awaitable[None]], patience: LinkPatience) -> None:
    """Calls `stop` for all, where they have not started together; again for those that were out of reach.

    `patience`: waits for their links.
    """
    await stop()
    await patience.wait()
    await stop()


def held_as(number: int, answers: bool, late: NotStarted) -> Outcome:
    """How a unit has ended where all were stopped because some were `late`; whether it `answers` now."""
    if not answers:
        return Outcome.DISCONNECTED
    return Outcome.NOT_STARTED if number in late.ids else Outcome.STOPPED
