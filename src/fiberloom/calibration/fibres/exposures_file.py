"""Recorded exposures of a dithered field in a file: one row for each exposure and fibre, CSV, ECSV or FITS.

    exposure, dither_x_um, dither_y_um, positioner_id, fibre, star_x_mm, star_y_mm, fibre_x_mm, fibre_y_mm,
    arm_deg, flux, flux_error

What belongs to an exposure (the dither) or to a fibre (star, place, arm) is the same in all its rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.calibration.fibres.dithered import DitheredField
from fiberloom.errors import InputError
from fiberloom.tables import TableFile, read_table, write_columns
from fiberloom.typing import Floats, Ints

OF_EXPOSURE = ("dither_x_um", "dither_y_um")
OF_FIBRE = ("star_x_mm", "star_y_mm", "fibre_x_mm", "fibre_y_mm", "arm_deg")
COLUMNS = ("exposure", *OF_EXPOSURE, "positioner_id", "fibre", *OF_FIBRE, "flux", "flux_error")
_MOST = 1000
"""Exposures in a file: more is a table of something else."""
_ALIKE = 1e-6
"""Differences of numbers that were written with other digits."""


def write_exposures(path: str | Path, field: DitheredField, marks: Mapping[str, Any]) -> None:
    """Writes a field as ECSV; a flux that was not measured has no row. `marks`: for the head."""
    e, n = np.nonzero(field.measured)
    places = np.column_stack([field.star_mm, field.fibre_mm, field.arm_deg])
    columns: dict[str, Any] = {"exposure": e + 1}
    columns |= {name: field.dither_um[e, k] for k, name in enumerate(OF_EXPOSURE)}
    columns |= {"positioner_id": field.positioner_id[n], "fibre": field.fibre[n]}
    columns |= {name: places[n, k] for k, name in enumerate(OF_FIBRE)}
    columns |= {"flux": field.flux[e, n], "flux_error": field.flux_error[e, n]}
    write_columns(Path(path), columns, dict(marks))


def read_exposures(path: str | Path) -> DitheredField:
    """Reads a field; InputError with file, row and column for what cannot be one."""
    table = read_table(path)
    table.require(*COLUMNS)
    exposure, e, first_e = _numbered(table, "exposure")
    positioner, n, first_n = _numbered(table, "positioner_id")
    if len(exposure) > _MOST:
        raise InputError(f"{path}: {len(exposure)} exposures, {_MOST} are possible; is each field a file?")
    numbers = {name: table.numbers(name) for name in (*OF_EXPOSURE, *OF_FIBRE, "flux", "flux_error")}
    for names, group, first in ((OF_EXPOSURE, e, first_e), (OF_FIBRE, n, first_n)):
        for name in names:
            _check_alike(table, name, numbers[name], first[group])
    _check_once(table, e * len(positioner) + n)
    flux, error = np.full((2, len(exposure), len(positioner)), np.nan)
    flux[e, n], error[e, n] = numbers["flux"], numbers["flux_error"]
    bad = np.flatnonzero(numbers["flux_error"] <= 0.0)
    if len(bad):
        raise table.error(int(bad[0]), "flux_error", f"= {numbers['flux_error'][bad[0]]:g} is not above 0")
    fibre = table.strings("fibre")
    wrong = np.flatnonzero(fibre != fibre[first_n][n])
    if len(wrong):
        raise table.error(int(wrong[0]), "fibre", "is not that of the positioner's other rows")
    return DitheredField(
        name=str(path),
        positioner_id=positioner,
        fibre=fibre[first_n],
        star_mm=_pair(numbers, "star_x_mm", "star_y_mm")[first_n],
        fibre_mm=_pair(numbers, "fibre_x_mm", "fibre_y_mm")[first_n],
        arm_deg=numbers["arm_deg"][first_n],
        dither_um=_pair(numbers, *OF_EXPOSURE)[first_e],
        flux=flux,
        flux_error=error,
    )


def _numbered(table: TableFile, name: str) -> tuple[Ints, Ints, Ints]:
    """Different numbers, which of them each row has, and the first row of each."""
    values, first, which = np.unique(table.integers(name), return_index=True, return_inverse=True)
    return values, which.reshape(-1).astype(np.int64), first.astype(np.int64)


def _pair(numbers: Mapping[str, Floats], x: str, y: str) -> Floats:
    return np.column_stack([numbers[x], numbers[y]])


def _check_alike(table: TableFile, name: str, values: Floats, first: Ints) -> None:
    wrong = np.flatnonzero(np.abs(values - values[first]) > _ALIKE * (1.0 + np.abs(values)))
    if len(wrong):
        row = int(wrong[0])
        raise table.error(
            row, name, f"= {values[row]:g}, but {values[first[row]]:g} in {table.places[first[row]]}"
        )


def _check_once(table: TableFile, pair: Ints) -> None:
    _, first, which = np.unique(pair, return_index=True, return_inverse=True)
    again = np.flatnonzero(first[which.reshape(-1)] != np.arange(len(pair)))
    if len(again):
        row = int(again[0])
        raise table.error(row, "exposure", "holds this positioner a second time")


def read_all(paths: list[Path]) -> list[DitheredField]:
    """Several fields; InputError where two files are the same field."""
    found = [read_exposures(path) for path in paths]
    for k, field in enumerate(found):
        for other in found[:k]:
            if field.flux.shape == other.flux.shape and np.array_equal(
                field.flux, other.flux, equal_nan=True
            ):
                raise InputError(f"{field.name}: holds the same fluxes as {other.name}; give each field once")
    return found
