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
import hashlib
import json
import multiprocessing
import os
import shutil
import signal
import zipfile
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.errors import InputError
from fiberloom.typing import Array
from fiberloom.version import __version__
from fiberloom.wholefile import whole

Rows = Mapping[str, Array]
Experiment = Callable[[range, int, Any], Rows]
Progress = Callable[[int, int], None]
"""Called with (units done, units in all)."""
CONNECT_S = 10.0
"""How long a Dask scheduler may take to answer."""


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
        """16 hex digits that change with anything the rows depend on."""
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
        }
        text = json.dumps(inputs, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


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
    """
    if workers < 1:
        raise InputError(f"{workers} workers: at least 1")
    tell = progress or (lambda done, total: None)
    chunks = campaign.chunks()
    store = _Store(folder, campaign)
    found = {i: rows for i in range(len(chunks)) if (rows := store.load(i)) is not None}
    done = sum(len(chunks[i]) for i in found)
    tell(done, campaign.n_units)
    missing = [i for i in range(len(chunks)) if i not in found]
    with contextlib.closing(_computed(campaign, chunks, missing, workers, scheduler)) as results:
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
    campaign: Campaign, chunks: list[range], missing: list[int], workers: int, scheduler: str | None
) -> Generator[tuple[int, Rows], None, None]:
    """Chunks as they come; nothing is started where nothing is missing."""
    if not missing:
        return
    if scheduler is None and workers == 1:
        for i in missing:
            yield i, _compute(campaign, chunks[i])
        return
    with _executor(workers, scheduler) as executor:
        futures = {executor.submit(_compute, campaign, chunks[i]): i for i in missing}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenProcessPool:
            raise InputError(
                f"campaign {campaign.name}: a worker process died (out of memory?); "
                "what is finished is kept: run the same again, with fewer workers"
            ) from None
        finally:
            for future in futures:
                future.cancel()


@contextlib.contextmanager
def _executor(workers: int, scheduler: str | None) -> Iterator[Executor]:
    if scheduler is not None:
        with _cluster(scheduler) as client:
            yield client.get_executor(pure=False)
        return
    before = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")  # the twin has threads, which a fork would lose
    executor = ProcessPoolExecutor(workers, mp_context=context, initializer=_leave_interrupts_to_the_caller)
    try:
        yield executor
    except BaseException:
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()  # or a Ctrl-C would wait for chunks to end
        raise
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


def _leave_interrupts_to_the_caller() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _cluster(address: str) -> Any:
    from distributed import Client

    try:
        return Client(address, timeout=CONNECT_S)  # type: ignore[no-untyped-call]  # Dask has no types here
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there ({str(error) or type(error).__name__}); "
            "start one with 'dask scheduler', or leave the option out"
        ) from None


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
