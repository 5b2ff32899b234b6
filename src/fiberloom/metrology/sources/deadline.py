"""Until when one exposure may take, and the way to give it up from another thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from fiberloom.metrology.sources.errors import CameraAborted, CameraSilent


class Deadline:
    """Of one exposure of `camera`, `allowed_s` seconds from now. Leave it by `close`.

    Functions given to `at_end` are called once, in another thread, when the time is over or `abort` was
    called: they close what the exposure waits for, so that no read outlives the deadline.
    """

    def __init__(self, camera: str, allowed_s: float) -> None:
        self.camera, self.allowed_s = camera, allowed_s
        self.doing = "exposing"
        """What the exposure is at, for the message."""
        self._end_s = time.monotonic() + allowed_s
        self._over, self._aborted = threading.Event(), False
        self._closing: list[Callable[[], None]] = []
        self._lock = threading.Lock()
        self._timer = threading.Timer(allowed_s, self._end)
        self._timer.daemon = True
        self._timer.start()

    def abort(self) -> None:
        """Gives up the exposure, from any thread."""
        self._aborted = True
        self._end()

    def close(self) -> None:
        """The exposure is over: nothing is called any more."""
        self._timer.cancel()
        with self._lock:
            self._closing = []

    def at_end(self, function: Callable[[], None]) -> None:
        """Calls this at the deadline, or when aborted; at once where that was before."""
        with self._lock:
            if not self._over.is_set():
                self._closing.append(function)
                return
        function()

    def check(self) -> None:
        """Raises CameraAborted or CameraSilent where it is over."""
        if self._aborted:
            raise CameraAborted(f"{self.camera}: the exposure was given up")
        if self._over.is_set() or time.monotonic() >= self._end_s:
            raise CameraSilent(
                f"{self.camera}: no image after {self.allowed_s:g} s, while {self.doing}; "
                "look at the camera's program, or give it longer with deadline="
            )

    def left_s(self) -> float:
        """Seconds that are left; raises as `check` where none are."""
        self.check()
        return max(self._end_s - time.monotonic(), 1e-3)

    def wait(self, wait_s: float, event: threading.Event | None = None) -> None:
        """Lets time pass, at most to the end, then checks; `event` ends it earlier and is then cleared.

        Give `event.set` to `at_end`, so that an abort ends it too.
        """
        left_s = self._end_s - time.monotonic()
        (event or self._over).wait(max(min(wait_s, left_s), 0.0))
        if event is not None:
            event.clear()
        self.check()

    def _end(self) -> None:
        with self._lock:
            self._over.set()
            closing, self._closing = self._closing, []
        for function in closing:
            function()
