"""Campaigns: one experiment on many units, in this process, in many, or on a Dask cluster.

An experiment is a function of (units, seed, settings) that returns rows: arrays by name, whose
first axis goes with the units. It must be importable (processes elsewhere find it by its name) and
pure: what it returns for a unit depends on its arguments alone. Then the result is the same for any
number of workers, and after a kill only what is missing is computed again:

    campaign = Campaign("coverage", experiment, n_units=1000, seed=1, settings=Settings(...), chunk=20)
    rows = run(campaign, Path("runs/coverage"), workers=4)

Units are cut into chunks of a fixed size. Each finished chunk is a file, written at once or not at all
by the process that called `run`; workers need no common disk.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import shutil
import sys
import zipfile
from collections.abc import Callable, Generator, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.errors import InputError
from fiberloom.studies.workers import Deadly, Here, Processes, Rows, Workers, cluster, computed
from fiberloom.typing import Array
from fiberloom.version import __version__, code_digest
from fiberloom.wholefile import whole

Experiment = Callable[[range, int, Any], Rows]
Progress = Callable[[int, int], None]
"""Called with (units done, units in all)."""


@dataclass(frozen=True)
class Campaign:
    """What is to be computed; how and where makes no difference to it."""

    name: str
    experiment: Experiment
    n_units: int
    seed: int
    settings: Any = None
    """A dataclass, or anything else that JSON can hold; None is fine."""
    chunk: int = 1
    """Units computed together: what is lost by a kill, and how finely work is shared out."""

    def __post_init__(self) -> None:
        if self.n_units < 1 or self.chunk < 1:
            raise InputError(
                f"campaign {self.name}: {self.n_units} units in chunks of {self.chunk}: both >= 1"
            )

    def chunks(self) -> list[range]:
        """Units in order, `chunk` at a time."""
        starts = range(0, self.n_units, self.chunk)
        return [range(first, min(first + self.chunk, self.n_units)) for first in starts]

    def key(self) -> str:
        """16 hex digits that change with anything the rows depend on, the code of the package included."""
        given = self.settings
        settings = asdict(given) if is_dataclass(given) and not isinstance(given, type) else given
        inputs = {
            "name": self.name,
            "experiment": f"{self.experiment.__module__}.{self.experiment.__qualname__}",
            "units": self.n_units,
            "chunk": self.chunk,
            "seed": self.seed,
            "settings": settings,
            "version": __version__,
            "code": [code_digest(), _file_digest(self.experiment)],
        }
        text = json.dumps(inputs, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def _file_digest(experiment: Experiment) -> str:
    """Of the file that the experiment is in, which need not belong to the package."""
    file = getattr(sys.modules.get(experiment.__module__), "__file__", None)
    return hashlib.sha256(Path(file).read_bytes()).hexdigest() if file else ""


def run(
    campaign: Campaign,
    folder: Path | None = None,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> dict[str, Array]:
    """Rows of all units of the `campaign`, in their order: columns with the units that the experiment
    gives them (um, deg, ...).

    `folder` keeps finished chunks, each campaign in a folder of its own below it: the same call after a
    kill continues there. `scheduler` is the address of a Dask scheduler ("tcp://host:8786"); otherwise
    `workers` processes of this machine compute, or with one this process itself. `progress` is called
    with (units done, units in all).

    InputError, when all other chunks are kept, where units kill their worker each time: it names them.
    Also where a worker of the cluster has another program than this process.
    """
    if workers < 1:
        raise InputError(f"{workers} workers: at least 1")
    tell = progress or (lambda done, total: None)
    chunks = campaign.chunks()
    store = _Store(folder, campaign)
    found = {i: rows for i in range(len(chunks)) if (rows := store.load(i)) is not None}
    done = sum(len(chunks[i]) for i in found)
    tell(done, campaign.n_units)
    missing = {i: units for i, units in enumerate(chunks) if i not in found}
    with contextlib.closing(_computed(campaign, missing, workers, scheduler)) as results:
        for i, rows in results:
            store.save(i, rows)
            found[i] = rows
            done += len(chunks[i])
            tell(done, campaign.n_units)
    return _joined([found[i] for i in range(len(chunks))])


def forget(campaign: Campaign, folder: Path) -> None:
    """Throws the finished chunks of a campaign away, when its result is safe elsewhere."""
    shutil.rmtree(_place(folder, campaign), ignore_errors=True)
    with contextlib.suppress(OSError):  # others may keep theirs beside it
        (folder / "chunks").rmdir()


def _joined(parts: list[Rows]) -> dict[str, Array]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


# computing


def _compute(campaign: Campaign, units: range) -> Rows:
    """One chunk, wherever this runs; every column has a row for each unit."""
    rows = campaign.experiment(units, campaign.seed, campaign.settings)
    wrong = [name for name, column in rows.items() if len(column) % len(units)]
    if wrong:
        raise ValueError(f"campaign {campaign.name}: '{wrong[0]}' has no equal share for {len(units)} units")
    return rows


def _computed(
    campaign: Campaign, missing: Mapping[int, range], workers: int, scheduler: str | None
) -> Generator[tuple[int, Rows], None, None]:
    """Chunks as they come; nothing is started where nothing is missing.

    InputError at the end, when all that can be computed is kept, where a chunk kills its workers.
    """
    if not missing:
        return
    deadly = Deadly({})
    with _workers(workers, scheduler) as chosen:
        yield from computed(chosen, functools.partial(_compute, campaign), missing, deadly)
    if deadly.found:
        raise InputError(f"campaign {campaign.name}: {_killers(missing, deadly)}")


def _workers(workers: int, scheduler: str | None) -> AbstractContextManager[Workers]:
    if scheduler is not None:
        return cluster(scheduler)
    return contextlib.nullcontext(Here() if workers == 1 else Processes(workers))


def _killers(missing: Mapping[int, range], deadly: Deadly) -> str:
    """Which units kill their workers, and what to do."""
    named = ", ".join(f"{missing[i][0]} to {missing[i][-1]}" for i in sorted(deadly.found))
    last = next(reversed(deadly.found.values())).worker
    rest = "the campaign ends here" if deadly.many else "all others are done"
    return (
        f"units {named} kill their worker each time, alone too (the last: {last}; out of memory?); {rest}, "
        "and what is finished is kept: run the same again, with more memory for each worker"
    )


# keeping


def _place(folder: Path, campaign: Campaign) -> Path:
    return folder / "chunks" / f"{campaign.name}-{campaign.key()}"


class _Store:
    """Finished chunks as files; without a folder, nowhere."""

    def __init__(self, folder: Path | None, campaign: Campaign) -> None:
        self._folder = None if folder is None else _place(folder, campaign)
        if self._folder is not None:
            self._folder.mkdir(parents=True, exist_ok=True)

    def load(self, chunk: int) -> Rows | None:
        if self._folder is None:
            return None
        # a file that cannot be read is a chunk that is missing
        with (
            contextlib.suppress(OSError, ValueError, EOFError, zipfile.BadZipFile),
            self._path(chunk).open("rb") as raw,
            np.load(raw, allow_pickle=False) as file,
        ):
            return {name: file[name] for name in file.files}
        return None

    def save(self, chunk: int, rows: Rows) -> None:
        if self._folder is None:
            return
        with whole(self._path(chunk)) as part, part.open("wb") as file:
            np.savez(file, **rows)  # type: ignore[arg-type]  # mypy takes a row for allow_pickle
            file.flush()
            os.fsync(file.fileno())

    def _path(self, chunk: int) -> Path:
        assert self._folder is not None
        return self._folder / f"{chunk:06d}.npz"
