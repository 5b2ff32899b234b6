"""Where the seconds of a command go: by its stages, and in each by kind of work.

Functions that do such work are marked with `part`; modules that are read count as imports. Nothing is
measured before `begin`: what passed until then counts as imports, too. Stages have wall and processor
seconds, parts have wall seconds: the twin and the camera compute in several threads.
"""

from __future__ import annotations

import builtins
import functools
import os
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


def core_count() -> int:
    """Cores for threads: those of the process's affinity where the system tells (a container, `taskset`)."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def cpu_s() -> float:
    """Processor seconds until now: user and system, of this process and of its children that have ended."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


class Timings:
    """Wall and processor seconds of stages that follow each other, and wall seconds of the parts in each.

    What a part calls and is a part itself counts there alone; work in other threads counts where it is done.
    """

    def __init__(self, since_s: float) -> None:
        """`since_s`: when the first stage, the start, began; of ``time.perf_counter()``."""
        self._begun_s, self._stage, self._stage_s = since_s, "start", since_s
        self._stage_cpu_s = 0.0  # what the interpreter took to start is the first stage's
        self._whole_s: dict[str, float] = defaultdict(float)
        self._cpu_s: dict[str, float] = defaultdict(float)
        self._part_s: dict[tuple[str, str], float] = defaultdict(float)
        self._part_s[self._stage, _IMPORTS] = time.perf_counter() - since_s
        self._own = threading.local()
        self._lock = threading.Lock()

    def stage(self, name: str) -> None:
        """The next stage begins; one that has been there before goes on."""
        now_s, used_s = time.perf_counter(), cpu_s()
        self._whole_s[self._stage] += now_s - self._stage_s
        self._cpu_s[self._stage] += used_s - self._stage_cpu_s
        self._stage, self._stage_s, self._stage_cpu_s = name, now_s, used_s

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
        out = [
            f"{_both(s, self._cpu_s[stage])}  {stage}: {self._parts(stage, s)}"
            for stage, s in self._whole_s.items()
        ]
        return [*out, f"{_both(sum(self._whole_s.values()), sum(self._cpu_s.values()))}  in all"]

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


def _both(wall_s: float, used_s: float) -> str:
    return f"{wall_s:7.1f} s {used_s:7.1f} CPU s"


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
