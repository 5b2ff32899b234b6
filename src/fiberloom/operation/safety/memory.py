"""Memory that a process holds and does not use: given back to the system where it runs for hours.

The allocator of the GNU C library has a heap for each of several threads. What a plan or an image has
needed stays free in the heap of the thread that made it; the next one is made by another thread, and
takes memory anew: twelve fields of 500 positioners took a process from 0.6 to 1.2 GB
(`benchmarks.night.long`, before this was there).
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any


@cache
def _trim() -> Any:
    """`malloc_trim` of the C library; None: it has none, and none is needed."""
    try:
        return ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):
        return None


def give_back() -> None:
    """Gives the free pages of all heaps back to the system. Takes some 10 ms, without Python's lock."""
    if (trim := _trim()) is not None:
        trim(ctypes.c_size_t(0))
