"""Where there is no event loop: the one place below the command line that starts one."""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from fiberloom.errors import InputError

Result = TypeVar("Result")

STOPS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Ctrl-C, a request to end, a terminal that is gone: each stops the positioners."""


class _Stopped(Exception):
    """A signal has ended the task."""


def finish(task: Coroutine[Any, Any, Result]) -> Result:
    """Runs a coroutine to its end and returns its result.

    The first of STOPS cancels the task, which then stops what it has set in motion; further ones are not
    heeded, so that the stopping is not stopped. KeyboardInterrupt afterwards. Where an event loop runs
    already, as in Jupyter, nothing can wait for it: an InputError says to use `await` instead.
    """
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        try:
            return asyncio.run(_until_stopped(task))
        except _Stopped:
            raise KeyboardInterrupt from None
    name = getattr(task, "__name__", "observe")
    task.close()  # it was never begun, and nothing will
    raise InputError(
        f"an event loop is running here, as in Jupyter: write `await field.{name}(...)` "
        f"in place of `field.run.{name}(...)`"
    )


async def _until_stopped(task: Coroutine[Any, Any, Result]) -> Result:
    work = asyncio.ensure_future(task)
    signals: list[int] = []

    def stop(number: int) -> None:
        if not signals:
            work.cancel()
        signals.append(number)

    with _heeding(stop):
        try:
            return await work
        except asyncio.CancelledError:
            if signals:
                raise _Stopped from None
            raise


@contextmanager
def _heeding(stop: Any) -> Iterator[None]:
    """Calls `stop` with the number of a signal; those that the shell took from this process stay ignored."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    loop = asyncio.get_running_loop()
    before = {number: signal.getsignal(number) for number in STOPS}
    heeded = {number: old for number, old in before.items() if old not in (signal.SIG_IGN, None)}
    for number in heeded:
        loop.add_signal_handler(number, stop, number)
    try:
        yield
    finally:
        for number, old in heeded.items():
            loop.remove_signal_handler(number)
            signal.signal(number, old)
