"""What a bench has found of steppers, in a file: zeros, tables, arms, and which units cannot be used."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from fiberloom.drive.steppers.found_arms import FoundArms
from fiberloom.drive.steppers.known import KnownUnits
from fiberloom.drive.steppers.steps import AxisSteps
from fiberloom.errors import InputError, one_line
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.arms import L_ALPHA
from fiberloom.typing import Array, Floats
from fiberloom.wholefile import whole

_ARRAYS = ("about", "positioner_id", "knots_deg", "error_deg", "circles_mm")
"""`about`: bytes of JSON, the name of the instrument and why units cannot be used."""
_MOST_DEG = 30.0
"""No bench finds a larger error: a unit that is farther off is refused by it."""


def save_units(known: KnownUnits, plane: FocalPlane, path: str | Path) -> None:
    """Writes what is `known` of the units of a `plane` to an npz file; InputError where it cannot be written.

    Errors of angles in deg; centres and arms in mm.
    """
    found = plane if known.arms is None else known.arms.found
    with whole(path, folders=True) as part, part.open("wb") as file:
        np.savez(
            file,
            allow_pickle=False,
            about=_about(known, plane),
            positioner_id=plane.positioner_id,
            knots_deg=known.knots_deg,
            error_deg=known.error_deg,
            circles_mm=circles_mm(found),
        )


def _about(known: KnownUnits, plane: FocalPlane) -> Array:
    ids = plane.positioner_id
    told = {"instrument": plane.instrument.name, "why": {int(ids[k]): why for k, why in known.why.items()}}
    return np.frombuffer(json.dumps(told).encode(), dtype=np.uint8)


def circles_mm(plane: FocalPlane) -> Floats:
    """(N, 4) mm: centre x and y, alpha arm, distance of the fibre from the beta axis."""
    return np.column_stack([plane.arms[:, : L_ALPHA + 1], plane.l_beta_mm])


def read_units(path: str | Path, plane: FocalPlane) -> KnownUnits:
    """What is known of the units of a `plane`, from a file of `save_units`.

    InputError where there is no such file, it is of another instrument, or a unit is not in it.
    """
    found, refused = _arrays(Path(path), plane.instrument.name)
    row_of = {int(number): row for row, number in enumerate(found["positioner_id"])}
    missing = [number for number in plane.positioner_id.tolist() if number not in row_of]
    if missing:
        raise InputError(
            f"{path}: positioner {missing[0]} is not in it ({len(missing)} of {len(plane)} are not); "
            "calibrate them by 'fiberloom calibrate steppers'"
        )
    rows = np.array([row_of[number] for number in plane.positioner_id.tolist()], dtype=np.int64)
    numbers = enumerate(map(str, plane.positioner_id.tolist()))
    why = {row: str(refused[number]) for row, number in numbers if number in refused}
    circles = found["circles_mm"][rows]
    return KnownUnits(
        AxisSteps.of(plane.instrument),
        found["knots_deg"],
        found["error_deg"][rows],
        why,
        None if np.array_equal(circles, circles_mm(plane)) else FoundArms.of(plane, circles),
    )


def _arrays(path: Path, instrument: str) -> tuple[dict[str, Array], dict[str, str]]:
    """What is in the file, and why units cannot be used by their numbers."""
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            found = {name: np.asarray(file[name]) for name in _ARRAYS}
            about = dict(json.loads(found["about"].tobytes()))
            name, why = str(about["instrument"]), dict(about["why"])
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or one_line(error)}; give a file of units") from None
    except Exception as error:  # numpy, zipfile and zlib raise many kinds for a broken file
        raise InputError(f"{path}: no file of units on steppers ({one_line(error)})") from None
    if name != instrument:
        raise InputError(f"{path}: is of {one_line(name)[:40]}, not of {instrument}")
    n, knots = found["positioner_id"].shape[:1], found["knots_deg"].shape[-1:]
    shapes = {"positioner_id": n, "knots_deg": (2, *knots), "error_deg": (*n, 2, 2, *knots)}
    shapes["circles_mm"] = (*n, 4)
    for key, shape in shapes.items():
        if found[key].shape != shape or not _sound(key, found[key]):
            raise InputError(f"{path}: {key} is not what a bench finds; calibrate anew")
    return found, why


def _sound(name: str, array: Array) -> bool:
    """Finite numbers, of which no angle is wild and no knot out of order."""
    if array.dtype.kind not in ("iu" if name == "positioner_id" else "f") or not np.isfinite(array).all():
        return False
    if name == "error_deg":
        return bool((np.abs(array) <= _MOST_DEG).all())
    if name == "knots_deg":
        return array.size > 0 and bool((np.diff(array, axis=1) > 0.0).all())
    return True
