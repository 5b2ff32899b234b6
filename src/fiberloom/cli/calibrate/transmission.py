"""`fiberloom calibrate transmission`."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from fiberloom.cli.options import JsonOptions, PlaneOptions, require_folder
from fiberloom.cli.terminal import waiting


@dataclass(frozen=True, kw_only=True)
class TransmissionOptions(PlaneOptions, JsonOptions):
    """Of `calibrate transmission`."""

    points: Annotated[int, typer.Option(min=8, help="Points per axis and direction.")] = 200
    out: Annotated[Path, typer.Option(help="Folder for the maps.")] = Path("runs/transmission")


def transmission(options: TransmissionOptions) -> int:
    """Measure motor angle against output angle in both directions (Kronig 2020, Eq. 6 and 7).

    Exit code 1 where a positioner is refused.
    """
    options.check_plane()
    require_folder(options.out)
    from fiberloom.field import Field
    from fiberloom.report.outputs import marks
    from fiberloom.report.transmission import plot_transmission
    from fiberloom.store.calibrations import record_calibration

    out, plane = options.out, options.plane()
    field = Field.twin(plane, options.seed, camera="noise")
    with waiting(options.as_json) as field.watcher:
        calibration = field.run.sweep(options.points)
    calibration.maps.save(out / "transmission.npz")
    summary = marks(plane, options.seed) | calibration.summary()
    (out / "transmission.json").write_text(json.dumps(summary, indent=2) + "\n")
    plot_transmission(out / "transmission.png", calibration.maps, row=0)
    made = plane.positioner_id[calibration.report.ok]
    record_calibration(out / "transmission.npz", "transmission", made, summary, " ".join(sys.argv))
    options.show(summary | {"maps": str(out / "transmission.npz")})
    return 1 if summary["refused"] else 0
