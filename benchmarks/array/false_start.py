"""Positioners that are not where they report: does one move from a false place, does anything touch?

    python benchmarks/array/false_start.py [--positioners N] [--seeds N] [--first SEED] [--unchecked]

For each seed a field of the twin is deployed; then one positioner is made to believe a wrong alpha (3, 40 or
180 deg off, in turn), or, in every fourth seed, one is off and dark as well. The next field is begun, as
a new process would. Counted: positioners that moved from a false place, contacts in the twin's own truth,
and how many of the others reached their goals. `--unchecked` believes what is reported, for comparison.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
from dataclasses import dataclass, replace

import numpy as np
from events import EventsOnly

from fiberloom.bus.client import Client
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.move import Goals
from fiberloom.planning import random_configuration
from fiberloom.twin.draw import draw_units
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.faults.kinds import FaultKind
from fiberloom.twin.hardware import field_hardware

CASES = ("3 deg off", "40 deg off", "180 deg off", "40 deg off and dark")


@dataclass(frozen=True)
class Outcome:
    """What one seed came to."""

    case: str
    moved_deg: float
    """How far the false positioner went."""
    contacts: int
    reached: int
    """Others whose fibre came within half a millimetre of its goal."""
    blocked: int
    others: int


def run(plane: FocalPlane, maps: TransmissionMaps, seed: int, unchecked: bool) -> Outcome:
    """One deployed field, one false positioner, one further move."""
    case = CASES[seed % len(CASES)]
    rng = np.random.default_rng([seed, 0xFA])
    row = int(rng.integers(len(plane)))
    # as it is left by an observation
    deployed = random_configuration(plane, seed)
    hardware = field_hardware(plane, draw_units(plane, 0), seed, camera="noise")
    return asyncio.run(_begin(plane, maps, hardware, deployed, row, case, seed, unchecked))


async def _begin(
    plane: FocalPlane,
    maps: TransmissionMaps,
    hardware: Hardware,
    deployed: np.ndarray,
    row: int,
    case: str,
    seed: int,
    unchecked: bool,
) -> Outcome:
    twin = hardware.truth
    first = FieldMotion(plane, maps, hardware, EventsOnly())
    await first.connect()
    await first.go(Goals.without_targets(plane, deployed), seed)
    ids = [int(plane.positioner_id[row])]
    here = first.state.wire_deg[row]
    false_deg = float(case.split()[0]) * (1 if seed % 8 < 4 else -1)
    # within the travel, so that the firmware takes it
    low, high = plane.hard_stops_deg[0]
    alpha = here[0] + false_deg if low + 1 < here[0] + false_deg < high - 1 else here[0] - false_deg
    client = Client(hardware.transport)
    client.ids = ids
    declared = await client.set_position(ids, alpha, here[1])
    assert declared.ok.all(), declared
    if "dark" in case:
        twin.inject(Fault(FaultKind.DARK, ids[0]))
    twin.touches()
    before = twin.truth()[row]
    vouched = np.ones(len(plane), dtype=bool) if unchecked else None
    second = FieldMotion(plane, maps, replace(hardware, vouched=vouched), EventsOnly())
    if unchecked:
        second.state.begin = lambda *_: None
    await second.connect()
    goal = random_configuration(plane, seed + 100_000)
    await second.go(Goals.without_targets(plane, goal), seed)
    reached_mm = np.hypot(*(twin.fibre_xy() - plane.forward(*goal.T)).T)
    others = np.arange(len(plane)) != row
    return Outcome(
        case,
        float(np.abs(twin.truth()[row] - before).max()),
        len(twin.touches()),
        int((reached_mm[others] < 0.5).sum()),
        int(second.state.blocked[others].sum()),
        int(others.sum()),
    )


def main() -> int:
    """Exit code 1 where a false positioner moved or anything touched."""
    parser = argparse.ArgumentParser(description="positioners that are not where they report")
    parser.add_argument("--positioners", type=int, default=500)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--unchecked", action="store_true", help="believe what is reported")
    given = parser.parse_args()
    plane = FocalPlane.of("sdssv", n=given.positioners)
    maps = _maps(plane)
    found = []
    for seed in range(given.first, given.first + given.seeds):
        found.append(run(plane, maps, seed, given.unchecked))
        print(f"seed {seed}: {found[-1]}", file=sys.stderr, flush=True)
    print(f"{given.positioners} positioners, {len(found)} seeds{', unchecked' if given.unchecked else ''}")
    print(f"{'':22}{'seeds':>6}{'moved':>7}{'contacts':>10}{'others there':>14}{'blocked':>9}")
    for case in CASES:
        rows = [f for f in found if f.case == case]
        if rows:
            moved = sum(f.moved_deg > 0.5 for f in rows)
            there = f"{sum(f.reached for f in rows)} of {sum(f.others for f in rows)}"
            print(f"{case:22}{len(rows):6}{moved:7}{sum(f.contacts for f in rows):10}{there:>14}"
                  f"{sum(f.blocked for f in rows):9}")  # fmt: skip
    return 1 if any(f.moved_deg > 0.5 or f.contacts for f in found) else 0


def _maps(plane: FocalPlane) -> TransmissionMaps:
    from fiberloom.field import Field

    return Field.twin(plane, camera="noise").run.calibrate()


if __name__ == "__main__":
    sys.exit(main())
