"""Stopping: what has begun to stop is carried to its end."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

Result = TypeVar("Result")


async def to_its_end(work: Coroutine[Any, Any, Result]) -> Result:
    """Runs `work` to its end even if the caller is cancelled meanwhile; the cancellation is raised then."""
    task = asyncio.ensure_future(work)
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.shield(task)
        except asyncio.CancelledError as error:
            cancelled = error
        except Exception:  # of the work: raised below, from where it was
            break
    if cancelled is not None:
        raise cancelled
    return task.result()


def reason(error: BaseException) -> str:
    """Why everything is stopped, in the words of an operator."""
    if isinstance(error, (asyncio.CancelledError, KeyboardInterrupt)):
        return "stopped by the operator"
    return f"stopped after an error: {str(error) or type(error).__name__}"
