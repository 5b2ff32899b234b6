"""By how much the arms of an array sag, as it is kept and used: arrays, and a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fiberloom.calibration.covariances import are_covariances
from fiberloom.calibration.gravity.model import PARAMETERS, shifts_per_parameter, turns_deg
from fiberloom.errors import InputError, one_line
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.pointing import Pointing
from fiberloom.tables import TableFile, read_table, write_columns
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import UM_PER_MM

FORMAT = "fiberloom arm sag"
FORMAT_VERSION = 1
_URAD = 1e6
_VALUES = tuple(f"{name}_urad" for name in PARAMETERS)
_PAIRS = tuple((p, q) for p in range(len(PARAMETERS)) for q in range(p + 1))
_WIDE = tuple(f"cov_{PARAMETERS[p]}_{PARAMETERS[q]}_urad2" for p, q in _PAIRS)
_COLUMNS = ("positioner_id", *_VALUES, *_WIDE, "n_images", "reason")
MOST_RAD = 1e-2
"""At 1 g: an arm that turns farther is loose."""
_BENT_DEG = np.array([0.0, 90.0])
_LEVEL = (Pointing(90.0, 0.0), Pointing(90.0, 90.0))


@dataclass(frozen=True, eq=False)
class ArmSag:
    """The numbers of N positioners, by `PARAMETERS` of `fiberloom.calibration.gravity.model`.

    Raises
    ------
    InputError
        Arrays that do not fit each other, a positioner twice, a number that cannot be one.
    """

    positioner_id: Ints
    """(N,) number on the bus."""
    sag_rad: Floats
    """(N, 4) turns at 1 g; 0 with a reason."""
    covariance_rad2: Floats
    """(N, 4, 4) of it; NaN with a reason."""
    n_images: Ints
    """(N,) behind it."""
    reason: NDArray[np.str_]
    """(N,) why nothing is known; empty where it is."""

    def __post_init__(self) -> None:
        n, p = len(self.positioner_id), len(PARAMETERS)
        shapes = {"sag_rad": (n, p), "covariance_rad2": (n, p, p), "n_images": (n,), "reason": (n,)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise InputError(f"arm sag: {name} has shape {getattr(self, name).shape}, not {shape}")
        if len(np.unique(self.positioner_id)) < n:
            raise InputError("arm sag: a positioner appears twice")
        small: Flags = np.all(np.abs(self.sag_rad) <= MOST_RAD, axis=1)
        sound = are_covariances(self.covariance_rad2, MOST_RAD**2)
        for row in np.flatnonzero(self.ok & ~(small & sound))[:1]:
            name = f"positioner {self.positioner_id[row]}"
            if not small[row]:
                raise InputError(f"{name}: turns by more than {MOST_RAD:g} rad at 1 g, or by no number")
            raise InputError(f"{name}: its covariance is none")

    def __len__(self) -> int:
        return len(self.positioner_id)

    def __repr__(self) -> str:
        return f"ArmSag({int(self.ok.sum())} of {len(self)} positioners)"

    @property
    def ok(self) -> Flags:
        """(N,) True where numbers are known."""
        return np.array([not r for r in self.reason], dtype=bool)

    def on(self, plane: FocalPlane) -> ArmSag:
        """Rows in the order of the `plane`; what is not known of a positioner has a reason.

        InputError where none of its positioners is in it.
        """
        row_of = {int(p): k for k, p in enumerate(self.positioner_id)}
        rows = np.array([row_of.get(int(p), -1) for p in plane.positioner_id])
        if (rows < 0).all():
            raise InputError(f"arm sag: of none of the {len(plane)} positioners of this layout")
        here, p = rows >= 0, len(PARAMETERS)
        sag, wide = np.zeros((len(plane), p)), np.full((len(plane), p, p), np.nan)
        sag[here], wide[here] = self.sag_rad[rows[here]], self.covariance_rad2[rows[here]]
        images = np.where(here, self.n_images[rows], 0)
        return ArmSag(plane.positioner_id, sag, wide, images, np.where(here, self.reason[rows], "not in it"))

    def turns_deg(self, plane: FocalPlane, angles_deg: Floats, pointing: Pointing) -> Floats:
        """(N, 2) deg by which the arms of the `plane` turn at `angles_deg` (N, 2); 0 where it is unknown."""
        here = self.on(plane)
        return turns_deg(plane, angles_deg, np.where(here.ok[:, None], here.sag_rad, 0.0), pointing)

    def size_um(self, plane: FocalPlane) -> float:
        """Rms shift of the metrology fibres at 1 g, bent by 90 deg; 0 where nothing is known."""
        here = self.on(plane)
        shifts = _at_one_g(plane)[:, here.ok]
        found = np.einsum("gnip,np->gni", shifts, here.sag_rad[here.ok])
        return _rms_um((found**2).sum(axis=2))

    def formal_um(self, plane: FocalPlane) -> float:
        """Rms of the standard errors of such shifts, two-dimensional; 0 where nothing is known."""
        here = self.on(plane)
        shifts = _at_one_g(plane)[:, here.ok]
        return _rms_um(np.einsum("gnip,npq,gniq->gn", shifts, here.covariance_rad2[here.ok], shifts))

    def write(self, path: str | Path, marks: Mapping[str, Any]) -> None:
        """Writes the file, whole or not at all; `marks`: version, seed, ... for its head."""
        wide = [_URAD**2 * self.covariance_rad2[:, p, q] for p, q in _PAIRS]
        columns = (self.positioner_id, *(_URAD * self.sag_rad).T, *wide, self.n_images, self.reason)
        head = {"format": FORMAT, "format_version": FORMAT_VERSION, **marks}
        write_columns(Path(path), dict(zip(_COLUMNS, columns, strict=True)), head)

    @classmethod
    def load(cls, path: str | Path, plane: FocalPlane) -> ArmSag:
        """Reads the file, for the positioners of a `plane`.

        InputError, with its name, for one that is no such file, holds nonsense, or none of them.
        """
        path = Path(path)
        if not path.is_file():
            raise InputError(f"{path}: no such file; make one with 'fiberloom calibrate gravity'")
        table = read_table(path)
        table.require(*_COLUMNS)
        try:
            return _read(table).on(plane)
        except InputError as error:
            raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
        except (TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{path}: {one_line(error)}; calibrate again") from None


def _at_one_g(plane: FocalPlane) -> Floats:
    """(2, N, 2, 4) mm/rad: shifts with gravity along y and along x."""
    bent = np.tile(_BENT_DEG, (len(plane), 1))
    return np.stack([shifts_per_parameter(plane, bent, level) for level in _LEVEL])


def _rms_um(square_mm2: Floats) -> float:
    return UM_PER_MM * float(np.sqrt(square_mm2.mean())) if square_mm2.size else 0.0


def _read(table: TableFile) -> ArmSag:
    found = table.head.get("format"), table.head.get("format_version")
    if found != (FORMAT, FORMAT_VERSION):
        raise InputError(f"not a file of sag that this version reads (format {found[0]} {found[1]})")
    n, p = len(table), len(PARAMETERS)
    wide = np.empty((n, p, p))
    for (row, column), name in zip(_PAIRS, _WIDE, strict=True):
        wide[:, row, column] = wide[:, column, row] = _numbers(table, name) / _URAD**2
    return ArmSag(
        positioner_id=table.integers("positioner_id"),
        sag_rad=np.column_stack([_numbers(table, name) for name in _VALUES]) / _URAD,
        covariance_rad2=wide,
        n_images=table.integers("n_images"),
        reason=table.strings("reason"),
    )


def _numbers(table: TableFile, name: str) -> Floats:
    """A column of numbers, NaN allowed: of a positioner with a reason."""
    out = np.empty(len(table))
    for row, cell in enumerate(table.columns[name]):
        try:
            out[row] = float(cell)
        except (TypeError, ValueError):
            raise table.error(row, name, f"= '{cell}' is not a number") from None
    return out
