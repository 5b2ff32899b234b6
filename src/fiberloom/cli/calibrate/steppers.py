"""`fiberloom calibrate steppers`: zeros, tables and arms of units on a bench (MEGARA, MOONS, LAMOST)."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.options import JsonOptions, PlaneOptions, require_folder
from fiberloom.errors import InputError
from fiberloom.wholefile import write_whole

if TYPE_CHECKING:
    from fiberloom.drive.steppers import KnownUnits
    from fiberloom.instruments import FocalPlane


@dataclass(frozen=True, kw_only=True)
class SteppersOptions(PlaneOptions, JsonOptions):
    """Of `calibrate steppers`."""

    out: Annotated[Path, typer.Option(help="Folder for units.npz and units.json.")] = Path("runs/steppers")


def steppers(options: SteppersOptions) -> int:
    """Find mechanical zeros, gear tables and arms of units on steppers, each alone on the twin's bench.

    `fiberloom observe --calibration OUT/units.npz` goes by them. Exit code 1 where a unit is refused.
    """
    options.check_plane()
    require_folder(options.out)
    from rich.console import Console

    from fiberloom.drive.steppers.kept import save_units
    from fiberloom.report.outputs import marks
    from fiberloom.store.calibrations import record_calibration
    from fiberloom.twin.motors.arrays import source_of
    from fiberloom.twin.steppers.source import StepperSource

    plane = options.plane()
    source = source_of(plane, options.seed, "noise")
    if not isinstance(source, StepperSource):
        raise InputError(
            f"{plane.instrument.name}: its motors are no steppers; known are megara, moons and lamost"
        )
    known = source.known
    file, stamp = options.out / "units.npz", marks(plane, options.seed)
    save_units(known, plane, file)
    summary = stamp | _found(known, plane)
    write_whole(options.out / "units.json", json.dumps(summary, indent=2) + "\n")
    well = [int(number) for row, number in enumerate(plane.positioner_id) if row not in known.why]
    record_calibration(file, "steppers", well, stamp, " ".join(sys.argv))
    if options.as_json:
        options.print_json(summary)
    else:
        _print(Console(), summary, options.out)
    return 1 if known.why else 0


def _found(known: KnownUnits, plane: FocalPlane) -> dict[str, Any]:
    """Sizes of what was found, rms over all units: zeros and tables in deg, centres and arms in um."""
    import numpy as np

    from fiberloom.drive.steppers.kept import circles_mm

    error = known.error_deg
    zero = error.mean(axis=(2, 3))
    table = error - zero[:, :, None, None]
    found = plane if known.arms is None else known.arms.found
    off_um = 1e3 * (circles_mm(found) - circles_mm(plane))
    return {
        "n_positioners": len(plane),
        "knots": int(known.knots_deg.shape[1]),
        "zero_rms_deg": np.sqrt(np.mean(zero**2, axis=0)).tolist(),
        "table_rms_deg": np.sqrt(np.mean(table**2, axis=(0, 2, 3))).tolist(),
        "centre_rms_um": float(np.sqrt(np.mean(off_um[:, :2] ** 2))),
        "arm_rms_um": np.sqrt(np.mean(off_um[:, 2:] ** 2, axis=0)).tolist(),
        "refused": {int(plane.positioner_id[row]): why for row, why in known.why.items()},
    }


def _print(console: Any, summary: dict[str, Any], out: Path) -> None:
    zero, table, arm = summary["zero_rms_deg"], summary["table_rms_deg"], summary["arm_rms_um"]
    console.print(
        f"{summary['n_positioners']} units, {summary['knots']} points of each axis; rms of alpha and beta: "
        f"zeros {zero[0]:.3f} and {zero[1]:.3f} deg, tables {table[0]:.3f} and {table[1]:.3f} deg, arms "
        f"{arm[0]:.1f} and {arm[1]:.1f} um off the layout, centres {summary['centre_rms_um']:.1f} um",
        soft_wrap=True,
    )
    for number, why in summary["refused"].items():
        console.print(f"positioner {number}: {why}", style="red", markup=False)
    console.print(f"results in {out}/: units.npz, units.json", markup=False, soft_wrap=True)
