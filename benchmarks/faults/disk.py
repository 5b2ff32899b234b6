"""A disk of its own for one seed, that can be full: a small tmpfs which nobody else sees."""

from __future__ import annotations

import contextlib
import ctypes
import os
from pathlib import Path

_NEW_MOUNTS, _NEW_USER = 0x00020000, 0x10000000
_PRIVATE = 0x4000 | 0x40000
"""MS_REC | MS_PRIVATE"""
SIZE = 32 << 20
BLOCK = 4096


def mounted(folder: Path) -> bool:
    """Mounts it over a folder, for this process and its children; False where that is not allowed."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(_NEW_MOUNTS) and libc.unshare(_NEW_MOUNTS | _NEW_USER):
        return False
    libc.mount(b"none", b"/", None, _PRIVATE, None)
    options = f"size={SIZE}".encode()
    return not libc.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", 0, options)


class Ballast:
    """What fills the disk."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "ballast"

    def fill(self, left: float) -> bool:
        """Writes until so many bytes are left; True."""
        with self._file.open("wb", buffering=0) as file, contextlib.suppress(OSError):
            while file.write(bytes(BLOCK)) == BLOCK:
                pass
        size = self._file.stat().st_size
        os.truncate(self._file, max(size - int(left) // BLOCK * BLOCK, 0))
        return True

    def away(self) -> None:
        """The operator has made room."""
        self._file.unlink(missing_ok=True)
