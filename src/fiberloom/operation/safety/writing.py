"""Beside the event loop: what takes long, and what is written.

The loop has to hear the bus, so that a stop acts at once. A commit of a database takes 10 ms and more, where
a disk is busy a second.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, asynccontextmanager
from typing import Any, TypeVar

from fiberloom.metrology import Measurement
from fiberloom.operation.move import Move, Recorder
from fiberloom.operation.safety.stop import to_its_end
from fiberloom.typing import Flags, Floats

Result = TypeVar("Result")


async def beside(work: Callable[..., Result], *arguments: Any) -> Result:
    """The result of `work(*arguments)`, done in a thread, to its end even if the caller is cancelled."""
    return await to_its_end(asyncio.to_thread(work, *arguments))


@asynccontextmanager
async def entered(
    make: Callable[..., AbstractContextManager[Result]], *arguments: Any
) -> AsyncIterator[Result]:
    """The context `make(*arguments)`: made, begun and ended in a thread; ended whatever happens meanwhile."""
    stack = ExitStack()
    try:
        yield await beside(lambda: stack.enter_context(make(*arguments)))
    except BaseException as error:
        if not await beside(stack.__exit__, type(error), error, error.__traceback__):
            raise
    else:
        await beside(stack.close)


class Writer:
    """One thread that writes in the order in which it is asked to.

    What is handed over is written whatever happens to the caller. What fails is raised where the caller
    waits next, which is before anything moves.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="fiberloom-writer")
        self._waiting: list[Future[Any]] = []

    def later(self, work: Callable[..., Result], *arguments: Any) -> Future[Result]:
        """Hands over `work(*arguments)`."""
        future = self._thread.submit(work, *arguments)
        self._waiting.append(future)
        return future

    async def now(self, work: Callable[..., Result], *arguments: Any) -> Result:
        """The result of `work(*arguments)`, after all that was handed over before; errors as in `written`."""
        future = self.later(work, *arguments)
        await self.written()
        return future.result()

    async def written(self) -> None:
        """Waits until all is written, even if the caller is cancelled; raises the first error since the last
        time."""
        waiting, self._waiting = self._waiting, []
        await to_its_end(_done(waiting[-1:]))  # one thread, so those before it are done, too
        for future in waiting:
            future.result()

    async def close(self) -> None:
        """As `written`; the thread ends."""
        try:
            await self.written()
        finally:
            self._thread.shutdown(wait=False)


async def _done(waiting: list[Future[Any]]) -> None:
    await asyncio.gather(*map(asyncio.wrap_future, waiting), return_exceptions=True)


class WriterRecorder:
    """Implements `Recorder`: hands everything to a writer, as it is at that time."""

    def __init__(self, recorder: Recorder, writer: Writer) -> None:
        self._recorder, self._writer = recorder, writer

    def start(self, here_deg: Floats, wire_deg: Floats, image: Measurement) -> None:
        """Writes where every positioner is before the first move: angles and wire positions (N, 2)."""
        self._writer.later(self._recorder.start, here_deg.copy(), wire_deg.copy(), image)

    def move(self, move: Move) -> None:
        """Writes a move."""
        self._writer.later(self._recorder.move, move)

    def left(self, here_deg: Floats, wire_deg: Floats, answered: Flags, why: str) -> None:
        """Writes where each was left after a stop.

        `here_deg`, `wire_deg`: (N, 2) angles and wire positions as reported; `answered` (N,): which have;
        `why`: for the operator.
        """
        self._writer.later(self._recorder.left, here_deg.copy(), wire_deg.copy(), answered.copy(), why)

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """Writes a fault or a remark."""
        self._writer.later(self._recorder.event, kind, text, positioner_id)
