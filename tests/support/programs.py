"""Commands of the package in processes of their own."""

import signal
import subprocess
import sys


def heeding_interrupts() -> None:
    """In the new process: Ctrl-C as on a terminal. Shells take it from what they run behind them."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def start(*words: object, **options: object) -> subprocess.Popen:
    """`fiberloom` with these words, its stderr piped; Ctrl-C reaches it."""
    return subprocess.Popen(
        [sys.executable, "-m", "fiberloom.cli", *map(str, words)],
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heeding_interrupts,
        **options,
    )
