"""How much memory a part of a run has held at most, where the system tells."""

from __future__ import annotations

import contextlib
from pathlib import Path

_CLEAR, _STATUS = Path("/proc/self/clear_refs"), Path("/proc/self/status")
_PEAK = "VmHWM:"
_BYTES_PER_KIB = 2**10


def forget_peak() -> None:
    """From now on `peak_bytes` counts anew (Linux, clear_refs); nothing where that is not allowed."""
    with contextlib.suppress(OSError):
        _CLEAR.write_text("5")


def peak_bytes() -> float:
    """Most memory that this process has held since `forget_peak`, in bytes; NaN where it is not told."""
    try:
        lines = _STATUS.read_text().splitlines()
    except OSError:
        return float("nan")
    told = [line.split()[1] for line in lines if line.startswith(_PEAK)]
    return float(int(told[0]) * _BYTES_PER_KIB) if told else float("nan")
