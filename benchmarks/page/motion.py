"""An array that is served, and whose positioners go to and fro for the page: no twin computes them.

Moves are planned and told to the service as a motion tells them, by a clock of the wall; so the messages on
the stream are those of an array of that size, and the processor's time is that of the service alone.

    python -m benchmarks.page.motion --positioners 5000     # prints its address; until it is told to end
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import signal
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import uvicorn

import fiberloom as fl
from fiberloom.connect import open_hardware
from fiberloom.field import Field
from fiberloom.health.status import FibreStatus
from fiberloom.instruments.model import METROLOGY
from fiberloom.metrology import Measurement
from fiberloom.operation.move import Goals, Move
from fiberloom.operation.session.states import Deed
from fiberloom.operation.session.witness import BegunMove
from fiberloom.planning import Plan, random_configuration
from fiberloom.planning.trajectories import Trajectory
from fiberloom.service.array import Author, ServedArray
from fiberloom.service.guard.tokens import Identity, Role
from fiberloom.service.guard.wall import Gate, hosts_of
from fiberloom.service.hub import Hub
from fiberloom.service.web.app import application
from fiberloom.service.web.target_root import TargetRoot
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM

HOST = "127.0.0.1"
REST_S = 1.0
"""Between two moves."""
SHARES = {FibreStatus.ON_TARGET: 0.9, FibreStatus.OFF_TARGET: 0.05, FibreStatus.BLOCKED: 0.02,
          FibreStatus.PARKED: 0.02, FibreStatus.DARK: 0.005, FibreStatus.DEAD: 0.005}  # fmt: skip
"""Of the positioners after a move."""
ERROR_MM = 0.004
"""Scatter of the errors that the page is shown, of each coordinate."""


class ToAndFro:
    """Tells a served array of one move after another, there and back, as a motion does."""

    def __init__(self, array: ServedArray, there: Plan, seed: int = 0, rest_s: float = REST_S) -> None:
        """`array`: that is told; `there`: the way of its positioners; `seed`: of states and errors; `rest_s`:
        between two moves."""
        self.array, self.plane, self.rest_s = array, array.field.plane, rest_s
        self.rng = np.random.default_rng(seed)
        self.plans = there, reversed_plan(there)
        self.made = 0

    def run(self, over: threading.Event) -> None:
        """One after the other until it is `over`, all of them in one command."""

        async def work() -> str:
            while not over.is_set():
                await asyncio.to_thread(self.once, over)
            return f"{self.made} moves"

        self.array.ask("observe", Deed.OBSERVE, Author("benchmark", "engineer"), {}, work, "")
        over.wait()

    def once(self, over: threading.Event) -> None:
        """The next move, from its begin to its image and the rest after it; ends early when it is `over`."""
        live, plan = self.array.live, self.plans[self.made % 2]
        goals = self.begin(plan)
        over.wait(plan.duration_s)
        live.say("image")
        live.move(self._seen(plan, goals))
        live.rests(plan.end_deg)
        self.made += 1
        over.wait(self.rest_s)

    def begin(self, plan: Plan) -> Goals:
        """The begin of a move by this `plan`; its goals."""
        live, n = self.array.live, len(self.plane)
        goals = Goals(plan.end_deg, np.zeros(n), np.full(n, ""), np.ones(n, dtype=bool))
        live.say("blind move")
        live.begins(BegunMove(1, "blind", plan, goals, time.monotonic))
        live.started(time.monotonic())
        return goals

    def _seen(self, plan: Plan, goals: Goals) -> Move:
        n, end_deg = len(self.plane), plan.end_deg
        off_mm = self.rng.normal(0.0, ERROR_MM, (n, 2))
        goal_mm = self.plane.forward(end_deg[:, 0], end_deg[:, 1], METROLOGY)
        x_mm, y_mm = (goal_mm + off_mm).T
        seen = Measurement(x_mm, y_mm, np.ones(n, dtype=bool), 0.0)
        drawn = self.rng.choice(len(SHARES), n, p=list(SHARES.values()))
        status = [list(SHARES)[k] for k in drawn]
        error_um = UM_PER_MM * np.hypot(*off_mm.T)
        return Move(1, "blind", plan, end_deg, end_deg, seen, error_um, None, status)


def straight_plan(plane: fl.FocalPlane, from_deg: Floats, to_deg: Floats, lasts_s: float) -> Plan:
    """Every positioner of a `plane` at once from (N, 2) deg to (N, 2) deg in so many seconds, whoever is in
    its way: for the eye alone."""
    time_s = np.array([0.0, lasts_s])
    ways = (
        Trajectory(number, time_s, *np.stack(ends, axis=1))
        for number, *ends in zip(plane.positioner_id.tolist(), from_deg, to_deg, strict=True)
    )
    return Plan(plane.instrument.name, plane.collision_buffer_mm, tuple(ways))


def reversed_plan(plan: Plan) -> Plan:
    """The way back: every positioner along its own, with time reversed."""
    last_s = plan.duration_s

    def back(way: Trajectory) -> Trajectory:
        time_s = last_s - way.time_s[::-1]
        return Trajectory(way.positioner_id, time_s, way.alpha_deg[::-1], way.beta_deg[::-1])

    return Plan(plan.instrument, plan.collision_buffer_mm, tuple(map(back, plan.robots)))


@contextlib.contextmanager
def standing(plane: fl.FocalPlane, folder: Path) -> Iterator[ServedArray]:
    """The array of a `plane`, without maps, at its folded places; its store is in a `folder`."""
    with Store.open(folder / "store.sqlite") as store:
        field = Field(plane, open_hardware(plane, "twin:", "noise"))
        array = ServedArray(field, ArrayBook(store, "twin:page"), "twin:", folder, Hub())
        array.begin(calibrate=False)
        try:
            yield array
        finally:
            array.close()


@contextlib.contextmanager
def served(array: ServedArray, folder: Path) -> Iterator[str]:
    """The real service of an `array` in a thread; its address."""
    sock = socket.socket()
    sock.bind((HOST, 0))
    port = sock.getsockname()[1]
    gate = Gate(hosts_of(HOST, port, ()), "http", None, Identity("local", Role.ENGINEER))
    app = application(array, gate, TargetRoot(folder / "targets"))
    how: dict[str, Any] = {"ws": "websockets-sansio", "log_config": None, "timeout_graceful_shutdown": 1}
    server = uvicorn.Server(uvicorn.Config(app, **how))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [sock]}, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    try:
        yield f"http://{HOST}:{port}"
    finally:
        server.should_exit = True
        thread.join()


def main() -> None:
    """Serves until SIGTERM or Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--positioners", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    over = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: over.set())
    plane = fl.FocalPlane.of("sdssv", seed=asked.seed, n=asked.positioners)
    there = fl.plan(plane, *(random_configuration(plane, asked.seed + k) for k in range(2)))
    with tempfile.TemporaryDirectory(prefix="fiberloom-page-") as made:
        folder = Path(made)
        with standing(plane, folder) as array, served(array, folder) as url:
            print(url, flush=True)
            ToAndFro(array, there, asked.seed).run(over)


if __name__ == "__main__":
    main()
