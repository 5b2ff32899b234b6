"""Where every fibre looks, for the pipelines downstream: a FITS table, and SDSS-V's confSummaryF.

RA and Dec under a fibre are those of its place as measured (on a twin too): the metrology fibre in the last
image, and from there to the science fibre by the arm. The place of a fibre on a target is the target's plus
what the image shows it to be off. They are ICRS at the middle of the exposure, of a star that does not move.
What guide stars have told of the telescope is taken off before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fiberloom.health.status import FibreFlag
from fiberloom.instruments import METROLOGY
from fiberloom.operation.move import Move
from fiberloom.operation.results.files import MARKS, flags_of
from fiberloom.sky.chain import Chain
from fiberloom.sky.on_sky import OnSky
from fiberloom.typing import Floats, Ints
from fiberloom.units import UM_PER_MM
from fiberloom.wholefile import whole, write_whole

if TYPE_CHECKING:
    from astropy.table import Table

    from fiberloom.operation.results.observed import ObservedField

FIBERMAP, CONFSUMMARY = "fibermap.fits", "confSummaryF.par"
_MISSING = -999.0


def fibermap(observed: ObservedField) -> Table:
    """One row for each science fibre of each positioner, after the last move.

    Parameters
    ----------
    observed : ObservedField
        Of a list on the sky, with at least one move.

    Returns
    -------
    Table
        FITS names in capitals; places in mm, RA and Dec in deg, errors in um, offsets of the fibre from its
        target in arcsec (east with the cosine of the declination); NaN where there is no target or nothing
        was seen. STATUS has the bits of `FibreFlag`.
    """
    from astropy.table import Table

    sky = observed.targets.on_sky
    assert sky is not None
    chain = sky.then((len(observed.about.get("series", [0])) - 1) * sky.field.cadence_s)
    parts = [_of_fibre(observed, sky, chain, fibre) for fibre in observed.plane.science_fibres]
    rows = np.concatenate([part.pop("rows") for part in parts])
    order = np.argsort(rows, kind="stable")
    table = Table({name: np.concatenate([part[name] for part in parts])[order] for name in parts[0]})
    table.meta = _head(observed, chain)
    return table


def _of_fibre(observed: ObservedField, sky: OnSky, chain: Chain, fibre: str) -> dict[str, Any]:
    """Columns for the positioners that carry a fibre."""
    plane, move, assignment = observed.plane, observed.final, observed.assignment
    rows = np.flatnonzero(plane.carries(fibre))
    mine = (assignment.target[rows] >= 0) & (assignment.fibre[rows] == fibre)
    target_mm = np.where(mine[:, None], observed.target_mm(move)[rows], np.nan)
    xy_mm = _fibre_mm(observed, fibre)[rows]
    off_mm = (move.measurement.xy_mm - observed.metrology_goal_mm(move) + observed.frame_mm())[rows]
    xy_mm = np.where(mine[:, None], target_mm + off_mm, xy_mm)
    wavelength = np.full(len(rows), chain.wavelength_of(fibre))
    own = sky.asked(np.where(mine, assignment.target[rows], -1), assignment.fibre[rows])
    wavelength[mine] = chain.wavelengths_A(own)
    here, there = (chain.sky(_level_mm(move, mm), wavelength) for mm in (xy_mm, target_mm))
    east_deg = (here[:, 0] - there[:, 0] + 180.0) % 360.0 - 180.0
    taken = np.where(mine, assignment.target[rows], -1)
    return {
        "rows": rows,
        "POSITIONER_ID": plane.positioner_id[rows],
        "FIBRE": np.full(len(rows), fibre),
        "TARGET_ID": np.append(observed.targets.target_id, "")[taken],
        "PRIORITY": np.append(observed.targets.priority, np.nan)[taken],
        "WAVELENGTH_A": wavelength,
        "X_MM": xy_mm[:, 0],
        "Y_MM": xy_mm[:, 1],
        "X_TARGET_MM": target_mm[:, 0],
        "Y_TARGET_MM": target_mm[:, 1],
        "FIBRE_RA": here[:, 0],
        "FIBRE_DEC": here[:, 1],
        "TARGET_RA": there[:, 0],
        "TARGET_DEC": there[:, 1],
        "OFFSET_RA": 3600.0 * east_deg * np.cos(np.radians(there[:, 1])),
        "OFFSET_DEC": 3600.0 * (here[:, 1] - there[:, 1]),
        "ERROR_UM": UM_PER_MM * np.hypot(*(xy_mm - target_mm).T),
        "STATUS": _status(observed, rows, mine),
    }


def _level_mm(move: Move, xy_mm: Floats) -> Floats:
    """(n, 2) places on a telescope that points as it should: what guide stars have told is taken off."""
    return xy_mm if move.pointed is None else move.pointed.removed(xy_mm)


def _fibre_mm(observed: ObservedField, fibre: str) -> Floats:
    """(N, 2) mm of a fibre, by the arms as commanded and the metrology fibre as seen."""
    plane, move = observed.plane, observed.final
    alpha_deg, beta_deg = move.commanded_deg.T
    seen_mm = np.where(move.measurement.seen[:, None], move.measurement.xy_mm, np.nan)
    off_mm = seen_mm - plane.forward(alpha_deg, beta_deg, METROLOGY)
    place: Floats = plane.forward(alpha_deg, beta_deg, fibre) + off_mm
    return place


def _status(observed: ObservedField, rows: Ints, mine: Any) -> Ints:
    """Bits of `FibreFlag`; a fibre without a target on a positioner that has one is no fault of it."""
    flags = flags_of(observed, observed.final)[rows]
    alone = flags & ~int(FibreFlag.OFF_TARGET) | int(FibreFlag.NO_TARGET)
    return np.asarray(np.where(mine, flags, alone), dtype=np.int64)


def _head(observed: ObservedField, chain: Chain) -> dict[str, Any]:
    marks = {name.upper()[:8]: observed.about[name] for name in MARKS if name in observed.about}
    sky = observed.targets.on_sky
    assert sky is not None
    field = {
        "RACEN": chain.pointing.ra_deg,
        "DECCEN": chain.pointing.dec_deg,
        "POSANGLE": chain.pointing.pa_deg,
        "MIDUTC": chain.pointing.time.iso,
        "EXPTIME": sky.field.exposure_s,
        "SITE": chain.site.name,
        "AIRMASS": chain.airmass,
        "FOCSCALE": chain.view.scale,
    }
    return marks | field | _pointed(observed.final)


def _pointed(move: Move) -> dict[str, float]:
    """What guide stars have told, for those who go from mm to the sky themselves."""
    if (off := move.pointed) is None:
        return {}
    x_mm, y_mm = off.offset_mm.tolist()
    return {"GUIDEX": x_mm, "GUIDEY": y_mm, "GUIDEROT": off.rotation_deg, "GUIDESC": off.scale}


@dataclass(frozen=True, eq=False)
class FibreMap:
    """What pipelines downstream get of an observation."""

    table: Table
    """As of `fibermap`."""
    confsummary: str
    """Text of a confSummaryF; empty: not of SDSS-V."""

    @classmethod
    def of(cls, observed: ObservedField) -> FibreMap:
        """Of an observation of a list on the sky, with at least one move."""
        table = fibermap(observed)
        theirs = observed.plane.instrument.name == "sdssv"
        return cls(table, confsummary(observed, table) if theirs else "")

    def write(self, folder: Path) -> list[str]:
        """Writes `fibermap.fits`, and for SDSS-V `confSummaryF.par`, into a folder; their names."""
        with whole(folder / FIBERMAP) as path:
            self.table.write(path, format="fits", overwrite=True)
        if not self.confsummary:
            return [FIBERMAP]
        write_whole(folder / CONFSUMMARY, self.confsummary)
        return [FIBERMAP, CONFSUMMARY]


def write_fibermap(observed: ObservedField, folder: Path) -> list[str]:
    """Writes the files of `FibreMap` into a folder; their names."""
    return FibreMap.of(observed).write(folder)


_COLUMNS = {
    "positionerId": "short",
    "holeId": "char",
    "fiberType": "char",
    "assigned": "short",
    "on_target": "short",
    "valid": "short",
    "xwok": "double",
    "ywok": "double",
    "alpha": "double",
    "beta": "double",
    "racat": "double",
    "deccat": "double",
    "pmra": "double",
    "pmdec": "double",
    "parallax": "double",
    "ra": "double",
    "dec": "double",
    "lambda_eff": "double",
    "coord_epoch": "double",
    "catalogid": "char",
    "delta_ra": "double",
    "delta_dec": "double",
}
_BAD = FibreFlag.NOT_SEEN | FibreFlag.LYING | FibreFlag.ASTRAY | FibreFlag.UNSURE | FibreFlag.DEAD
_BAD |= FibreFlag.DISCONNECTED | FibreFlag.OFFLINE


def confsummary(observed: ObservedField, table: Table) -> str:
    """The text of a confSummaryF of SDSS-V, of the fibre map `table`: places as measured, `epoch` in TAI."""
    sky = observed.targets.on_sky
    assert sky is not None
    head = table.meta
    time = sky.then((len(observed.about.get("series", [0])) - 1) * sky.field.cadence_s).pointing.time
    tai = time.tai
    keywords = {
        "configuration_id": observed.about.get("run", -999),
        "observatory": str(head["SITE"]).upper(),
        "raCen": repr(float(head["RACEN"])),
        "decCen": repr(float(head["DECCEN"])),
        "pa": repr(float(head["POSANGLE"])),
        "epoch": repr(float(tai[0] + tai[1])),
        "focal_scale": repr(float(head["FOCSCALE"])),
    }
    size = {"char": "[64]"}
    members = [f"    {kind} {name}{size.get(kind, '')};" for name, kind in _COLUMNS.items()]
    lines = ["#%yanny", "# written by fiberloom", *(f"{key} {value}" for key, value in keywords.items())]
    lines += ["", "typedef struct {", *members, "} FIBERMAP;", ""]
    return "\n".join([*lines, *_rows(observed, sky, table)]) + "\n"


def _rows(observed: ObservedField, sky: OnSky, table: Table) -> Sequence[str]:
    """Lines of FIBERMAP."""
    index = {str(name): k for k, name in enumerate(sky.targets.target_id)}
    where = {int(number): k for k, number in enumerate(observed.plane.positioner_id)}
    lines = []
    for row in table:
        k = where[int(row["POSITIONER_ID"])]
        own = index.get(str(row["TARGET_ID"]), -1)
        lines.append("FIBERMAP " + " ".join(map(_cell, _row(observed, sky, row, k, own).values())))
    return lines


def _row(observed: ObservedField, sky: OnSky, row: Any, k: int, own: int) -> Mapping[str, Any]:
    """A row with the columns of `_COLUMNS`; `k`: of the positioner, `own`: of its target, -1 for none."""
    t, status = sky.targets, int(row["STATUS"])
    has = own >= 0
    known = {
        "racat": t.ra_deg[own],
        "deccat": t.dec_deg[own],
        "pmra": t.pm_ra_mas_yr[own],
        "pmdec": t.pm_dec_mas_yr[own],
        "parallax": t.parallax_mas[own],
        "coord_epoch": t.epoch_yr[own],
        "delta_ra": t.delta_ra_arcsec[own],
        "delta_dec": t.delta_dec_arcsec[own],
    }
    made = {
        "positionerId": int(row["POSITIONER_ID"]),
        "holeId": str(observed.plane.hole[k]),
        "fiberType": str(row["FIBRE"]),
        "assigned": int(has),
        "on_target": int(has and not status & int(FibreFlag.OFF_TARGET | _BAD)),
        "valid": int(not status & int(_BAD)),
        "xwok": row["X_MM"],
        "ywok": row["Y_MM"],
        "alpha": observed.final.commanded_deg[k, 0],
        "beta": observed.final.commanded_deg[k, 1],
        "ra": row["FIBRE_RA"],
        "dec": row["FIBRE_DEC"],
        "lambda_eff": row["WAVELENGTH_A"],
        "catalogid": str(row["TARGET_ID"]) if has else "-999",
    }
    made |= {name: value if has else _MISSING for name, value in known.items()}
    return {name: made[name] for name in _COLUMNS}


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, int):
        return str(value)
    number = float(value)
    return repr(number if np.isfinite(number) else _MISSING)
