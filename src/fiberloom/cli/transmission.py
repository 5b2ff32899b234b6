"""`fiberloom calibrate transmission`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from fiberloom.cli.terminal import waiting
from fiberloom.field import Field
from fiberloom.instruments import FocalPlane
from fiberloom.report.outputs import marks, prepare_folder
from fiberloom.report.transmission import plot_transmission
from fiberloom.store.calibrations import record_calibration


def run_calibrate_transmission(
    plane: FocalPlane, seed: int, points: int, out: Path, quiet: bool
) -> dict[str, Any]:
    """Calibrate every positioner on the bench twin; write maps, report and a figure."""
    prepare_folder(out)
    field = Field.twin(plane, seed, camera="noise")
    with waiting(quiet) as field.watcher:
        calibration = field.run.sweep(points)
    calibration.maps.save(out / "transmission.npz")
    summary = marks(plane, seed) | calibration.summary()
    (out / "transmission.json").write_text(json.dumps(summary, indent=2) + "\n")
    made = plane.positioner_id[calibration.report.ok]
    record_calibration(out / "transmission.npz", "transmission", made, summary, " ".join(sys.argv))
    plot_transmission(out / "transmission.png", calibration.maps, row=0)
    return summary | {"maps": str(out / "transmission.npz")}
