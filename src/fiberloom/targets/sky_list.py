"""Lists of targets on the sky: CSV, ECSV, FITS with RA and Dec, or the sky columns of a confSummary."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.errors import InputError
from fiberloom.sky.chain import Chain, SkyPlaces
from fiberloom.sky.on_sky import OnSky
from fiberloom.sky.sky_field import SkyField
from fiberloom.sky.sky_targets import GUIDE, SkyTargets
from fiberloom.tables import TableFile
from fiberloom.targets.columns import NAMES, columns_of, positioners
from fiberloom.targets.target_list import TargetList
from fiberloom.typing import Array, Flags, Floats

MISSING = (-999.0, -9999.0)
"""Numbers that stand for none, if they are met exactly: real stars move by less than -999 mas/yr."""
_YEARS = (1850.0, 2150.0)


@dataclass(frozen=True, eq=False)
class SkyList:
    """Targets on the sky, and where each was read."""

    path: Path
    targets: SkyTargets
    rows: list[str]
    """For each target, how to find it: `line 12`."""

    def __len__(self) -> int:
        return len(self.targets)

    def error(self, row: int, problem: str) -> InputError:
        """The complaint about one target."""
        return InputError(f"{self.path}, {self.rows[row]}: target {self.targets.target_id[row]} {problem}")

    @property
    def is_guide(self) -> Flags:
        """(n,) which are guide stars."""
        return np.asarray(self.targets.fibre == GUIDE)

    def select(self, rows: Flags) -> SkyList:
        """Some of the targets, by a mask (`rows`)."""
        places = [self.rows[k] for k in np.flatnonzero(rows).tolist()]
        return SkyList(self.path, self.targets.select(rows), places)

    def placed(self, chain: Chain, field: SkyField | None = None) -> TargetList:
        """The targets in mm, without the guide stars: for each science fibre its own place.

        `chain`: at the moment of placing; `field`: what it is of, which the list in mm then remembers with
        the guide stars. Raises InputError for a target that is outside of what the optics' fit covers, too
        low, or of no known wavelength, and for a list of guide stars alone.
        """
        guide = self.is_guide
        if len(self) and guide.all():
            raise InputError(f"{self.path}: all {len(self)} rows are guide stars; name targets too")
        guides = self.targets.select(guide) if guide.any() else None
        return self.select(~guide)._placed(chain, field, guides)

    def _placed(self, chain: Chain, field: SkyField | None, guides: SkyTargets | None) -> TargetList:
        fibres = chain.instrument.science_fibres
        asked = self.targets.fibre
        for row in np.flatnonzero(~np.isin(asked, ("", *fibres)))[:1].tolist():
            raise self.error(row, f"asks for fibre '{asked[row]}'; there are {', '.join(fibres)}")
        places = {fibre: self.checked(chain, fibre) for fibre in fibres}
        xy_mm = np.empty((len(self), 2))
        for fibre in reversed(fibres):  # the first is what those get that ask for none
            rows = (asked == fibre) | (asked == "")
            xy_mm[rows] = places[fibre].xy_mm[rows]
        x_mm, y_mm = xy_mm.T.copy()
        t = self.targets
        by_fibre = {fibre: seen.xy_mm for fibre, seen in places.items()}
        on_sky = None if field is None else OnSky(t, chain, field, guides)
        return TargetList(t.target_id, x_mm, y_mm, t.priority, t.fibre, t.positioner_id, by_fibre, on_sky)

    def checked(self, chain: Chain, fibre: str | None = None) -> SkyPlaces:
        """Places of all targets for a fibre (or each for its own), refused where one is not to be had."""
        try:
            seen = chain.place(self.targets, fibre)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None
        at = f"at {chain.pointing.time.iso} UTC"
        _, limit_deg = chain.optics(chain.guide_A)
        self._refuse(seen.altitude_deg < 0.0, -seen.altitude_deg, f"is {{:.1f}} deg below the horizon {at}")
        self._refuse(seen.low, seen.altitude_deg, f"is {{:.1f}} deg high {at}: too low")
        known = f"the optics are known to {limit_deg:g} deg"
        self._refuse(
            seen.outside, seen.field_angle_deg, f"is {{:.3f}} deg from the centre of the field; {known}"
        )
        return seen

    def _refuse(self, bad: Flags, value: Floats, told: str) -> None:
        """Raises InputError for the first of the rows that are bad; `told` has a place for its value."""
        rows = np.flatnonzero(bad).tolist()
        if rows:
            more = f" (and {len(rows) - 1} more)" if len(rows) > 1 else ""
            raise self.error(rows[0], told.format(value[rows[0]]) + more)


def sky_list(table: TableFile, names: Mapping[str, Any] | None = None) -> SkyList:
    """The targets of a table with RA and Dec; `names`: columns that are known already, in place of those."""
    found = columns_of(table)
    if "target_id" not in found and "target_id" not in (names or {}):
        raise InputError(f"{table.path}: no column {' or '.join(NAMES['target_id'])}")
    table.require(found["ra_deg"], found["dec_deg"])
    columns: dict[str, Array] = {name: _sure(table, found[name]) for name in ("ra_deg", "dec_deg")}
    for ours in set(found) - {"target_id", "fibre", "positioner_id", "ra_deg", "dec_deg"}:
        missing = math.nan if ours in ("epoch_yr", "wavelength_A") else 0.0
        columns[ours] = _numbers(table, found[ours], missing)
    columns["target_id"] = _names(table, found) if "target_id" in found else np.array([])
    if "fibre" in found:
        columns["fibre"] = table.strings(found["fibre"])
    if (role := _role(table)) is not None:
        asked = columns.get("fibre", np.full(len(table), "", dtype=f"U{len(GUIDE)}"))
        columns["fibre"] = np.where(role == GUIDE, GUIDE, asked)
    if "positioner_id" in found:
        columns["positioner_id"] = positioners(table, found["positioner_id"])
    columns |= names or {}
    _check(table, found, columns)
    return SkyList(table.path, SkyTargets(**columns), list(table.places))


def _role(table: TableFile) -> Array | None:
    """The column `role` of a list that has one: "guide" is a guide star as is the fibre "guide"."""
    named = next((name for name in table.columns if name.lower() == "role"), None)
    return None if named is None else table.strings(named)


def _names(table: TableFile, found: Mapping[str, str]) -> Array:
    name = found["target_id"]
    for row in np.flatnonzero(table.strings(name) == "").tolist():
        raise table.error(row, name, "is empty")
    return table.strings(name)


def _sure(table: TableFile, name: str) -> Floats:
    values = table.numbers(name)
    for row in np.flatnonzero(np.isin(values, MISSING)).tolist():
        raise table.error(row, name, f"= {values[row]:g}: a target has a place")
    return values


def _numbers(table: TableFile, name: str, missing: float) -> Floats:
    """A column of which cells may be empty, NaN or exactly -999."""
    cells = ["" if _is_missing(text) else text for text in table.strings(name).tolist()]
    gone = np.array([cell == "" for cell in cells], dtype=np.bool_)
    filled = TableFile(table.path, {name: [cell or "0" for cell in cells]}, table.places)
    return np.where(gone, missing, filled.numbers(name))


def _is_missing(text: str) -> bool:
    try:
        value = float(text)
    except ValueError:
        return text in ("", "--")
    return math.isnan(value) or value in MISSING


def _check(table: TableFile, found: Mapping[str, str], columns: Mapping[str, Array]) -> None:
    """What can be wrong with a row."""
    n = len(table)
    epoch = columns.get("epoch_yr", np.full(n, np.nan))
    zero = np.zeros(n)
    moves = (columns.get("pm_ra_mas_yr", zero) != 0.0) | (columns.get("pm_dec_mas_yr", zero) != 0.0)
    rules = {
        "ra_deg": (np.abs(columns["ra_deg"]) > 360.0, "must be 0 to 360 deg"),
        "dec_deg": (np.abs(columns["dec_deg"]) > 90.0, "must be -90 to 90 deg"),
        "epoch_yr": ((epoch < _YEARS[0]) | (epoch > _YEARS[1]), "must be a Julian year such as 2016.0"),
        "wavelength_A": (
            (columns.get("wavelength_A", np.ones(n)) < 2000.0) & ("wavelength_A" in columns),
            "must be in Angstrom, 2000 or more",
        ),
    }
    for ours, (bad, rule) in rules.items():
        for row in np.flatnonzero(bad).tolist():
            raise table.error(row, found[ours], f"= {columns[ours][row]:g}: {rule}")
    for row in np.flatnonzero(moves & np.isnan(epoch)).tolist():
        raise InputError(f"{table.path}, {table.places[row]}: has a proper motion, but no epoch")
