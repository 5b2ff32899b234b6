"""Is the process that started a run still there?"""

from __future__ import annotations

import os
import socket
from pathlib import Path


def host_name() -> str:
    """This machine."""
    return socket.gethostname()


def process_start(pid: int) -> str:
    """When the kernel started a process, in its own clock: a reused number shows. Else empty."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""
    # the name in brackets may hold blanks; the start time is the 20th field after it
    return f"{boot}:{stat.rpartition(')')[2].split()[19]}"


def is_alive(host: str, pid: int, started: str) -> bool:
    """False when the process is certainly gone. Of other machines it is not known: True."""
    if host != host_name():
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass  # there, but not ours
    return not started or process_start(pid) in ("", started)
