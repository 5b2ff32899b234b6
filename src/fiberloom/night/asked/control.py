"""What people ask of a night that goes on: pause it, go on, park at once."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine
from typing import Any


class NightControl:
    """Orders to a night of this process. Methods may be called from any thread; they return at once."""

    def __init__(self) -> None:
        self.paused_by = ""
        """Who has paused it; empty: it goes on."""
        self.parked_by = ""
        """Who has asked to park and to end it; empty: none."""
        self._lock = threading.Lock()
        self._task: asyncio.Task[None] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    def pause(self, who: str) -> None:
        """Nothing begins after what is under way; `who` asks."""
        self.paused_by = who

    def go_on(self) -> None:
        """The night goes on."""
        self.paused_by = ""

    def park(self, who: str) -> None:
        """Ends what moves or waits, then folds all and ends the night; `who` asks."""
        with self._lock:
            self.parked_by, task, loop = who, self._task, self._loop
        if task is not None and loop is not None and not loop.is_closed():
            loop.call_soon_threadsafe(task.cancel)

    async def run(self, work: Coroutine[Any, Any, None]) -> bool:
        """Runs `work`, which is ended where a park is asked for meanwhile; whether it came to its end."""
        task = asyncio.ensure_future(work)
        with self._lock:
            self._task, self._loop = task, asyncio.get_running_loop()
            asked = bool(self.parked_by)
        if asked:
            task.cancel()
        try:
            await task
        except asyncio.CancelledError:
            mine = asyncio.current_task()
            if not self.parked_by or mine is None or mine.cancelling():
                raise
            return False
        finally:
            self._task = None
        return True
