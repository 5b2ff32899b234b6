"""A night from its begin, or from where a process before has left it, to its end and its report."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from fiberloom.errors import InputError, StoppedError
from fiberloom.night.on_record import last_time
from fiberloom.night.runner import NightRunner, NightStoppedError
from fiberloom.night.setup import NightSetup
from fiberloom.operation.safety.memory import few_heaps
from fiberloom.operation.safety.stop import reason
from fiberloom.operation.safety.writing import beside
from fiberloom.operation.session.session import HeldArray, Session
from fiberloom.operation.session.states import Deed
from fiberloom.store import Store
from fiberloom.store.nights.book import NightBook, nights
from fiberloom.store.run import FAILED, FINISHED, INTERRUPTED
from fiberloom.store.service.alarms import Severity


@dataclass(frozen=True)
class NightEnd:
    """How a night has ended."""

    night: int
    status: str
    why: str


async def carry_out(
    setup: NightSetup, store: Store, resume: bool, progress: Callable[[str], None] = lambda _: None
) -> NightEnd:
    """Carries out a night.

    Parameters
    ----------
    setup : NightSetup
        Queue, array, folder.
    store : Store
        Of runs and nights.
    resume : bool
        Go on with the last night of this queue that did not come to its end.
    progress : callable
        Called with the name of each step.

    Returns
    -------
    NightEnd
        Number of the night, how it ended, and why.

    Raises
    ------
    InputError
        Another process has the array or the night; there is none to go on with; the array cannot be opened.
    StoppedError
        Another process has asked for a stop; the night can be resumed.
    """
    setup.read_queue()  # told before the array is touched
    few_heaps()
    session = await beside(Session, setup.array, setup.command_line, progress, setup.exclude, setup.witness)
    setup.known.plane = session.plane
    async with session.owning(Deed.OBSERVE) as held:
        book = await beside(_resumed if resume else _begun, setup, store)
        progress(f"night {book.id}" + (", resumed" if resume else ""))
        ended: list[NightEnd] = []
        with _ending(setup, book, ended):
            await _asked(setup, book, progress)
            why = await _run(setup, book, held, progress)
            status = INTERRUPTED if setup.control.parked_by else FINISHED  # parked by a person: it may go on
            ended.append(NightEnd(book.id, status, why))
        return ended[0]


async def _asked(setup: NightSetup, book: NightBook, progress: Callable[[str], None]) -> None:
    """What the array tells before the first field: how warm it is, and which motors not to count on.

    One plane is for all fields: motors are judged by the fewest moves that one of them has.
    """
    known = setup.known
    moves = setup.queue_of(book).fewest_moves(known.plane.instrument.operation.corrections_max)
    await known.ask(setup.source, progress, moves)
    setup.array = replace(setup.array, plane=known.plane)  # those that the night leaves out come on top
    if known.doubtful:
        text = not_counted_on(known.doubtful)
        progress(text)
        now = last_time(book) or book.about.utc_start
        await beside(book.raise_alarm, now, "not counted on", Severity.ADVICE, "array", text)


def not_counted_on(doubtful: dict[int, str]) -> str:
    """Which positioners get no target by their calibration, and why, in a line."""
    named = "; ".join(f"{number} ({why})" for number, why in sorted(doubtful.items()))
    return f"{len(doubtful)} positioners get no target, their calibration does not count on them: {named}"


async def _run(setup: NightSetup, book: NightBook, held: HeldArray, progress: Callable[[str], None]) -> str:
    async with setup.opened() as hardware:
        runner = NightRunner(setup, book, held, hardware, progress)
        if held.said:
            await beside(
                book.raise_alarm, runner.clock.now(), "taken over", Severity.MINOR, "array", held.said
            )
        setup.begun(runner)
        return await runner.run()


@contextmanager
def _ending(setup: NightSetup, book: NightBook, ended: list[NightEnd]) -> Any:
    """Books how a night ends, whatever happens; one that needs a person is no error of the program."""
    try:
        yield
        _book_end(book, ended[0].status, ended[0].why)
    except NightStoppedError as error:
        _book_end(book, FAILED, str(error))
        ended.append(NightEnd(book.id, FAILED, str(error)))
    except (asyncio.CancelledError, KeyboardInterrupt, StoppedError):
        _book_end(book, INTERRUPTED, "stopped by the operator")
        raise
    except BaseException as error:
        _book_end(book, FAILED, reason(error))
        raise


def _book_end(book: NightBook, status: str, note: str) -> None:
    book.end(last_time(book) or book.about.utc_start, status, note)


def _begun(setup: NightSetup, store: Store) -> NightBook:
    """A new night. InputError where one of this queue goes on."""
    queue = setup.read_queue()
    for night in nights(store):
        if night.goes_on and night.queue == str(setup.queue_file):
            raise InputError(
                f"night {night.id} of this queue goes on in process {night.pid}; wait for its end"
            )
    plane = setup.known.plane
    about = {
        "name": queue.name,
        "queue": str(setup.queue_file),
        "array": setup.array.book.address,
        "instrument": plane.instrument.name,
        "config_hash": plane.config_hash(),
        "seed": setup.seed,
        "command_line": setup.command_line,
    }
    begin = queue.begin if setup.virtual else None
    return NightBook.begin(store, begin or datetime.now(UTC), about)


def _resumed(setup: NightSetup, store: Store) -> NightBook:
    """The last night of this queue that did not come to its end, with this process as its own."""
    mine = [night for night in nights(store) if night.queue == str(setup.queue_file)]
    if not mine or mine[-1].status == FINISHED:
        which = f"night {mine[-1].id} is finished" if mine else "none was begun"
        raise InputError(f"--resume: {which} of {setup.queue_file}; leave --resume out to begin one")
    book = NightBook(store, mine[-1].id)
    book.take_over()
    return book
