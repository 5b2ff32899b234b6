"""Configurations: the angles of every positioner, as CSV `positioner_id,alpha_deg,beta_deg`."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.planning.bodies import beyond_stops_deg
from fiberloom.tables import read_table
from fiberloom.typing import Floats
from fiberloom.wholefile import whole

COLUMNS = ("positioner_id", "alpha_deg", "beta_deg")


def read_configuration(path: str | Path, plane: FocalPlane) -> Floats:
    """(N, 2) alpha and beta in deg, in the order of the plane.

    Every positioner once, within its hard stops; offline ones may be left out and keep the angles of the
    plane.
    """
    table = read_table(path)
    table.require(*COLUMNS)
    table.unique(COLUMNS[0], number=True)
    ids, angles = table.integers(COLUMNS[0]), [table.numbers(name) for name in COLUMNS[1:]]
    known = np.isin(ids, plane.positioner_id)
    if not known.all():
        row = int(np.flatnonzero(~known)[0])
        raise table.error(row, COLUMNS[0], f"= {ids[row]}: not in this focal plane of {plane.n} positioners")
    missing = ~np.isin(plane.positioner_id, ids) & ~plane.offline
    if missing.any():
        raise InputError(
            f"{path}: no row for positioner {plane.positioner_id[missing][0]} "
            f"({int(missing.sum())} missing); every positioner needs one"
        )
    found = np.column_stack(angles)
    rows = plane.index_of(ids)
    for row, axis in np.argwhere(beyond_stops_deg(plane, found, rows) > 0.0)[:1]:
        low, high = plane.stops_of(rows)[row, axis]
        problem = f"= {found[row, axis]:g}: beyond the hard stops at {low:g} and {high:g} deg"
        raise table.error(int(row), COLUMNS[1 + axis], problem)
    out = plane.offline_position_deg.astype(np.float64)
    out[rows] = found
    return out


def write_configuration(
    path: str | Path,
    positioner_id: ArrayLike,
    angles_deg: ArrayLike,
    more: Mapping[str, Sequence[str]] | None = None,
) -> None:
    """Write a configuration; angles with 9 decimals (a count of the bus is 3e-7 deg).

    `path`: the CSV file; `positioner_id` (N,); `angles_deg` (N, 2): alpha, beta in deg; `more`: further
    columns by name, N cells each.
    """
    more = more or {}
    angles = np.asarray(angles_deg, dtype=np.float64)
    cells = zip(np.asarray(positioner_id), angles, *more.values(), strict=True)
    with whole(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow([*COLUMNS, *more])
        out.writerows([int(number), f"{a:.9f}", f"{b:.9f}", *rest] for number, (a, b), *rest in cells)
