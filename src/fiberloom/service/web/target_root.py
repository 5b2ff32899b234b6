"""Target lists that may be observed: files below one folder, and no others."""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path
from typing import Any

from fiberloom.errors import InputError
from fiberloom.targets import read_targets

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")
SUFFIXES = (".csv", ".ecsv", ".fits", ".par", ".par.gz")
MOST_FILES = 2000


class TargetRoot:
    """The folder of target lists."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()
        self._folder.mkdir(parents=True, exist_ok=True)

    def path(self, name: str) -> Path:
        """The file of a list by its name, which may hold folders. InputError for one that leads elsewhere."""
        parts = name.split("/")
        if not all(NAME.fullmatch(part) for part in parts):
            raise InputError(f"target list {name[:100]!r}: name one below the folder of lists, e.g. m31.csv")
        found = self._folder.joinpath(*parts).resolve()
        if not found.is_relative_to(self._folder):  # by a link
            raise InputError(f"target list {name[:100]!r}: leads out of the folder of lists")
        if not found.is_file():
            raise InputError(f"target list {name[:100]!r}: no such file; GET /api/v1/targets lists them")
        return found

    def names(self) -> list[dict[str, Any]]:
        """Names, sizes and times of all lists, the newest first."""
        files = [f for f in self._folder.rglob("*") if f.name.endswith(SUFFIXES) and f.is_file()]
        rows = [(f.stat().st_mtime, f) for f in files[:MOST_FILES]]
        return [
            {"name": f.relative_to(self._folder).as_posix(), "bytes": f.stat().st_size, "utc": mtime}
            for mtime, f in sorted(rows, reverse=True)
        ]

    def save(self, name: str, content: bytes) -> int:
        """Keeps a list under a name, in place of one that is there; how many targets it has.

        InputError for a name or a content that is no list: nothing is kept then.
        """
        suffix = next((s for s in SUFFIXES if name.endswith(s)), None)
        if suffix is None or not NAME.fullmatch(name):
            raise InputError(f"target list {name[:100]!r}: name it like m31.csv ({', '.join(SUFFIXES)})")
        number, made = tempfile.mkstemp(suffix, ".new-", self._folder)
        try:
            with os.fdopen(number, "wb") as file:
                file.write(content)
            n = len(read_targets(made))
            Path(made).replace(self._folder / name)
        except InputError as error:
            raise InputError(str(error).replace(made, name)) from None
        finally:
            Path(made).unlink(missing_ok=True)
        return n
