"""Where the seconds of a command go: by its stages, and in each by kind of work.

Functions that do such work are marked with `part`; modules that are read count as imports. Nothing is
measured before `begin`: what passed until then counts as imports, too.
"""

from __future__ import annotations

import builtins
import functools
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from typing import ParamSpec, TypeVar

Given = ParamSpec("Given")
Result = TypeVar("Result")

_STARTED_S = time.perf_counter()
_OTHER, _IMPORTS = "other", "imports"
_import = builtins.__import__


class Timings:
    """Wall seconds of stages that follow each other, and of the parts in each.

    What a part calls and is a part itself counts there alone; work in other threads counts where it is done.
    """

    def __init__(self, since_s: float) -> None:
        """`since_s`: when the first stage, the start, began; of ``time.perf_counter()``."""
        self._begun_s, self._stage, self._stage_s = since_s, "start", since_s
        self._whole_s: dict[str, float] = defaultdict(float)
        self._part_s: dict[tuple[str, str], float] = defaultdict(float)
        self._part_s[self._stage, _IMPORTS] = time.perf_counter() - since_s
        self._own = threading.local()
        self._lock = threading.Lock()

    def stage(self, name: str) -> None:
        """The next stage begins; one that has been there before goes on."""
        now_s = time.perf_counter()
        self._whole_s[self._stage] += now_s - self._stage_s
        self._stage, self._stage_s = name, now_s

    def enter(self, part: str) -> None:
        """A part begins in this thread."""
        running = self._running()
        self._book(running)
        running.append(part)

    def leave(self) -> None:
        """It has ended."""
        running = self._running()
        self._book(running)
        running.pop()

    def lines(self) -> list[str]:
        """One line for each stage, and one for all; ends the stage."""
        self.stage(self._stage)
        out = [f"{s:7.1f} s  {stage}: {self._parts(stage, s)}" for stage, s in self._whole_s.items()]
        all_s = sum(self._whole_s.values())
        return [*out, f"{all_s:7.1f} s  in all, {time.process_time():.1f} CPU s"]

    def _parts(self, stage: str, whole_s: float) -> str:
        parts = {part: s for (at, part), s in self._part_s.items() if at == stage}
        parts[_OTHER] = max(whole_s - sum(parts.values()), 0.0)
        ranked = sorted(parts.items(), key=lambda item: -item[1])
        return ", ".join(f"{part} {s:.1f}" for part, s in ranked if s >= 0.05) or "-"

    def _running(self) -> list[str]:
        """Parts that run in this thread, the outermost first."""
        if not hasattr(self._own, "running"):
            self._own.running, self._own.since_s = [], 0.0
        running: list[str] = self._own.running
        return running

    def _book(self, running: list[str]) -> None:
        now_s = time.perf_counter()
        if running:
            with self._lock:
                self._part_s[self._stage, running[-1]] += now_s - self._own.since_s
        self._own.since_s = now_s


_timings: list[Timings] = []
"""The one that measures; empty where none does."""


def begin() -> Timings:
    """From now on parts are measured; the first stage is what passed since this module was imported."""
    _timings[:] = [Timings(_STARTED_S)]
    builtins.__import__ = part(_IMPORTS)(_import)
    return _timings[0]


def end() -> None:
    """Nothing is measured any more."""
    builtins.__import__ = _import
    _timings.clear()


def part(name: str) -> Callable[[Callable[Given, Result]], Callable[Given, Result]]:
    """Marks a function as a kind of work, called `name` in the table. Not for coroutines: they wait."""

    def marked(work: Callable[Given, Result]) -> Callable[Given, Result]:
        @functools.wraps(work)
        def measured(*args: Given.args, **kwargs: Given.kwargs) -> Result:
            if not _timings:
                return work(*args, **kwargs)
            timings = _timings[0]
            timings.enter(name)
            try:
                return work(*args, **kwargs)
            finally:
                timings.leave()

        return measured

    return marked
