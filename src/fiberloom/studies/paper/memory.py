"""How much memory a part of a run has held at most, where the system tells."""

from __future__ import annotations

import contextlib
from pathlib import Path

_CLEAR, _STATUS = Path("/proc/self/clear_refs"), Path("/proc/self/status")
_PEAK = "VmHWM:"
_KIB_PER_GIB = 2**20


def forget_peak() -> None:
    """From now on `peak_gib` counts anew (Linux, proc_pid_clear_refs); nothing where that is not allowed."""
    with contextlib.suppress(OSError):
        _CLEAR.write_text("5")


def peak_gib() -> float:
    """Most memory in GiB that this process has held since `forget_peak`; NaN where it is not told."""
    try:
        lines = _STATUS.read_text().splitlines()
    except OSError:
        return float("nan")
    told = [line.split()[1] for line in lines if line.startswith(_PEAK)]
    return int(told[0]) / _KIB_PER_GIB if told else float("nan")
