"""Who computes the chunks of a campaign: processes of this machine, or the workers of a Dask cluster.

A worker that dies takes the chunk with it that it computes, and perhaps others that were given to it. So each
one that was lost is tried once more and alone: a chunk whose worker dies then too is what kills it.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import platform
import signal
import socket
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    Future,
    ProcessPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Protocol, cast

import numpy as np
import scipy

from fiberloom.errors import InputError, one_line
from fiberloom.typing import Array
from fiberloom.version import __version__, code_digest

Rows = Mapping[str, Array]
Task = Callable[[range], Rows]
"""Rows of some units; it can be pickled."""

CONNECT_S = 10.0
"""How long a Dask scheduler may take to answer."""
ABSENT_S = 300.0
"""How long a scheduler may have no worker at all, before the campaign ends."""
LOOK_S = 2.0
"""Between two looks whether there are workers."""
FETCH_S = 60.0
"""For the rows of one chunk that is done, from its worker."""
MOST_SUSPECTS = 6
"""Chunks that are lost before they are tried alone."""
MOST_DEADLY = 3
"""Chunks that kill their workers each time, before the campaign ends: something is wrong with all of them."""


@dataclass(frozen=True)
class Death:
    """What is there in place of rows: the worker has died."""

    worker: str


class Workers(Protocol):
    """Compute chunks."""

    def results(
        self, task: Task, chunks: Mapping[int, range]
    ) -> Generator[tuple[int, Rows | Death], None, None]:
        """Rows of each chunk, as they come; `chunks`: units by number of the chunk."""
        ...


@dataclass
class Deadly:
    """Chunks that kill their workers each time, with the last worker."""

    found: dict[int, Death]

    @property
    def many(self) -> bool:
        """So many that no chunk can be expected to do better."""
        return len(self.found) >= MOST_DEADLY


def computed(
    workers: Workers, task: Task, chunks: Mapping[int, range], deadly: Deadly
) -> Generator[tuple[int, Rows], None, None]:
    """Rows of the chunks as they come, but of those that kill their workers: these go into `deadly`.

    `workers`: who computes; `task`: what; `chunks`: units by number of the chunk.
    """
    waiting = dict(chunks)
    while waiting and not deadly.many:
        suspects: dict[int, range] = {}
        with contextlib.closing(workers.results(task, dict(waiting))) as results:
            for i, rows in results:
                units = waiting.pop(i)
                if isinstance(rows, Death):
                    suspects[i] = units
                else:
                    yield i, rows
                if len(suspects) == MOST_SUSPECTS:
                    break
        yield from _alone(workers, task, suspects, deadly)


def _alone(
    workers: Workers, task: Task, suspects: Mapping[int, range], deadly: Deadly
) -> Generator[tuple[int, Rows], None, None]:
    """One after the other, with no other chunk on the way."""
    for i, units in suspects.items():
        if deadly.many:
            return
        for _, rows in workers.results(task, {i: units}):
            if isinstance(rows, Death):
                deadly.found[i] = rows
            else:
                yield i, rows


# this machine


@dataclass(frozen=True)
class Here:
    """This process itself: nothing is started, and a death is its own."""

    def results(
        self, task: Task, chunks: Mapping[int, range]
    ) -> Generator[tuple[int, Rows | Death], None, None]:
        """See `Workers`."""
        for i, units in chunks.items():
            yield i, task(units)


@dataclass(frozen=True)
class Processes:
    """Processes of this machine."""

    n: int

    def results(
        self, task: Task, chunks: Mapping[int, range]
    ) -> Generator[tuple[int, Rows | Death], None, None]:
        """See `Workers`. A process that dies ends all of its pool; another pool goes on."""
        waiting = dict(chunks)
        while waiting:
            with _pool(min(self.n, len(waiting))) as pool:
                yield from _until_one_dies(pool, self.n, task, waiting)


def _until_one_dies(
    pool: ProcessPoolExecutor, n: int, task: Task, waiting: dict[int, range]
) -> Generator[tuple[int, Rows | Death], None, None]:
    """Takes what is `waiting`, `n` chunks at a time: no more than there are processes to lose them."""
    begun: dict[Future[Rows], int] = {}
    whole = True
    while begun or (waiting and whole):
        while waiting and whole and len(begun) < n:
            whole = _begin(pool, task, waiting, begun)
        done, _ = wait(begun, return_when=FIRST_COMPLETED)
        for future in done:
            rows = _rows_or_death(future)
            whole = whole and not isinstance(rows, Death)
            yield begun.pop(future), rows


def _begin(
    pool: ProcessPoolExecutor, task: Task, waiting: dict[int, range], begun: dict[Future[Rows], int]
) -> bool:
    """Gives the first chunk that is waiting to the pool; False where that is broken by now."""
    i, units = next(iter(waiting.items()))
    try:
        begun[pool.submit(task, units)] = i
    except BrokenProcessPool:
        return False
    del waiting[i]
    return True


def _rows_or_death(future: Future[Rows]) -> Rows | Death:
    try:
        return future.result()
    except BrokenProcessPool:
        return Death(f"a process of {socket.gethostname()}")


@contextlib.contextmanager
def _pool(n: int) -> Iterator[ProcessPoolExecutor]:
    before = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")  # the twin has threads, which a fork would lose
    pool = ProcessPoolExecutor(n, mp_context=context, initializer=_leave_interrupts_to_the_caller)
    try:
        yield pool
    except BaseException:
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()  # or a Ctrl-C would wait for chunks to end
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _leave_interrupts_to_the_caller() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


# a cluster


def versions() -> dict[str, str]:
    """What has to be the same wherever chunks of one campaign are computed."""
    return {
        "fiberloom": f"{__version__} (code {code_digest()})",
        "Python": platform.python_version().rpartition(".")[0],
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


@dataclass(frozen=True)
class SameCode:
    """A task that is refused where another program would compute it.

    With each chunk, not once at the beginning: workers come and go.
    """

    task: Task
    wanted: Mapping[str, str]

    def __call__(self, units: range) -> Rows:
        """The rows of `units`. InputError, which names the worker, where a version differs."""
        here = versions()
        for name, wanted in self.wanted.items():
            if here[name] != wanted:
                raise InputError(
                    f"worker {socket.gethostname()} (process {os.getpid()}) has {name} {here[name]}, the "
                    f"caller {wanted}: install the same on both"
                )
        return self.task(units)


class Cluster:
    """The workers of a Dask scheduler."""

    def __init__(self, client: Any, address: str) -> None:
        self._client, self._address = client, address

    def results(
        self, task: Task, chunks: Mapping[int, range]
    ) -> Generator[tuple[int, Rows | Death], None, None]:
        """See `Workers`. InputError where the scheduler or every worker has gone, or another program runs."""
        same = SameCode(task, versions())
        begun = {self._client.submit(same, units, pure=False): i for i, units in chunks.items()}
        try:
            for future, rows in self._as_completed(set(begun)):
                yield begun[future], rows
        finally:
            self._client.cancel(list(begun))

    def _as_completed(self, begun: set[Any]) -> Iterator[tuple[Any, Rows | Death]]:
        absent_s = 0.0
        while begun:
            for future in (done := self._done(begun)):
                rows = self._rows_or_death(future)
                if rows is not None:
                    begun.remove(future)
                    yield future, rows
            absent_s = 0.0 if done or self._has_workers() else absent_s + LOOK_S
            if absent_s >= ABSENT_S:
                raise InputError(
                    f"--scheduler {self._address}: no worker for {ABSENT_S:.0f} s; what is finished is kept: "
                    f"start workers ('dask worker {self._address}') and run the same again"
                )

    def _done(self, begun: set[Any]) -> list[Any]:
        from distributed import CancelledError
        from distributed import wait as wait_for

        try:
            some = wait_for(begun, timeout=LOOK_S, return_when="FIRST_COMPLETED")  # type: ignore[no-untyped-call]
            return list(some.done)
        except TimeoutError:
            return []
        except CancelledError:
            raise self._gone() from None

    def _has_workers(self) -> bool:
        try:
            return bool(self._client.scheduler_info()["workers"])
        except OSError:
            raise self._gone() from None

    def _rows_or_death(self, future: Any) -> Rows | Death | None:
        """None where its worker has died with the rows before they were fetched: they are computed again."""
        from distributed import CancelledError, KilledWorker

        try:
            return cast("Rows", future.result(timeout=FETCH_S))
        except KilledWorker as error:
            return Death(f"worker {error.last_worker.address}")
        except TimeoutError:
            return None
        except CancelledError:
            raise self._gone() from None
        except (ModuleNotFoundError, RuntimeError) as error:
            missing = error.__cause__ or error  # the scheduler wraps it
            if not isinstance(missing, ModuleNotFoundError):
                raise
            raise InputError(
                f"--scheduler {self._address}: {one_line(missing)} there; install the same on the scheduler "
                "and its workers"
            ) from None

    def _gone(self) -> InputError:
        return InputError(
            f"--scheduler {self._address}: the scheduler has gone; what is finished is kept: start it, and "
            "run the same again"
        )


@contextlib.contextmanager
def cluster(address: str) -> Iterator[Cluster]:
    """The cluster whose scheduler has the address ("tcp://host:8786"). InputError where none answers."""
    with _client(address) as client:
        yield Cluster(client, address)


def _client(address: str) -> Any:
    from distributed import Client

    try:
        return Client(address, timeout=CONNECT_S)  # type: ignore[no-untyped-call]  # Dask has no types here
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there ({str(error) or type(error).__name__}); "
            "start one with 'dask scheduler', or leave the option out"
        ) from None
