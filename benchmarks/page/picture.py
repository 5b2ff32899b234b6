"""`python -m benchmarks.page.picture [docs/images/page.png]`: the picture of the page in README and docs.

`fiberloom serve` on the twin, a target list, and one observation: the page in the middle of a motion, after
some positioners were found to be faulty. It takes minutes where their maps are not in the cache.
"""

from __future__ import annotations

import argparse
import json
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import fiberloom as fl
from fiberloom.targets import random_targets, write_targets

from .chromium import SIZE, launched

FAULTS = "dead=1,dark=2"
PATIENCE_S = 1800.0
LIST = "field.csv"


class Served:
    """The service of an array of the twin, asked over HTTP."""

    def __init__(self, folder: Path, positioners: int) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            listen = f"127.0.0.1:{free.getsockname()[1]}"
        self.url = f"http://{listen}"
        words = ["--positioners", str(positioners), "--faults", FAULTS, "--out", str(folder)]
        program = [sys.executable, "-m", "fiberloom.cli", "serve", "--listen", listen, *words]
        self.process = subprocess.Popen(program, stdout=subprocess.DEVNULL)

    def ask(self, path: str, body: Any = None) -> Any:
        """What is answered; to a command where there is a body."""
        headers = {"X-Fiberloom": "1", "Origin": self.url, "Content-Type": "application/json"}
        content = None if body is None else json.dumps(body).encode()
        with urllib.request.urlopen(urllib.request.Request(self.url + path, content, headers)) as answer:
            return json.load(answer)

    def ready(self) -> bool:
        """A command could begin. SystemExit where the service has ended."""
        if self.process.poll() is not None:
            raise SystemExit(f"the service has ended with exit code {self.process.returncode}")
        try:
            return all(self.ask("/readyz").values()) and self.ask("/api/v1/state")["running"] is None
        except OSError:
            return False

    def end(self) -> None:
        """What moves is stopped, and the service ends."""
        self.process.send_signal(signal.SIGTERM)
        self.process.wait()


@contextmanager
def observing(positioners: int, seed: int) -> Iterator[Served]:
    """The service of so many, which observes a list of targets that is drawn by `seed`."""
    plane = fl.FocalPlane.of("sdssv", n=positioners)
    with tempfile.TemporaryDirectory(prefix="fiberloom-page-") as made:
        folder = Path(made)
        (folder / "targets").mkdir()
        write_targets(random_targets(plane, 3 * positioners, seed), folder / "targets" / LIST)
        service = Served(folder, positioners)
        try:
            until(service.ready)
            service.ask("/api/v1/observe", {"targets": LIST})
            yield service
        finally:
            service.end()


def until(condition: Any) -> None:
    """Waits. SystemExit where it does not come."""
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end_s:
            raise SystemExit(f"it has not come within {PATIENCE_S:.0f} s")
        time.sleep(0.2)


MID = """() => { const { model } = fiberloom;
  const half = model.plan && model.time_s > 0.5 * model.plan.duration_s;
  return half && model.alarms.length > 0 && model.planAbout.label.startsWith("blind"); }"""
"""In the middle of a blind move, after positioners were found to be faulty."""


def main() -> int:
    """Makes the picture; exit code 0."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("file", type=Path, nargs="?", default=Path("docs/images/page.png"))
    parser.add_argument("--positioners", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright, observing(asked.positioners, asked.seed) as service:
        browser = launched(playwright)
        page = browser.new_page(viewport=SIZE)
        page.goto(service.url)
        until(lambda: page.evaluate(MID))
        page.screenshot(path=asked.file)
        browser.close()
    print(asked.file)
    return 0


if __name__ == "__main__":
    sys.exit(main())
