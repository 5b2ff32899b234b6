"""What columns of target lists are called, and those that every list may have."""

from __future__ import annotations

import numpy as np

from fiberloom.tables import TableFile
from fiberloom.targets.target_list import FREE
from fiberloom.typing import Ints

NAMES = {
    "target_id": ("target_id", "source_id", "catalogid"),
    "ra_deg": ("ra_deg", "racat", "ra"),
    "dec_deg": ("dec_deg", "deccat", "dec"),
    "epoch_yr": ("epoch", "ref_epoch", "coord_epoch", "epoch_yr"),
    "pm_ra_mas_yr": ("pmra", "pm_ra", "pm_ra_mas_yr"),
    "pm_dec_mas_yr": ("pmdec", "pm_dec", "pm_dec_mas_yr"),
    "parallax_mas": ("parallax", "parallax_mas"),
    "velocity_km_s": ("radial_velocity", "rv", "velocity_km_s"),
    "delta_ra_arcsec": ("delta_ra", "delta_ra_arcsec"),
    "delta_dec_arcsec": ("delta_dec", "delta_dec_arcsec"),
    "wavelength_A": ("wavelength", "wavelength_a", "lambda_eff"),
    "priority": ("priority",),
    "fibre": ("fibre", "fiber", "fibertype"),
    "positioner_id": ("positioner_id", "positionerid"),
}
"""Of columns, without regard to capitals; the first that a file has is read. Gaia's and SDSS's among them."""


def is_sky(table: TableFile) -> bool:
    """Has the table RA and Dec?"""
    found = columns_of(table)
    return "ra_deg" in found and "dec_deg" in found


def columns_of(table: TableFile) -> dict[str, str]:
    """Column of the table for each of our names that it has."""
    there = {name.lower(): name for name in reversed(list(table.columns))}
    return {
        ours: there[next(n for n in theirs if n in there)]
        for ours, theirs in NAMES.items()
        if any(n in there for n in theirs)
    }


def positioners(table: TableFile, name: str) -> Ints:
    """Whole numbers; empty cells are free. Two targets must not demand one positioner.

    `name`: of the column.
    """
    cells = [text or str(FREE) for text in table.strings(name)]
    filled = TableFile(table.path, {name: cells}, table.places)
    ids = filled.integers(name)
    first: dict[int, int] = {}
    for row in np.flatnonzero(ids != FREE).tolist():
        if ids[row] < 0:
            raise table.error(row, name, f"= {ids[row]}: -1 means any, others count up")
        if (other := first.setdefault(int(ids[row]), row)) != row:
            raise table.error(row, name, f"= {ids[row]} is demanded by {table.places[other]} too")
    return ids
