"""Runs a step of the set-up, shows how far it is, and keeps its output in a log.

    python3 tools/setup/progress.py TITLE LOG [--of COUNT] -- COMMAND...

Steps are counted by ninja's `[n/m]`, or by pip's `Collecting` lines, of which there are about COUNT. On a
terminal one line is drawn again and again; elsewhere a line comes every ten seconds. Where the command
fails, the end of the log is shown. Only the standard library: nothing is installed yet.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TextIO

EVERY_S = 10.0
SHOWN_LINES = 40
_NINJA = re.compile(r"\s*\[(\d+)/(\d+)\]")


class Steps:
    """How many steps are done, by the lines of the output."""

    def __init__(self, expected: int) -> None:
        self.done, self.total = 0, expected

    def take(self, line: str) -> bool:
        """Whether the line tells of a step."""
        if match := _NINJA.match(line):
            self.done, self.total = int(match[1]), int(match[2])
            return True
        if self.total and line.startswith("Collecting "):
            self.done += 1
            self.total = max(self.total, self.done)
            return True
        return False


class Screen:
    """One line that is drawn again on a terminal; else one every `EVERY_S`."""

    def __init__(self, title: str, out: TextIO) -> None:
        self.title, self.out, self.drawn_s = title, out, time.monotonic()
        self.width = 0
        self._write(title)

    def show(self, steps: Steps) -> None:
        """Tells how far it is."""
        if self.out.isatty() or time.monotonic() - self.drawn_s >= EVERY_S:
            self._write(f"{self.title}: {steps.done} of {steps.total}")

    def end(self, word: str, seconds: float) -> None:
        """The last word."""
        self._write(f"{self.title}: {word} ({seconds:.0f} s)")
        if self.out.isatty():
            self.out.write("\n")

    def _write(self, text: str) -> None:
        self.drawn_s = time.monotonic()
        if self.out.isatty():
            self.out.write("\r" + text.ljust(self.width))
            self.width = len(text)
        else:
            self.out.write(text + "\n")
        self.out.flush()


def follow(lines: Iterable[str], log: TextIO, steps: Steps, screen: Screen) -> list[str]:
    """Writes all lines into the log; returns the last ones."""
    last: list[str] = []
    for line in lines:
        log.write(line)
        last = [*last[-SHOWN_LINES + 1 :], line]
        if steps.take(line):
            screen.show(steps)
    return last


def run(title: str, log: Path, expected: int, command: list[str]) -> int:
    """Exit code of the command."""
    log.parent.mkdir(parents=True, exist_ok=True)
    begun_s = time.monotonic()
    screen = Screen(title, sys.stderr)
    with (
        log.open("w") as file,
        subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
        ) as process,
    ):
        assert process.stdout is not None
        last = follow(process.stdout, file, Steps(expected), screen)
    seconds = time.monotonic() - begun_s
    screen.end("done" if process.returncode == 0 else f"FAILED, see {log}", seconds)
    if process.returncode:
        sys.stderr.writelines(last)
    return process.returncode


def main(words: list[str]) -> int:
    """Reads the command line of the module's docstring."""
    if "--" not in words or words.index("--") not in (2, 4):
        print(__doc__, file=sys.stderr)
        return 2
    cut = words.index("--")
    expected = int(words[3]) if cut == 4 else 0
    return run(words[0], Path(words[1]), expected, words[cut + 1 :])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
