"""Positioners that do not do their part in a move: contacts in the twin's own truth, and what is flagged.

    python benchmarks/array/silent.py --starts 100 --mutes 20 --losses 10 --out silent.json

Every seed is another array of 61 positioners on the virtual twin, another field and another victim. A
contact is two bodies that touch, as the twin itself knows it; a flag is a fault at the end of the
observation.
`--unwatched` shows what came of it before motions were watched: no poll between START and the planned end.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from events import EventsOnly

from fiberloom.assignment.assign import Assignment
from fiberloom.calibration.transmission.maps import identity
from fiberloom.health.status import FAULTS
from fiberloom.instruments import FocalPlane, generate, load_instrument
from fiberloom.instruments.model import METROLOGY
from fiberloom.operation import motion as operation
from fiberloom.operation.loop import Loop, LoopSettings
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.safety.deviation import MotionRule
from fiberloom.planning import random_pair
from fiberloom.twin import draw_units
from fiberloom.twin.hardware import draw_faults, field_hardware

N = 61
START_FAULTS = ("nostart", "refuse", "reboot")
SILENT_FAULTS = ("mute", "deaf")
SILENT_AT_S = (3.0, 10.0, 15.0)
SHARES = (0.001, 0.01)
WITHIN_UM = 20.0
"""Maps are linear here, and the third move ends well within this."""


@dataclass
class Seen:
    """What came of one observation."""

    seed: int
    faults: str
    victims: list[int]
    contacts: int
    flagged: dict[int, str]
    moves: int
    missed: list[int]
    """Healthy positioners whose fibre is not within 20 um of its goal in the end."""
    events: list[str]


def goals_of(plane: FocalPlane, goal_deg: np.ndarray) -> Assignment:
    """A target for every positioner, where the random configuration has its metrology fibre."""
    n = len(plane)
    return Assignment(
        target=np.arange(n),
        fibre=np.full(n, METROLOGY),
        alpha_deg=goal_deg[:, 0],
        beta_deg=goal_deg[:, 1],
        approach_deg=np.full(n, plane.instrument.approach_deg),
        clearance_mm=np.full(n, np.inf),
        unassigned={},
        notes=[],
    )


async def observation(seed: int, faults: str) -> Seen:
    """A blind move into a random configuration and two corrections, with these faults."""
    plane = generate(load_instrument("sdssv"), seed=seed, n_positioners=N)
    hardware = field_hardware(plane, draw_units(plane, seed), seed, faults=faults)
    recorder = EventsOnly()
    motion = FieldMotion(plane, identity(plane.positioner_id), hardware, recorder)
    loop = Loop(motion, goals_of(plane, random_pair(plane, seed)[1]), LoopSettings(moves=3, seed=seed))
    try:
        await motion.connect()
        await loop.run()
    finally:
        await motion.close()
    state, last = motion.state, motion.moves[-1]
    far = ~(last.measured_error_um <= WITHIN_UM) & state.healthy
    rows = np.flatnonzero([fault in FAULTS for fault in state.faults])
    return Seen(
        seed=seed,
        faults=faults,
        victims=[f.positioner_id for f in draw_faults(plane, faults, seed) if f.positioner_id],
        contacts=len(hardware.truth.touches()),
        flagged={int(plane.positioner_id[i]): str(state.faults[i]) for i in rows},
        moves=len(motion.moves),
        missed=plane.positioner_id[far].tolist(),
        events=recorder.lines(),
    )


def observe(watched: bool, case: tuple[int, str]) -> Seen:
    """One case: seed and faults."""
    if not watched:
        operation.MotionRule = partial(MotionRule, poll_s=math.inf)
    return asyncio.run(observation(*case))


def report(name: str, seen: list[Seen]) -> dict[str, Any]:
    """One line of the table: runs, runs with contacts, flags of others than the victims."""
    wrong = {s.seed: sorted(set(s.flagged) - set(s.victims)) for s in seen}
    line = {
        "runs": len(seen),
        "runs with contacts": sum(s.contacts > 0 for s in seen),
        "contacts": sum(s.contacts for s in seen),
        "healthy ones flagged": sum(map(len, wrong.values())),
        "victims flagged": sum(len(set(s.flagged) & set(s.victims)) for s in seen),
        "victims": sum(len(s.victims) for s in seen),
        "healthy ones not at their goal": sum(len(s.missed) for s in seen),
        "of": sum(N - len(s.flagged) for s in seen),
    }
    print(f"{name:14s} " + ", ".join(f"{k} {v}" for k, v in line.items()), flush=True)
    return line


def cases(asked: argparse.Namespace) -> Iterable[tuple[str, list[tuple[int, str]]]]:
    """Names, and the seeds with their faults."""
    for kind in START_FAULTS:
        yield kind, [(seed, f"{kind}=1") for seed in range(asked.starts)]
    for kind in SILENT_FAULTS:
        times = [SILENT_AT_S[seed % len(SILENT_AT_S)] for seed in range(asked.mutes)]
        yield kind, [(seed, f"{kind}=1@{at_s:g}") for seed, at_s in enumerate(times)]
    for share in SHARES:
        yield f"lost {share:g}", [(seed, f"lost={share:g}") for seed in range(asked.losses)]


def main() -> None:
    """Run what the command line asks for."""
    asked = arguments()
    figures, runs = {}, {}
    with ProcessPoolExecutor(asked.workers) as pool:
        for name, wanted in cases(asked):
            if wanted and (not asked.only or name.split()[0] in asked.only.split(",")):
                runs[name] = list(pool.map(partial(observe, not asked.unwatched), wanted))
                figures[name] = report(name, runs[name])
    if asked.out:
        whole = {"figures": figures, "runs": {k: [asdict(s) for s in v] for k, v in runs.items()}}
        asked.out.write_text(json.dumps(whole, indent=1) + "\n")


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=24, help="seeds for each fault at START")
    parser.add_argument("--mutes", type=int, default=20, help="seeds for each way to fall silent")
    parser.add_argument("--losses", type=int, default=10, help="seeds for each share of lost replies")
    parser.add_argument("--only", default="", help="kinds, e.g. nostart,mute")
    parser.add_argument("--unwatched", action="store_true", help="no polls between START and the end")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, help="JSON file")
    return parser.parse_args()


if __name__ == "__main__":
    main()
