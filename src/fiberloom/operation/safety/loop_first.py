"""The event loop before the other threads of the process, as long as it has to hear a bus or a stop.

Threads of Python take turns. One that computes keeps its turn for 5 ms by default, and the loop waits as long
each time it has read or sent something. And now and then the interpreter looks through all there is for what
can be forgotten: every thread waits meanwhile, 0.1 s and more once everything is imported.
"""

from __future__ import annotations

import gc
import sys
from typing import ClassVar

TURN_S = 0.001
"""How long the turn of a thread lasts where another one waits."""


class LoopFirst:
    """Short turns, and no search through what is there, from `begin` to `end`; or within `with`.

    Both are of the whole process: they end with the last of several.
    """

    _begun: ClassVar[set[LoopFirst]] = set()
    _turn_s: ClassVar[float]
    """As it was before."""

    def __enter__(self) -> None:
        self.begin()

    def __exit__(self, *error: object) -> None:
        self.end()

    def begin(self) -> None:
        """From now on; a second time, what has come since is not searched either."""
        if not self._begun:
            LoopFirst._turn_s = sys.getswitchinterval()
        self._begun.add(self)
        sys.setswitchinterval(min(self._turn_s, TURN_S))
        gc.freeze()

    def end(self) -> None:
        """As before, unless another one goes on; nothing where it was not begun."""
        if self not in self._begun:
            return
        self._begun.discard(self)
        if not self._begun:
            sys.setswitchinterval(self._turn_s)
            gc.unfreeze()
