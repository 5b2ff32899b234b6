"""Progress on stderr: a bar on a terminal, else a line for each stage and one every ten seconds."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

from fiberloom import timing

if TYPE_CHECKING:
    from rich.progress import Progress

EVERY_S = 10.0
"""Between two lines of one stage."""


class Waiting(Protocol):
    """Shows the progress of a command."""

    def say(self, text: str) -> None:
        """Begins a stage with this name."""

    def count(self, done: int, total: int) -> None:
        """Shows that `done` of `total` parts of the stage are done."""


class Quiet:
    """Progress without output."""

    def say(self, text: str) -> None:
        """Nothing."""

    def count(self, done: int, total: int) -> None:
        """Nothing."""


class Lines:
    """Plain lines, for logs: one for each stage, then at most one in `every_s`."""

    def __init__(
        self,
        write: Callable[[str], object],
        every_s: float = EVERY_S,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._write, self._every_s, self._clock_s = write, every_s, clock_s
        self._text, self._last_s = "", clock_s()

    def say(self, text: str) -> None:
        """A line for each new stage."""
        if text != self._text:
            self._text = text
            self._tell(text)

    def count(self, done: int, total: int) -> None:
        """Writes a line, unless the last one is less than `every_s` ago."""
        if self._clock_s() - self._last_s >= self._every_s:
            self._tell(f"{self._text}: {done} of {total}")

    def _tell(self, line: str) -> None:
        self._last_s = self._clock_s()
        self._write(f"{line}\n")


class Bar:
    """One line with a bar, redrawn at each report."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._task = progress.add_task("", total=None, of="")

    def say(self, text: str) -> None:
        """Renames the line and empties the bar."""
        self._progress.update(self._task, description=text, completed=0, total=None, of="")

    def count(self, done: int, total: int) -> None:
        """Fills the bar."""
        self._progress.update(self._task, completed=done, total=total, of=f"{done} of {total}")


class TimedWaiting:
    """Progress whose stages are timed as well."""

    def __init__(self, shown: Waiting, timings: timing.Timings) -> None:
        self._shown, self._timings = shown, timings

    def say(self, text: str) -> None:
        """The next stage begins."""
        self._timings.stage(text)
        self._shown.say(text)

    def count(self, done: int, total: int) -> None:
        """As it is."""
        self._shown.count(done, total)


@contextmanager
def waiting(quiet: bool = False, timings: bool = False) -> Iterator[Waiting]:
    """Shows progress while the block runs; with `timings` where the time went, on stderr at its end."""
    if not timings:
        with _shown(quiet) as shown:
            yield shown
        return
    table = timing.begin()
    try:
        with _shown(quiet) as shown:
            yield TimedWaiting(shown, table)
    finally:
        timing.end()
        print("\n".join(table.lines()), file=sys.stderr)


@contextmanager
def _shown(quiet: bool) -> Iterator[Waiting]:
    if quiet:
        yield Quiet()
    elif not sys.stderr.isatty():
        yield Lines(lambda line: print(line, end="", file=sys.stderr, flush=True))
    else:
        with _progress() as progress:
            yield Bar(progress)


def _progress() -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[of]}"))
    return Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True), transient=True)
