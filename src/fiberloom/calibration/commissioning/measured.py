"""What a bench found of one positioner, quantity by quantity: from estimates, or from files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.calibration.bench.estimate import Estimate
from fiberloom.calibration.bench.torque import data_sheet_scale
from fiberloom.calibration.commissioning.backlash import fitted_waves, tells_waves
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.errors import InputError, one_line
from fiberloom.files import parse_json, read_text
from fiberloom.instruments import FocalPlane
from fiberloom.units import AXES


@dataclass(frozen=True)
class Measured:
    """One quantity of one positioner, by the name that its Estimate has."""

    name: str
    unit: str
    value: float | None
    """None where refused."""
    standard_error: float | None
    reason: str
    """Why there is no value; empty where there is one."""
    source: str
    """On what, when, from how much."""


Quantities = dict[str, Measured]
"""By name, of one positioner."""

PUSHED_DRAG = "{} drag of the pushes"
"""The drag that `inertia` finds beside the inertia: a second way to it."""
BACKLASH = "{} largest backlash"
"""Of the transmission maps, motor degrees."""
BACKLASH_WAVE = "{} {} of the maps"
"""A number of `backlash.fitted_waves`, by its axis and its name: motor degrees or rad."""


def merged(parts: Mapping[str, Quantities]) -> Quantities:
    """Quantities of several measurements by their names (friction, inertia, ...); the first one counts."""
    out: Quantities = {}
    for name, quantities in parts.items():
        for key, found in quantities.items():
            mine = PUSHED_DRAG.format(key.removesuffix(" drag")) if _is_pushed(name, key) else key
            out.setdefault(mine, found)
    return out


def _is_pushed(measurement: str, quantity: str) -> bool:
    return measurement == "inertia" and quantity.endswith(" drag")


def of_maps(maps: TransmissionMaps, row: int, source: str, reason: str = "") -> Quantities:
    """The backlash of each axis of a positioner: the largest, and its mean and waves.

    `maps`: of all positioners, `row` the one meant. `source`: where and when they were measured.
    `reason`: why its maps are none; empty where they are good.
    """
    if reason:
        return {(key := BACKLASH.format(name)): refused_quantity(key, reason, source) for name in AXES}
    out = {}
    for axis, name in enumerate(AXES):
        low, high = maps.output_deg[row, axis, :, [0, -1]].T
        theta = np.linspace(low.max(), high.min(), 1000)
        backlash = maps.select([row]).backlash_motor_deg(theta)[0, axis]
        key = BACKLASH.format(name)
        out[key] = Measured(key, "motor deg", float(backlash.max()), None, "", source)
        if not all(tells_waves(branch) for branch in maps.output_deg[row, axis]):
            continue  # the firmware keeps what it has
        for parameter, value in fitted_waves(theta, backlash).items():
            key = BACKLASH_WAVE.format(name, parameter)
            unit = "rad" if parameter.endswith("phase") else "motor deg"
            out[key] = Measured(key, unit, value, None, "", source)
    return out


def of_estimates(estimates: Iterable[Estimate], row: int, source: str) -> Quantities:
    """What estimates say of the positioner in a row; `source`: where and when."""
    return {e.name: _of_record(e.name, e.record(row), source) for e in estimates}


def _of_record(name: str, record: Mapping[str, Any], source: str) -> Measured:
    if record["value"] is None:
        return Measured(name, record["unit"], None, None, record["reason"], source)
    return Measured(
        name, record["unit"], float(record["value"]), float(record["standard_error"]), "",
        f"{source}; {record['n']} measurements",
    )  # fmt: skip


def refused_quantity(name: str, reason: str, source: str) -> Measured:
    """One that a measurement should have given and did not."""
    return Measured(name, "", None, None, reason, source)


def of_data_sheet(plane: FocalPlane) -> Quantities:
    """The torque at full voltage that measurements without a weight believe in: the same for every unit."""
    out = {}
    for axis, name in enumerate(AXES):
        scale = data_sheet_scale(plane, axis)
        key, value = f"{name} torque at full voltage", float(scale.full_uNm)
        error = value * float(scale.relative_error)
        out[key] = Measured(key, "uNm", value, error, "", f"data sheet of {plane.instrument.name}")
    return out


def of_file(path: Path, marks: Mapping[str, Any]) -> dict[int, Quantities]:
    """Quantities by positioner, of a file that `fiberloom calibrate` wrote.

    InputError where it is no such file, or where its instrument, seed or configuration differ from
    `marks`: then it was measured on other units.
    """
    content = _read(path)
    for key in ("instrument", "seed", "config_hash"):
        if content.get(key) != marks[key]:
            raise InputError(
                f"{path}: {key} is {content.get(key)!r}, this bench's is {marks[key]!r}: it was measured on "
                "other units"
            )
    source = f"{path.name}, bench {content.get('bench', '?')}, {content.get('utc', '?')}"
    try:
        return {
            int(p["positioner_id"]): {
                name: _of_record(name, record, source) for name, record in p["estimates"].items()
            }
            for p in content["positioners"]
        }
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"{path}: not a result of `fiberloom calibrate` ({one_line(repr(error))})") from None


def _read(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(f"{path}: no such file; `fiberloom calibrate` writes such files")
    content = parse_json(read_text(path), str(path))
    if not isinstance(content, dict) or "positioners" not in content:
        raise InputError(f"{path}: not a result of `fiberloom calibrate` (no positioners)")
    return content
