"""Talking to whoever waits: progress on stderr, only where somebody looks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn


class Waiting:
    """A line with a bar: `say` renames it, `count` fills it."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._task = progress.add_task("", total=None)

    def say(self, text: str) -> None:
        """Name what is being done now."""
        self._progress.update(self._task, description=text, completed=0, total=None)

    def count(self, done: int, total: int) -> None:
        """Tell how much of it is done."""
        self._progress.update(self._task, completed=done, total=total)


@contextmanager
def waiting(quiet: bool = False) -> Iterator[Waiting]:
    """Show progress while the block runs; nothing when quiet or when stderr is no terminal."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    hidden = quiet or not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as progress:
        yield Waiting(progress)
