"""Which build a result is of. Results of different builds are not mixed in one folder."""

from __future__ import annotations

import hashlib
import json
import subprocess
from functools import cache
from pathlib import Path

from fiberloom import _core
from fiberloom.errors import InputError

BUILD = "build.json"
JUDGES = ("bodies", "campaign", "mutants", "oracle", "pairs", "pockets")
"""Modules of this folder that decide what is said of a plan."""
Mark = dict[str, str]


@cache
def mark_of_build() -> Mark:
    """The compiled core, planning's Python and what judges plans by their content; the commit, to be found
    again.
    """
    core = Path(_core.__file__)
    package = core.parent
    judges = [Path(__file__).with_name(f"{name}.py") for name in JUDGES]
    files = [core, *sorted((package / "planning").glob("*.py")), *judges]
    mark = hashlib.sha256()
    for file in files:
        mark.update(file.read_bytes())
    words = ["git", "rev-parse", "--short", "HEAD"]
    asked = subprocess.run(words, cwd=package, capture_output=True, text=True, check=False)
    return {"build": mark.hexdigest()[:12], "commit": asked.stdout.strip() or "unknown"}


def claim(folder: Path, array: str, anew: bool | None = None, mark: Mark | None = None) -> None:
    """Makes the folder one of this build and array. InputError where it holds results of another.

    `anew` renames such a folder and begins an empty one; None: the command has no such option.
    """
    mine = (mark or mark_of_build()) | {"array": array}
    path = folder / BUILD
    if path.exists():
        theirs = json.loads(path.read_text())
        differs = [key for key in ("build", "array") if theirs.get(key) != mine[key]]
        if not differs:
            return
        if not anew:
            told = "; ".join(f"{theirs.get(key)}, and this is {mine[key]}" for key in differs)
            aside = "" if anew is None else ", or put them aside with --anew"
            raise InputError(
                f"{folder}: holds results of another {' and '.join(differs)} ({told}; theirs is of commit "
                f"{theirs['commit']}); name another folder{aside}"
            )
        folder.rename(_free_name(folder))
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(mine) + "\n")


def _free_name(folder: Path) -> Path:
    names = (folder.with_name(f"before-{k}-{folder.name}") for k in range(1, 10_000))
    return next(name for name in names if not name.exists())
