"""Commands of the package in processes of their own."""

import contextlib
import random
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import fiberloom


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
    """A TCP port that nobody listens on, below those the system hands to others meanwhile (32768 up)."""
    while True:
        port = random.SystemRandom().randrange(10_000, 32_768)
        with contextlib.suppress(OSError), socket.socket() as probe:
            probe.bind(("127.0.0.1", port))
            return port


def small_camera(folder: Path) -> Path:
    """SDSS-V as a file, with a camera of a megapixel, which is painted and sent in a moment."""
    text = (Path(fiberloom.__file__).parent / "instruments" / "presets" / "sdssv.toml").read_text()
    for key, value in (("width_px", "1000"), ("height_px", "1022"), ("scale_mm_px", "0.729")):
        text, n = re.subn(rf"^{key} = [\d.]+", f"{key} = {value}", text, flags=re.MULTILINE)
        assert n == 1
    path = folder / "small.toml"
    path.write_text(text)
    return path


@contextlib.contextmanager
def serving(*words: object) -> Iterator[tuple[str, str]]:
    """`fiberloom twin` with these words and an Alpaca camera: where its bus and its camera listen."""
    bus, camera = f"127.0.0.1:{free_port()}", f"127.0.0.1:{free_port()}"
    with start("twin", *words, "--listen", bus, "--camera-listen", camera, stdout=subprocess.PIPE) as served:
        try:
            said = [served.stdout.readline() for _ in range(2)]
            assert said[1].startswith("camera: alpaca://"), [*said, served.communicate(timeout=120)]
            yield bus, camera
        finally:
            served.terminate()
            served.communicate(timeout=120)


@contextlib.contextmanager
def served_array(positioners: int, seed: int = 0, instrument: object = "sdssv") -> Iterator[tuple[str, str]]:
    """Bus and camera of a twin in another process, by their addresses."""
    words = ("--instrument", instrument, "--positioners", positioners, "--seed", seed)
    with serving(*words) as (bus, camera):
        yield f"cannet://{bus}", f"alpaca://{camera}/0?deadline=120"
