"""The file of an in-focal-plane calibration: one ECSV table with its marks, for people and programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.calibration.focal_plane.fiducials import Fiducials
from fiberloom.calibration.focal_plane.fit import N_GEOMETRY, PARAMETERS, FocalPlaneFit
from fiberloom.errors import InputError, one_line
from fiberloom.instruments import FocalPlane
from fiberloom.tables import TableFile, read_ecsv, write_columns
from fiberloom.typing import Array, Floats, Ints
from fiberloom.units import MM_PER_UM, rad_to_deg

FORMAT = "fiberloom arms"
FORMAT_VERSION = 1
MEASURED_C = "temperature_C"
"""Key of the temperature at which the arms were measured."""

_UNITS = np.array([1.0, 1.0, 1.0, 1.0, *[rad_to_deg(1.0)] * 2])
_COLUMNS = tuple(name.replace("_rad", "_deg") for name in PARAMETERS)


def save_arms(path: str | Path, fit: FocalPlaneFit, marks: Mapping[str, Any]) -> None:
    """Writes parameters, standard errors, covariance, rank and reason of every positioner.

    Angles are in deg; `covariance` is in the units of the columns (mm, deg).
    """
    scale = np.outer(_UNITS, _UNITS)
    covariance = fit.covariance[:, :N_GEOMETRY, :N_GEOMETRY] * scale
    columns: dict[str, Array] = {"positioner_id": fit.positioner_id}
    for i, name in enumerate(_COLUMNS):
        columns[name] = fit.parameters[:, i] * _UNITS[i]
        columns[f"{name}_se"] = np.sqrt(covariance[:, i, i])
    columns |= {
        "rank": fit.rank,
        "n_used": fit.used.sum(axis=1),
        "n_outliers": fit.n_outliers,
        "rms_um": fit.rms_um,
        "chi2_dof": fit.chi2_dof,
        "covariance": covariance,
        "reason": np.array(fit.reason, dtype=np.str_),
    }
    head = {"format": FORMAT, "format_version": FORMAT_VERSION, **marks}
    try:
        write_columns(Path(path), columns, head)
    except OSError as error:
        raise InputError(f"{path}: cannot write the arms: {error.strerror or error}") from None


def load_arms(path: str | Path, plane: FocalPlane) -> FocalPlane:
    """The plane with the arms of a file, and its fiducials where they were calibrated with them.

    A positioner of the `plane` that is not in the file at `path`, or was refused, keeps the layout's arms.
    """
    return ArmsFile.read(path, plane).calibrated()


@dataclass(frozen=True)
class ArmsFile:
    """What a file says of the positioners of a layout."""

    plane: FocalPlane
    """The layout."""
    rows: Ints
    """(M,) of the layout: those that the file has."""
    fit: FocalPlaneFit
    """Of these M."""
    fiducials: Fiducials | None
    """None: they were not calibrated."""
    measured_C: float | None
    """Temperature at which the arms were measured, deg C; None where it was not noted."""

    @classmethod
    def read(cls, path: str | Path, plane: FocalPlane) -> ArmsFile:
        """Reads the file at `path` for the positioners of the `plane`; InputError with its name for one that
        is no such file, holds nonsense, or none of them.
        """
        try:
            table = _read(Path(path))
            _as_fit(table)  # whole, before a part of it is taken
            _check_sound(table)
            fiducials = Fiducials.of_meta(table.head, plane.fiducials[:, :2])
        except (TypeError, ValueError, OverflowError) as error:
            named = str(error).startswith(str(path))
            raise InputError(str(error) if named else f"{path}: {one_line(error)}; calibrate again") from None
        known = {int(p): row for row, p in enumerate(plane.positioner_id)}
        here = np.array([int(p) in known for p in table.columns["positioner_id"]], dtype=bool)
        if not here.any():
            raise InputError(f"{path}: holds none of the {plane.n} positioners of this layout")
        fit = _as_fit(table.select(np.flatnonzero(here)))
        rows = np.array([known[int(p)] for p in fit.positioner_id])
        return cls(plane, rows, fit, fiducials, _measured_C(table))

    def calibrated(self) -> FocalPlane:
        """The layout with these arms and fiducials; what was refused stays as it is there."""
        part = self.fit.plane(self.plane.select(self.rows))
        arms, points = self.plane.arms.copy(), {k: v.copy() for k, v in self.plane.points.items()}
        arms[self.rows] = part.arms
        for name, xy in points.items():
            xy[self.rows] = part.points[name]
        found = replace(self.plane, arms=arms, points=points)
        return found if self.fiducials is None else self.fiducials.applied(found)

    def covariance_mm2(self, otherwise_um: float = 1.0) -> Floats:
        """(N, 4, 4) mm^2 of centre x, y, l_alpha, l_beta of all positioners of the layout; `otherwise_um` for
        one that is not in the file.
        """
        covariance = np.tile(np.eye(4) * (otherwise_um * MM_PER_UM) ** 2, (self.plane.n, 1, 1))
        covariance[self.rows[self.fit.ok]] = self.fit.arms_covariance_mm2[self.fit.ok]
        return covariance


def _measured_C(table: TableFile) -> float | None:
    found = table.head.get(MEASURED_C)
    return float(found) if isinstance(found, int | float) and np.isfinite(found) else None


def _as_fit(table: TableFile) -> FocalPlaneFit:
    n = len(table)
    values = np.column_stack([np.asarray(table.columns[name], dtype=np.float64) for name in _COLUMNS])
    covariance = np.asarray(table.columns["covariance"], dtype=np.float64).reshape(n, N_GEOMETRY, N_GEOMETRY)
    return FocalPlaneFit(
        positioner_id=np.asarray(table.columns["positioner_id"], dtype=np.int64),
        parameters=values / _UNITS,
        covariance=covariance / np.outer(_UNITS, _UNITS),
        rank=np.asarray(table.columns["rank"], dtype=np.int64),
        reason=[str(r) for r in table.columns["reason"]],
        used=np.ones((n, 0), dtype=bool),
        n_outliers=np.asarray(table.columns["n_outliers"], dtype=np.int64),
        rms_um=np.asarray(table.columns["rms_um"], dtype=np.float64),
        chi2_dof=np.asarray(table.columns["chi2_dof"], dtype=np.float64),
        angles_deg=(np.nan, np.nan),
    )


MOST = 1e6
"""Of an arm in mm and deg, and of its variance; what is beyond was never measured."""


def _check_sound(table: TableFile) -> None:
    """Raises InputError where a positioner that counts as measured was not: no number, or beyond sense."""
    ids = np.asarray(table.columns["positioner_id"])
    if ids.dtype.kind not in "iu" or len(np.unique(ids)) < len(ids):
        raise InputError("positioner_id: whole numbers, each once, are needed")
    values = np.column_stack([np.asarray(table.columns[name], dtype=np.float64) for name in _COLUMNS])
    covariance = np.asarray(table.columns["covariance"], dtype=np.float64).reshape(len(ids), -1)
    for row in range(len(ids)):
        if table.columns["reason"][row]:
            continue
        for name, numbers in (("its arms", values[row]), ("its covariance", covariance[row])):
            bad = ~(np.abs(numbers) <= MOST)
            if bad.any():
                raise InputError(f"positioner {ids[row]}: {numbers[bad][0]:g} in {name}")


def _read(path: Path) -> TableFile:
    if not path.is_file():
        raise InputError(f"{path}: no such file; make one with 'fiberloom calibrate focal-plane'")
    table = read_ecsv(path)
    found = table.head.get("format"), table.head.get("format_version")
    missing = [c for c in ("positioner_id", *_COLUMNS, "covariance", "reason") if c not in table]
    if found != (FORMAT, FORMAT_VERSION) or missing:
        raise InputError(
            f"{path}: not a file of arms that this version reads (format {found[0]} {found[1]}, "
            f"missing columns {', '.join(missing) or 'none'}); calibrate again"
        )
    return table
