"""Commands of the package in processes of their own."""

import contextlib
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator


def heeding_interrupts() -> None:
    """In the new process: signals as on a terminal. A shell's & takes Ctrl-C from it, nohup the hang-up."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def start(*words: object, **options: object) -> subprocess.Popen:
    """`fiberloom` with these words, its stderr piped; Ctrl-C reaches it."""
    return subprocess.Popen(
        [sys.executable, "-m", "fiberloom.cli", *map(str, words)],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heeding_interrupts,
        **options,
    )


def free_port() -> int:
    """A TCP port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def served_array(positioners: int, seed: int = 0) -> Iterator[tuple[str, str]]:
    """Bus and camera of a twin in another process, by their addresses."""
    bus, camera = f"127.0.0.1:{free_port()}", f"127.0.0.1:{free_port()}"
    words = ["twin", "--positioners", positioners, "--seed", seed, "--listen", bus, "--camera-listen", camera]
    with start(*words, stdout=subprocess.PIPE) as served:
        try:
            served.stdout.readline()
            assert served.stdout.readline().startswith("camera: alpaca://")
            yield f"cannet://{bus}", f"alpaca://{camera}/0?deadline=120"
        finally:
            served.terminate()
            served.communicate(timeout=120)
