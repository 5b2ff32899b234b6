"""Many seeds, each in a process of its own with a deadline; every result is a line of a file at once.

What is in the file is not computed again: a campaign goes on where it was stopped.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from fiberloom.calibration.transmission.cache import load_for
from fiberloom.errors import InputError
from fiberloom.field import Field
from fiberloom.instruments import FocalPlane
from fiberloom.twin import draw_units
from fiberloom.version import __version__

from .draw import draw
from .one_seed import FORK, Array, die_with_parent, run_seed

LINES = "seeds.jsonl"
LOOK_S = 0.5
ARRAYS = 4
"""Different layouts and units; seeds take them in turn."""
Line = dict[str, Any]
Work = Callable[[int, Path], Line]
"""What a seed does in its process: seed and a file for what it prints, to its line."""


def interruptible(out: Path, work: Callable[[], int]) -> int:
    """The exit code of `work`, which keeps its lines in `out`: 130 after Ctrl-C, 2 for bad input."""
    for stop in (signal.SIGINT, signal.SIGTERM):  # a shell takes Ctrl-C from what it runs behind it
        signal.signal(stop, signal.default_int_handler)
    try:
        return work()
    except KeyboardInterrupt:
        print(f"interrupted; what is done is kept in {out}: run the same again", file=sys.stderr)
        return 130
    except InputError as error:
        print(error, file=sys.stderr)
        return 2


@dataclass
class Running:
    """A seed under way."""

    seed: int
    process: BaseProcess
    pipe: Connection
    end_s: float
    log: Path


@dataclass(frozen=True)
class Campaign:
    """Where results are, how many run at once, and how long one may take."""

    folder: Path
    work: Work
    workers: int = 1
    deadline_s: float = 300.0

    def lines(self) -> dict[int, Line]:
        """What is known of seeds; a line that is cut short was not written."""
        found: dict[int, Line] = {}
        with contextlib.suppress(FileNotFoundError):
            for text in (self.folder / LINES).read_text().splitlines():
                with contextlib.suppress(json.JSONDecodeError):
                    line = json.loads(text)
                    found[line["seed"]] = line
        return found

    def run(self, seeds: Sequence[int], tell: Callable[[Line], None] = lambda _: None) -> dict[int, Line]:
        """The lines of these seeds; `tell` is called with each that is new."""
        with _alone(self.folder):
            _mend(self.folder / LINES)
            found = self.lines()
            missing = [seed for seed in seeds if seed not in found]
            for line in self._computed(missing):
                self._keep(line)
                found[line["seed"]] = line
                tell(line)
        return {seed: found[seed] for seed in seeds}

    def _keep(self, line: Line) -> None:
        with (self.folder / LINES).open("a") as file:
            file.write(json.dumps(line) + "\n")
            file.flush()
            os.fsync(file.fileno())

    def _computed(self, seeds: list[int]) -> Iterator[Line]:
        left, running = list(seeds), []
        try:
            while left or running:
                while left and len(running) < self.workers:
                    running.append(self._start(left.pop(0)))
                yield from self._collected(running)
        finally:
            for one in running:
                _end(one)

    def _start(self, seed: int) -> Running:
        ours, theirs = FORK.Pipe(duplex=False)
        log = self.folder / f"seed-{seed}.log"
        process = FORK.Process(target=partial(_work, self.work), args=(seed, log, theirs))
        process.start()
        theirs.close()
        return Running(seed, process, ours, time.monotonic() + self.deadline_s, log)

    def _collected(self, running: list[Running]) -> Iterator[Line]:
        """Waits for what comes first: a result, a death, a deadline."""
        wait([one.pipe for one in running], timeout=LOOK_S)
        for one in list(running):
            # its commands hold the pipe too: a death does not show there
            over = one.pipe.poll() or not one.process.is_alive()
            if over or time.monotonic() >= one.end_s:
                line = _line_of(one, over)
                running.remove(one)
                _end(one)
                yield line


def _line_of(one: Running, over: bool) -> Line:
    if not over:
        return {"seed": one.seed, "hang": True}
    try:
        if not one.pipe.poll():
            raise EOFError
        line: Line = one.pipe.recv()
    except (EOFError, ConnectionError):
        one.process.join()
        said = one.log.read_text(errors="replace")[-1500:] if one.log.exists() else ""
        return {"seed": one.seed, "crash": f"the seed's process ended with {one.process.exitcode}\n{said}"}
    return line


def _end(one: Running) -> None:
    """Ends a seed with all of its processes; it has a group of its own."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        assert one.process.pid
        os.killpg(one.process.pid, signal.SIGKILL)
    one.process.kill()
    one.process.join()
    one.pipe.close()


def _work(work: Work, seed: int, log: Path, pipe: Connection) -> None:
    """In the process of a seed."""
    os.setpgid(0, 0)
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the campaign ends it
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with log.open("w") as file:
        os.dup2(file.fileno(), 2)
        os.dup2(file.fileno(), 1)
    try:
        line = work(seed, log)
    except Exception:
        with log.open("a") as file:
            traceback.print_exc(file=file)
        raise
    pipe.send({"version": __version__} | line)


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Two campaigns in one folder would do the same seeds."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(f"{folder}: another campaign runs there; choose another folder") from None
        yield


def _mend(path: Path) -> None:
    """The end of a line that a kill has cut short."""
    if path.exists() and (text := path.read_text()) and not text.endswith("\n"):
        path.write_text(text[: text.rfind("\n") + 1])


# the array


def observed(arrays: Sequence[Array], seed: int, log: Path) -> Line:
    """One seed of the fault campaign."""
    array = arrays[seed % len(arrays)]
    scene = draw(seed, array.plane.positioner_id)
    line = run_seed(array, scene, log)
    if not line["crash"]:
        log.unlink(missing_ok=True)
    return line


def arrays_of(positioners: int, folder: Path, count: int = ARRAYS) -> list[Array]:
    """Layouts with their units and maps; the maps are swept once."""
    return [_array(positioners, seed, folder) for seed in range(count)]


def _array(positioners: int, seed: int, folder: Path) -> Array:
    plane = FocalPlane.of("sdssv", n=positioners, seed=seed)
    file = folder / f"maps-{positioners}-{seed}.npz"
    folder.mkdir(parents=True, exist_ok=True)
    # elsewhere: its twin has threads, and seeds are forked from here
    sweep = FORK.Process(target=_sweep, args=(plane, seed, file))
    sweep.start()
    sweep.join()
    options = ("--positioners", str(positioners), "--seed", str(seed))
    return Array(plane, draw_units(plane, seed), load_for(plane, file), file, options)


def _sweep(plane: FocalPlane, seed: int, file: Path) -> None:
    Field.twin(plane, seed=seed, camera="noise").run.calibrate().save(file)
