"""Commands of a page and what they answer: run in order, in one folder, and compared or written anew.

A command is an indented line `    fiberloom ...`; its answer is the next block of text. Python blocks
between them run too: they write files that later commands read. `python -m tools.pages.transcript PAGE`
writes the answers into the page.
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

COMMAND = re.compile(
    r"^    (?P<command>fiberloom [^\n]+)\n\n```text\n(?P<answer>.*?)^```$"
    r"|^```python\n(?P<code>.*?)^```$",
    re.M | re.S,
)
PROGRESS = re.compile(r"^[a-z][\w ,]*: \d+ of \d+$")
"""A line that comes every ten seconds: how many depends on the machine."""
OTHERWISE = (
    (r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d)?(?:\S*)", "TIME"),
    (r"\b20\d\d…", "TIME"),  # cut off by the width of a column
    (r"config hash +\w+", "config hash #"),
    (r"[\d.]+ CPU s", "# CPU s"),
    (r"took [\d.]+ s", "took # s"),
    (r"\bcpu s +\S+", "cpu s #"),
    (r"─+", "─"),
)
"""What is another with every run, or with every change of an instrument's model: times, a hash."""


@dataclass(frozen=True)
class Exchange:
    """A command of a page, and what it answered."""

    command: str
    said: str
    """By the page."""
    answered: str
    """Now, with the exit code where it is not 0."""

    @property
    def same(self) -> bool:
        """Does the page say what the command answers, but for times?"""
        return steady(self.said) == steady(self.answered)


def steady(answer: str) -> str:
    """An answer without what is another with every run."""
    for pattern, instead in OTHERWISE:
        answer = re.sub(pattern, instead, answer)
    return " ".join(answer.split())


def run_page(text: str, folder: Path) -> list[Exchange]:
    """Runs the Python blocks and the commands of a page in a folder, in order."""
    found = []
    for piece in COMMAND.finditer(text):
        if piece["code"]:
            subprocess.run(
                [sys.executable, "-c", piece["code"]], cwd=folder, env=_environment(folder), check=True
            )
        else:
            found.append(Exchange(piece["command"], piece["answer"], ask(piece["command"], folder)))
    return found


def ask(command: str, folder: Path) -> str:
    """What a command writes to the terminal, and its exit code where it is not 0."""
    words = [sys.executable, "-m", "fiberloom.cli", *shlex.split(command)[1:]]
    done = subprocess.run(
        words,
        cwd=folder,
        env=_environment(folder),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    lines = [line.rstrip() for line in done.stdout.splitlines() if not PROGRESS.match(line)]
    told = "\n".join(lines).strip("\n")
    return f"{told}\n" + (f"exit code {done.returncode}\n" if done.returncode else "")


def _environment(folder: Path) -> dict[str, str]:
    ours = {"COLUMNS": "80", "PYTHONUNBUFFERED": "1", "MPLBACKEND": "Agg", "NO_COLOR": "1"}
    return os.environ | ours | {"FIBERLOOM_CACHE": str(folder / ".cache")}


def with_answers(text: str, found: list[Exchange]) -> str:
    """The page with what its commands answered."""
    answers = iter(found)

    def renewed(piece: re.Match[str]) -> str:
        if piece["code"]:
            return piece[0]
        now = next(answers)
        head = piece[0][: piece.start("answer") - piece.start()]
        return piece[0] if now.same else f"{head}{now.answered}```"

    return COMMAND.sub(renewed, text)


def main() -> None:
    """Writes the answers into a page."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("page", type=Path)
    page: Path = parser.parse_args().page
    text = page.read_text()
    with tempfile.TemporaryDirectory() as folder:
        found = run_page(text, Path(folder))
    page.write_text(with_answers(text, found))
    print(f"{page}: {len(found)} commands, {sum(not e.same for e in found)} answers written anew")


if __name__ == "__main__":
    main()
