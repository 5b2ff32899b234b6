"""The bench of the command line: a twin of some positioners, alone under a camera, with weights."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.calibration.bench.bench import Progress
from fiberloom.calibration.bench.estimate import Estimate
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Camera
from fiberloom.report.outputs import marks
from fiberloom.twin import NoiseCamera, Twin, TwinTransport, TwinWeights, Units, draw_units
from fiberloom.twin.hardware import draw_faults
from fiberloom.twin.truth import true_values

Found = TypeVar("Found")

CLOSE_UP_UM = 0.101
"""Kronig 2020, Fig. 18: the camera close up, frames averaged; two-dimensional rms."""


@dataclass(frozen=True)
class BenchRequest:
    """What every bench command asks for."""

    plane: FocalPlane
    seed: int
    out: Path
    faults: str = ""
    truth: bool = False
    """Compare with what the twin knows of itself."""
    quiet: bool = False


@dataclass(frozen=True)
class BenchRig:
    """What a measurement gets: no more than an engineer has."""

    client: Client
    camera: Camera
    close_up: Camera
    weights: TwinWeights
    units: Units
    """For reports only."""


def on_bench(request: BenchRequest, whole: Callable[[BenchRig], Awaitable[Found]]) -> tuple[BenchRig, Found]:
    """Sets up the twin, finds who is there, and lets `whole` work."""
    plane, seed = request.plane, request.seed
    units = draw_units(plane, seed)
    twin = Twin(plane, units, seed=seed, neighbours=False)
    for fault in draw_faults(plane, request.faults, seed):
        twin.inject(fault)
    noise_um = plane.instrument.metrology.noise_rms_um
    rig = BenchRig(
        Client(TwinTransport(twin)),
        NoiseCamera(twin, noise_um, seed + 1),
        NoiseCamera(twin, CLOSE_UP_UM, seed + 2),
        TwinWeights(twin, seed=seed),
        units,
    )

    async def connected() -> Found:
        await rig.client.discover()
        return await whole(rig)

    return rig, asyncio.run(connected())


def counting(count: Progress) -> Progress:
    """Progress, not more often than a terminal is redrawn."""
    return lambda done, total: count(done, total) if done % 8 == 0 or done == total else None


def results(request: BenchRequest, rig: BenchRig, estimates: list[Estimate]) -> dict[str, Any]:
    """The content of the result file: a record per positioner and quantity."""
    truth = true_values(request.plane, rig.units) if request.truth else {}
    positioners = [
        {
            "positioner_id": int(number),
            "estimates": {e.name: e.record(row) | _truth(e, row, truth) for e in estimates},
        }
        for row, number in enumerate(request.plane.positioner_id)
    ]
    return marks(request.plane, request.seed) | {"bench": "twin", "positioners": positioners}


def _truth(e: Estimate, row: int, truth: dict[str, Any]) -> dict[str, float]:
    if e.name not in truth or e.reason[row]:
        return {}
    true = float(truth[e.name][row])
    off = float(e.value[row]) - true
    if e.unit == "rad":
        off = float(np.angle(np.exp(1j * off)))
    return {"true": true, "off_by_se": off / float(e.standard_error[row])}


def table_rows(content: dict[str, Any]) -> list[dict[str, Any]]:
    """One line for each positioner and quantity, for people and for ECSV."""
    rows = []
    for positioner in content["positioners"]:
        for name, record in positioner["estimates"].items():
            row = {"positioner_id": positioner["positioner_id"], "quantity": name}
            row |= {key: record.get(key) for key in ("unit", "value", "standard_error", "n")}
            row |= {key: record[key] for key in ("true", "off_by_se") if key in record}
            rows.append(row | {"reason": record.get("reason", "")})
    return rows


def refused(estimates: list[Estimate]) -> bool:
    """Whether any positioner has no estimate."""
    return any(any(e.reason) for e in estimates)
