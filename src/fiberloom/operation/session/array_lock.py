"""The lock of an array: one motion at a time, whichever process asks; and how others ask it to stop.

A thread gives the signs of life, so that they come while images are reduced and plans are made, and looks
whether another process has asked for a stop.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from fiberloom.errors import InputError
from fiberloom.operation.session.states import Deed, SessionState, Step, after, require_legal
from fiberloom.store.arrays import HEARTBEAT_S, ArrayBook, ArrayState, NotOwner

POLL_S = 0.1
"""How often the owner looks whether it is asked to stop."""

KEPT = frozenset({SessionState.IDLE, SessionState.PARKED, SessionState.STOPPED, SessionState.LOCKED})
"""States in which a command may leave an array; from any other one it is `unknown`."""

NOT_RECOVERED = "; not recovered: "
"""Between what an array is locked for and how the last try to recover it ended."""


def left_as(state: SessionState) -> SessionState:
    """The state of an array whose command ends in `state`."""
    if state is SessionState.RECOVERING:
        return SessionState.LOCKED
    return state if state in KEPT else SessionState.UNKNOWN


def state_of(row: ArrayState) -> SessionState:
    """The state of an array as the next command finds it, also where the owner was lost on the way."""
    state = SessionState(row.state)
    return left_as(state) if row.stale else state


class ForbiddenError(RuntimeError):
    """Something would move or light up at a time at which nothing may, e.g. while the shutter is open."""


class ArrayLock:
    """Owned from `take` to `release`."""

    def __init__(self, book: ArrayBook, command_line: str) -> None:
        """`book`: of the array; `command_line`: what the operator typed, for others who ask."""
        self.book, self.command_line = book, command_line
        self.state, self.text = SessionState.OFF, ""
        self.lost = False
        """Another process has taken it."""
        self.left_moving = False
        """The owner before was lost in a motion."""
        self.forbidden = ""
        """Why nothing may move and no image be taken now; empty: it may."""
        self._collision = ""
        """What an array that recovers was locked for."""
        self._token = ""
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def take(self, deed: Deed, on_stop: Callable[[str], None]) -> str:
        """Makes this process the owner; returns what the operator should know of the owner before.

        `deed`: the command that begins; `on_stop`: called in another thread, with the reason, when
        everything is to be stopped. InputError where another process owns the array, or the command is
        not legal in its state.
        """
        found = self.book.state()
        require_legal(deed, state_of(found), *self._about(found))
        begun = after(state_of(found), Step.CONNECT)
        self._token, before = self.book.take(self.command_line, begun)
        state = state_of(before)
        try:
            require_legal(deed, state, *self._about(before))  # again: it may have changed since
        except InputError:
            self.book.release(self._token, before.state, before.text)
            self._token = ""
            raise
        self.state = after(state, Step.CONNECT)
        if self.state is SessionState.RECOVERING:
            self._collision = self.text = before.text.split(NOT_RECOVERED)[0]
        self.book.enter(self._token, self.state, self.text)
        self._thread = threading.Thread(target=self._watch, args=(on_stop,), daemon=True)
        self._thread.start()
        if not before.stale:
            return ""
        self.left_moving = before.state in (SessionState.MOVING, SessionState.RECOVERING)
        gone = "has ended without a word" if before.silent_s < HEARTBEAT_S * 5 else "gives no sign of life"
        return f"taken over from {before.owner}, which {gone}; it was {before.state}"

    def _about(self, row: ArrayState) -> tuple[str, str]:
        if row.owned:
            return self.book.address, f"in use by {row.owner}"
        return self.book.address, row.text

    def step(self, step: Step, text: str = "") -> None:
        """Goes on in the table; `text` says why. NotOwner where the array was lost meanwhile,
        ForbiddenError for a motion or an image while `forbidden` says that there must be none."""
        self.check()
        if self.forbidden and step in (Step.MOVE, Step.LOOK):
            raise ForbiddenError(f"{self.book.address}: no {step} while {self.forbidden}")
        state = after(self.state, step)
        if self.state is SessionState.RECOVERING and step not in (Step.FREE, Step.COLLIDE):
            text = self._collision + (NOT_RECOVERED + text if state is SessionState.LOCKED else "")
        if (state, text) != (self.state, self.text):
            self.book.enter(self._token, state, text)
        self.state, self.text = state, text

    def check(self) -> None:
        """Raises NotOwner where another process has the array by now: nothing may be moved."""
        if self.lost:
            raise NotOwner(f"{self.book.address}: another process owns it by now; nothing more is moved")

    def release(self) -> None:
        """Gives it back, in the state that it has; nothing where it was not taken."""
        if not self._token:
            return
        self._over.set()
        if self._thread is not None:
            self._thread.join()
        self.book.release(self._token, left_as(self.state), self.text)

    def _watch(self, on_stop: Callable[[str], None]) -> None:
        beat_s, told = time.monotonic(), False
        while not self._over.wait(POLL_S):
            try:
                row = self.book.state()
                if row.token != self._token:
                    self.lost = True
                    on_stop("another process has taken the array")
                    return
                if row.stop_asked_by and not told:
                    told = True
                    on_stop(f"stopped by {row.stop_asked_by}")
                if time.monotonic() - beat_s >= HEARTBEAT_S:
                    self.book.beat(self._token)
                    beat_s = time.monotonic()
            except NotOwner:
                continue  # the next look says so
            except InputError:
                continue  # a store that is busy: the motion goes on, the next look may be better
