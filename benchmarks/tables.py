"""How far two calibrations of the same robots are apart: what a table is wrong by.

    python -m benchmarks.tables [--data ../shared/data/sdssv]

Two tables of SDSS-V at Apache Point, 2024-04-01 and 2025-12-04: the robots that stayed in their holes. These
are the sizes of `[twin.errors]` of the preset sdssv. Both tables have errors: the difference is not smaller
than what one of them has.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.twin.errors.frame import WrongFrame
from fiberloom.twin.errors.sizes import TwinErrors
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM

OLD, NEW = "apo_2024.04.01", "apo_2025.12.04"
FIBRES = {"BOSS": "boss", "APOGEE": "ap"}


def main() -> int:
    """Prints the sizes."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.tables", description="sizes of errors of tables"
    )
    parser.add_argument("--data", type=Path, default=Path("../shared/data/sdssv"))
    data = parser.parse_args().data
    if not (data / OLD / "positionerTable.csv").is_file():
        print(f"{data}: no tables of {OLD} and {NEW} there; --data names their folder", file=sys.stderr)
        return 2
    for name, values in (sizes(data) | of_fiducials()).items():
        print(f"{name:28s} " + "  ".join(f"{key} {value:.2f}" for key, value in values.items()))
    return 0


def sizes(data: Path) -> dict[str, dict[str, float]]:
    """By what is off: rms and median in um, of the robots in both tables; along and across the beta arm."""
    pairs = _pairs(data)

    def change(name: str) -> Floats:
        return UM_PER_MM * np.array([float(new[name]) - float(old[name]) for old, new in pairs])

    out = {"robots in both tables": {"number": float(len(pairs))}}
    out["alpha arm"] = _rms(change("alphaArmLen"))
    out["metrology fibre, along"] = _rms(change("metX"))
    for fibre, name in FIBRES.items():
        along, across = change(f"{name}X") - change("metX"), change(f"{name}Y") - change("metY")
        out[f"{fibre}, along"], out[f"{fibre}, across"] = _rms(along), _rms(across)
        out[f"{fibre}, both"] = _rms(np.hypot(along, across))
    with (data / NEW / "fiducialCoords.csv").open() as file:
        variance = [float(row["xyVar"]) for row in csv.DictReader(file)]
    out["fiducials, each coordinate"] = {"median": UM_PER_MM * float(np.median(np.sqrt(variance)))}
    return out


def of_fiducials(seeds: int = 40) -> dict[str, dict[str, float]]:
    """How far fibres of the twin are seen from where they are, um, by fiducials off their table."""
    plane = FocalPlane.of("sdssv")
    errors, fibres_mm = TwinErrors.of(plane.instrument), plane.forward(40.0, 90.0)
    seen = [WrongFrame(plane, errors.fiducials_mm(plane, seed)).seen_mm(fibres_mm) for seed in range(seeds)]
    each = np.array([_rms(UM_PER_MM * np.hypot(*(xy - fibres_mm).T))["rms"] for xy in seen])
    rms = float(np.sqrt(np.mean(each**2)))
    return {"fibres, by fiducials": {"rms": rms, "least": float(each.min()), "most": float(each.max())}}


def _rms(off_um: Floats) -> dict[str, float]:
    return {"rms": float(np.sqrt(np.mean(off_um**2))), "median": float(np.median(np.abs(off_um)))}


def _pairs(data: Path) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Rows of both tables of the robots that are in the same holes."""
    old, new = (_rows(data / epoch / "positionerTable.csv") for epoch in (OLD, NEW))
    return [(old[key], new[key]) for key in sorted(old.keys() & new.keys())]


def _rows(path: Path) -> dict[tuple[str, str], dict[str, Any]]:
    with path.open() as file:
        return {(row["positionerID"], row["holeID"]): row for row in csv.DictReader(file)}


if __name__ == "__main__":
    sys.exit(main())
