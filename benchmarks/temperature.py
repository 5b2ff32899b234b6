"""What the temperature does to blind moves, and what a thermometer and learning leave of it.

    python -m benchmarks.temperature [--positioners 100] [--seeds 0:3] [--plate-per-K 12e-6]

On the twin, `--errors temperature` alone: arms were measured at 20 deg C, each night has another temperature
and another field of stars. Blind error of the metrology fibres, um rms, over the second half of the nights:
with arms as they were measured; with the thermometer and the expansion that the instrument says; the same two
with `--adapt`, which learns maps and arms and, with the thermometer, the expansion too. At the end of a line:
what blind moves have shown of the expansion. `--plate-per-K`: of another plate than the instrument expects.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import fiberloom as fl
from fiberloom.operation.results import Observation
from fiberloom.studies.star_fields import stars
from fiberloom.twin.errors.sizes import TwinErrors

NIGHTS_C = (14.0, 2.0, 21.0, -4.0, 9.0, 17.0, 0.0, 12.0, -2.0, 19.0, 5.0, 24.0)
"""Of the observations, one after the other."""
FIBRE = "BOSS"
WAYS = {
    "as measured": (False, False),
    "thermometer": (True, False),
    "adapt": (False, True),
    "both": (True, True),
}
"""With the thermometer, and learning."""


def main() -> int:
    """Prints the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.temperature", description=str(__doc__))
    parser.add_argument("--positioners", type=int, default=100)
    parser.add_argument("--seeds", default="0:3")
    parser.add_argument("--plate-per-K", type=float, default=12e-6)
    given = parser.parse_args()
    first, last = (int(part) for part in given.seeds.split(":"))
    print(f"{given.positioners} positioners, plate {given.plate_per_K:g} a kelvin; blind error, um rms")
    for seed in range(first, last):
        print(f"seed {seed}: " + ", ".join(of_seed(seed, given)), flush=True)
    return 0


def of_seed(seed: int, given: argparse.Namespace) -> list[str]:
    """What is said of one seed; `given`: positioners, plate_per_K."""
    plane = with_plate(fl.FocalPlane.of("sdssv", n=given.positioners), given.plate_per_K)
    said: list[str] = []
    told: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as kept:
        maps = Path(kept) / "maps.npz"
        fl.Field.twin(plane, seed, camera="noise").run.calibrate().save(maps)
        for name, (thermometer, adapt) in WAYS.items():
            known = plane if thermometer else without_thermometer(plane)
            blind_um, seen = nights(known, seed, maps, Path(kept) / name, adapt)
            said.append(f"{name} {blind_um:.2f}")
            told = seen.summary().get("temperature", {})
    true = TwinErrors.of(plane.instrument, "temperature").temperature.arms_per_K(seed)
    return [
        *said,
        f"expansion {told['expansion_ppm_K']:.2f} +- {told['expansion_sd_ppm_K']:.2f} ppm/K of "
        f"{told['nights']} nights, true {1e6 * true:.2f}",
    ]


def nights(
    plane: fl.FocalPlane, seed: int, maps: Path, folder: Path, adapt: bool
) -> tuple[float, Observation]:
    """Blind error over the second half of the nights, um rms, and the last observation.

    `plane`: as the host knows it; `seed`: of units and stars; `maps`: of the transmissions; `folder`: of the
    record; `adapt`: learn.
    """
    square: list[float] = []
    asked: dict[str, Any] = {"adapt": adapt, "learnt": str(folder / "learnt.sqlite") if adapt else None}
    for number, at_C in enumerate(NIGHTS_C):
        field = fl.Field.twin(
            plane, seed, camera="noise", errors=f"temperature,at_C={at_C}", calibration=maps
        )
        seen = field.run.observe(stars(plane, FIBRE, 100 * seed + number), 2, out=folder, **asked)
        error_um = seen.moves[0].measured_error_um
        square.append(float(np.nanmean(error_um**2)))
        print(f"    {folder.name} {at_C:g} deg C: {square[-1] ** 0.5:.2f} um", file=sys.stderr, flush=True)
    return float(np.sqrt(np.mean(square[len(square) // 2 :]))), seen


def with_plate(plane: fl.FocalPlane, per_K: float) -> fl.FocalPlane:
    """With a plate in the twin that expands by `per_K`, a ratio for each kelvin."""
    errors = {**plane.instrument.twin["errors"], "temperature": {"plate_per_K": per_K}}
    twin = {**plane.instrument.twin, "errors": errors}
    return replace(plane, instrument=plane.instrument.model_copy(update={"twin": twin}))


def without_thermometer(plane: fl.FocalPlane) -> fl.FocalPlane:
    """Whose host takes arms as they were measured."""
    return replace(plane, instrument=plane.instrument.model_copy(update={"expansion": None}))


if __name__ == "__main__":
    sys.exit(main())
