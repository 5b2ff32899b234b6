"""Where there is no event loop: the one place below the command line that starts one."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

from fiberloom.errors import InputError

Result = TypeVar("Result")


def finish(task: Coroutine[Any, Any, Result]) -> Result:
    """Runs a coroutine to its end and returns its result.

    Where an event loop runs already, as in Jupyter, nothing can wait for it: an InputError says to use
    `await` instead.
    """
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return asyncio.run(task)
    name = getattr(task, "__name__", "observe")
    task.close()  # it was never begun, and nothing will
    raise InputError(
        f"an event loop is running here, as in Jupyter: write `await field.{name}(...)` "
        f"in place of `field.run.{name}(...)`"
    )
