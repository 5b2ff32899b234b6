"""Processes of our own for what would hold up this one. Each ends with its pipe, however this one ends."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from multiprocessing.connection import Connection

END_S = 5.0
"""So long one may take to end by itself."""


def begin_child(module: str) -> tuple[subprocess.Popen[bytes], Connection]:
    """A new process that calls `main(fd)` of `module`, and this end of the pipe to it.

    `fd`: number of its end of the pipe, for `multiprocessing.connection.Connection`. It must end when that
    does. What it writes to stderr goes where this process writes. OSError where no process can be begun.
    """
    here, there = socket.socketpair()
    ways = os.pathsep.join(way for way in sys.path if way)
    with there:
        process = subprocess.Popen(
            [sys.executable, "-c", f"from {module} import main; main({there.fileno()})"],
            pass_fds=[there.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": ways},
        )
    return process, Connection(here.detach())


def end_child(process: subprocess.Popen[bytes], connection: Connection) -> None:
    """Ends the pipe and waits for the `process`, which is killed after `END_S`."""
    connection.close()
    try:
        process.wait(END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
