"""Memory that a process holds and does not use: little of it, and given back where a process runs for hours.

The allocator of the GNU C library has a heap for each of several threads. What a plan or an image has
needed stays free in the heap of the thread that made it; the next one is made by another thread, and
takes memory anew: twelve fields of 500 positioners took a process from 0.6 to 1.2 GB
(`benchmarks.night.long`, before this was there). Two heaps are enough: threads of the host seldom allocate
at the same time.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

HEAPS = 2
"""At most, of a process that runs for hours."""
LARGE_BYTES = 4 * 2**20
"""Blocks from this size on are pages of their own, given back as soon as they are free. By default the size
grows with the blocks that are freed, up to 32 MiB; then tables of a plan lie in the heap, and what is behind
them holds it.
"""
_M_ARENA_MAX, _M_MMAP_THRESHOLD = -8, -3
"""Of malloc.h."""


@cache
def _of_c_library(name: str) -> Any:
    """A function of the GNU C library; None: another library, which has no such heaps."""
    try:
        return getattr(ctypes.CDLL(None), name)
    except (AttributeError, OSError, TypeError):
        return None


def few_heaps() -> None:
    """Threads to come share `HEAPS` heaps and use again what others left free; large blocks are in none."""
    if (mallopt := _of_c_library("mallopt")) is not None:
        mallopt(ctypes.c_int(_M_ARENA_MAX), ctypes.c_int(HEAPS))
        mallopt(ctypes.c_int(_M_MMAP_THRESHOLD), ctypes.c_int(LARGE_BYTES))


def give_back() -> None:
    """Gives the free pages of all heaps back to the system. Takes some 10 ms, without Python's lock."""
    if (trim := _of_c_library("malloc_trim")) is not None:
        trim(ctypes.c_size_t(0))
