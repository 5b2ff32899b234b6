"""What processes use, as Linux counts it: CPU time and memory of one and of all that it has begun."""

from __future__ import annotations

import os
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_PROC = Path("/proc")


def tree(pid: int) -> list[int]:
    """A process and all that it, and those, have begun."""
    parents = {int(place.name): _parent(place) for place in _PROC.glob("[0-9]*")}
    found = [pid]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found


def kind(pid: int) -> str:
    """Of a process of Chromium: browser, renderer, gpu-process and others; empty: of no Chromium."""
    try:
        words = (
            (_PROC / str(pid) / "cmdline").read_bytes().decode(errors="replace").replace("\0", " ").split()
        )
    except OSError:
        return ""
    if not words or "chrom" not in words[0]:
        return ""
    return next((w.removeprefix("--type=") for w in words if w.startswith("--type=")), "browser")


def cpu_s(pid: int) -> float:
    """CPU time of a process so far, s; 0 for one that has ended."""
    words = _stat(_PROC / str(pid))
    return (int(words[11]) + int(words[12])) / _TICKS_PER_S if words else 0.0


def memory_mb(pid: int) -> float:
    """Memory of a process, its part of what is shared, MB; 0 for one that has ended."""
    try:
        text = (_PROC / str(pid) / "smaps_rollup").read_text()
    except OSError:
        return 0.0
    rows = (line.split() for line in text.splitlines())
    return sum(int(row[1]) for row in rows if row[0] == "Pss:") / 1024


def _stat(place: Path) -> list[str]:
    """The words after the name of the program, from the state on."""
    try:
        return (place / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return []


def _parent(place: Path) -> int:
    words = _stat(place)
    return int(words[1]) if words else 0
