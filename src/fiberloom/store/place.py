"""Where runs are kept: their store, and the folders of their result files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

RUNS = Path("runs")
"""Where runs go that are not told where to go."""
STORE = "store.sqlite"
"""Name of the store in a folder."""

BESIDE = "."
"""The files of a run are in the folder of its store."""
NUMBERED = "{run:04d}"
"""They are in a folder of their own below it, which has the number of the run."""


@dataclass(frozen=True)
class Place:
    """A folder, where below it the files of a run are, and the store: a file in it, or a database."""

    base: Path
    pattern: str = BESIDE
    """Folder of the files, from `base`; `{run}` is the number of the run."""
    database: str = ""
    """URL of the store; empty: it is the file in the folder."""

    @classmethod
    def of(cls, out: str | Path | Place | None) -> Place:
        """The folder that was asked for; None: below `runs`, one for each run."""
        if isinstance(out, Place):
            return out
        return cls(RUNS, NUMBERED) if out is None else cls(Path(out))

    @property
    def store(self) -> Path:
        """File of the store, where that is one."""
        return self.base / STORE

    @property
    def record(self) -> str:
        """The store, as `Store.open` takes it."""
        return self.database or str(self.store)

    @property
    def begun(self) -> bool:
        """Is the store there? A database is, as soon as it was opened once."""
        return bool(self.database) or self.store.exists()

    @property
    def numbered(self) -> bool:
        """Has every run a folder of its own?"""
        return self.pattern != BESIDE

    def folder(self, run: int) -> Path:
        """Of the files of a run, by its number."""
        return self.base / self.pattern.format(run=run)
