"""`fiberloom observe`: from a target list to fibres on target."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from fiberloom.cli.terminal import waiting
from fiberloom.field import Field, ObserveOptions
from fiberloom.instruments import FocalPlane
from fiberloom.report.outputs import prepare_folder
from fiberloom.report.tables import observation_table
from fiberloom.targets import read_targets


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

    @property
    def corrections(self) -> int | None:
        """Moves after the blind one."""
        return None if self.moves is None else self.moves - 1

    def options(self) -> ObserveOptions:
        """What `Field.observe` takes by name."""
        return {
            "correction": self.correction,
            "compare_linear": self.compare_linear,
            "arms": self.arms,
            "learnt": self.learnt,
            "adapt": self.adapt,
            "pages": self.pages,
            "save_images": self.save_images,
        }


def run_observe(plane: FocalPlane, request: ObserveRequest) -> dict[str, Any]:
    """Observe on the twin; returns summary.json's content and prints the closing table."""
    started_s = time.monotonic()
    targets = read_targets(request.targets)
    out = prepare_folder(request.out)
    field = Field.twin(plane, request.seed, request.camera, request.faults, request.calibration)
    field.command_line = " ".join(sys.argv)
    with waiting(request.quiet) as field.watcher:
        seen = field.run.observe(targets, request.corrections, out=out, **request.options())
    seen = replace(seen, wall_s=time.monotonic() - started_s)
    seen.save(out)
    summary = seen.summary()
    if not request.quiet:
        _close(summary, out)
    return summary


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
