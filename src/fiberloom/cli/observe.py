"""`fiberloom observe`: from a target list to fibres on target."""

from __future__ import annotations

import asyncio
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from fiberloom.assignment import Assignment, assign_relaxed
from fiberloom.cli.learnt import Known, known_so_far
from fiberloom.cli.terminal import Waiting, waiting
from fiberloom.cli.transmission import calibrated_maps, maps_path
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.operation.exposures import ExposureLog
from fiberloom.operation.loop import Loop, LoopSettings
from fiberloom.operation.recording import StoreRecorder
from fiberloom.operation.results import Observed, summarise, write_results
from fiberloom.report.outputs import marks, prepare_folder
from fiberloom.report.tables import observation_table
from fiberloom.store import Store
from fiberloom.targets import TargetList, read_targets
from fiberloom.twin import draw_units, field_hardware, put_in


@dataclass(frozen=True)
class ObserveRequest:
    """What the command line asked for."""

    targets: Path
    out: Path
    seed: int = 0
    moves: int | None = None
    """Exactly so many, the blind one counted; None: the instrument's stop rule."""
    correction: str | None = None
    camera: str = "noise"
    pages: str = "last"
    save_images: bool = False
    faults: str = ""
    compare_linear: bool = False
    calibration: Path | None = None
    arms: Path | None = None
    """File of `calibrate focal-plane`."""
    adapt: bool = False
    """Learn from every measured move."""
    learnt: str | None = None
    """Store of what was learnt; default with `adapt`: beside the maps."""
    quiet: bool = False


def run_observe(plane: FocalPlane, request: ObserveRequest) -> dict[str, Any]:
    """Observe on the twin; returns summary.json's content and prints the closing table."""
    started_s = time.monotonic()
    targets = read_targets(request.targets)
    out = prepare_folder(request.out)
    with waiting(request.quiet) as wait:
        units = draw_units(plane, request.seed)
        maps = calibrated_maps(plane, units, request.seed, wait, path=request.calibration)
        file = maps_path(plane, units, request.seed, request.calibration)
        known = known_so_far(plane, maps, file, request.arms, request.learnt, request.adapt, request.seed)
        wait.say("assigning targets")
        kept, assignment = assign_relaxed(known.plane, targets, seed=request.seed)
        hardware = field_hardware(plane, units, request.seed, faults=request.faults, camera=request.camera)
        log = ExposureLog(plane, out, request.pages, request.save_images)
        log.watch(hardware.camera)
        observed = _observe(kept, targets, assignment, known, hardware, request, wait)
        log.close()
    summary = summarise(observed) | marks(plane, request.seed)
    summary |= {"wall_s": time.monotonic() - started_s, "not_assigned": _reasons(assignment)}
    summary |= {"notes": assignment.notes, "put_in": put_in(plane, request.camera)}
    summary |= known.summary()
    write_results(observed, summary, out)
    if not request.quiet:
        _close(summary, out)
    return summary


def _observe(
    plane: FocalPlane,
    targets: TargetList,
    assignment: Assignment,
    known: Known,
    hardware: Hardware,
    request: ObserveRequest,
    wait: Waiting,
) -> Observed:
    operation = plane.instrument.operation
    settings = LoopSettings.of(
        operation,
        request.moves,
        filtered=(request.correction or operation.correction) == "filtered",
        compare_linear=request.compare_linear,
        seed=request.seed,
    )
    store = Store.open(request.out / "store.sqlite")
    with store.start_run(
        command_line=" ".join(sys.argv),
        instrument=plane.instrument.name,
        config_hash=plane.config_hash(),
        seed=request.seed,
    ) as run:
        recorder = known.learning(StoreRecorder(run, plane, targets, assignment))
        loop = Loop(
            plane, assignment, known.maps, hardware, settings, recorder, wait.say, known.map_sigma_deg
        )
        known.record_used(run)
        asyncio.run(_whole(loop))
        known.record_learnt(run)
    return Observed(plane, targets, assignment, loop.moves, loop.collisions_verified, loop.stopped)


async def _whole(loop: Loop) -> None:
    try:
        await loop.connect()
        await loop.run()
    finally:
        await loop.client.close()


def _reasons(assignment: Assignment) -> dict[str, int]:
    """How many targets were left out, by the first words of the reason."""
    counts: dict[str, int] = {}
    for reason in assignment.unassigned.values():
        short = reason.split(":")[0].split("(")[0].strip()
        counts[short] = counts.get(short, 0) + 1
    return counts


def _close(summary: dict[str, Any], out: Path) -> None:
    console = Console()
    console.print(observation_table(summary))
    console.print(f"corrections ended: {summary['stopped']}")
    console.print(
        f"planning {summary['plan_cpu_s']:.1f} CPU s, motion {summary['motion_s']:.1f} s, "
        f"{summary['collisions_verified']} collisions in verified trajectories; "
        f"everything took {summary['wall_s']:.0f} s"
    )
    for note in summary["notes"]:
        console.print(f"note: {note}")
    if "learnt" in summary:
        console.print(
            "learnt: {moves} moves of generation {generation} in {store}".format(**summary["learnt"])
        )
    for kind, positioners in summary["faults"].items():
        console.print(f"flagged {kind}: {', '.join(map(str, positioners))}", style="red")
    console.print(f"results in {out}/: summary.json, fibres.ecsv, trajectories.json, *.png")
