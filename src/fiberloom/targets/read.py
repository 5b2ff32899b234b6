"""Read target lists: CSV, ECSV, FITS with our columns, or SDSS-V confSummary files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fiberloom.errors import InputError
from fiberloom.tables import TableFile, read_table
from fiberloom.targets.columns import columns_of, is_sky, positioners
from fiberloom.targets.target_list import FREE, TargetList
from fiberloom.targets.yanny import Yanny, read_yanny
from fiberloom.typing import Array
from fiberloom.wholefile import write_whole

if TYPE_CHECKING:
    from fiberloom.instruments import Instrument
    from fiberloom.sky.sky_field import SkyField
    from fiberloom.targets.sky_list import SkyList

REQUIRED = ("target_id", "x_mm", "y_mm")
OPTIONAL = ("priority", "fibre", "positioner_id")
PAR_SUFFIXES = (".par", ".par.gz")


def read_targets(
    path: str | Path, field: SkyField | str | Path | None = None, instrument: str | Instrument = "sdssv"
) -> TargetList:
    """The targets of a file, by the suffix of its name.

    Parameters
    ----------
    path : str or Path
        CSV, ECSV or FITS with the columns target_id, x_mm, y_mm, and where they are there priority (higher
        first, default 0), fibre (default any) and positioner_id (default any, -1). From a confSummary of
        SDSS-V (.par, .par.gz) come the rows with valid = 1 and assigned = 1, each on its own positioner
        and fibre at xwok, ywok.
    field : SkyField, str or Path, optional
        Field on the sky, or its TOML file: the list has ra and dec (and epoch, pmra, ...) in place of x_mm
        and y_mm; of a confSummary the sky columns are read.
    instrument : str or Instrument
        Whose optics lead from the sky to the focal plane.

    Returns
    -------
    TargetList
        In the order of the file; positions in mm.

    Raises
    ------
    InputError
        No such file, a column that is missing, a cell that is no number: file, line, column, rule.

    Examples
    --------
    >>> import fiberloom as fl
    >>> fl.read_targets("targets.csv")
    TargetList(60 targets, x -37.4 to 37 mm, y -37.4 to 36.4 mm)
    >>> fl.read_targets("none.csv")
    Traceback (most recent call last):
    fiberloom.errors.InputError: none.csv: no such file
    """
    path = Path(path)
    if field is not None:
        return _placed(path, field, instrument)
    if path.name.lower().endswith(PAR_SUFFIXES):
        return _from_confsummary(read_yanny(path))
    return _from_table(read_table(path))


def _placed(path: Path, field: SkyField | str | Path, instrument: str | Instrument) -> TargetList:
    from fiberloom.instruments import load_instrument
    from fiberloom.sky.sky_field import SkyField

    where = field if isinstance(field, str | Path) else None
    field = SkyField.read(field) if isinstance(field, str | Path) else field
    model = load_instrument(instrument) if isinstance(instrument, str) else instrument
    return read_sky(path)[0].placed(field.chain(model, where), field)


def read_sky(path: str | Path) -> tuple[SkyList, SkyField | None]:
    """The targets of a file by RA and Dec, and the field of a confSummary.

    Parameters
    ----------
    path : str or Path
        CSV, ECSV or FITS with columns as `sky_list.NAMES` has them; of a confSummary the rows with
        assigned = 1, valid = 1 and on_target = 1, each on its own positioner and fibre.

    Returns
    -------
    tuple
        The list, and for a confSummary the field it was made for.

    Raises
    ------
    InputError
        No RA and Dec; a row that cannot be: file, line, column, rule.
    """
    from fiberloom.sky.sky_field import SkyField
    from fiberloom.targets.sky_list import sky_list

    path = Path(path)
    if not path.name.lower().endswith(PAR_SUFFIXES):
        table = read_table(path)
        if not is_sky(table):
            raise InputError(f"{path}: no columns ra and dec; the columns are {', '.join(table.columns)}")
        if not len(table):
            raise InputError(f"{path}: no rows below the header")
        if "target_id" in columns_of(table):
            table.unique(columns_of(table)["target_id"])
        return sky_list(table), None
    file = read_yanny(path)
    chosen = _rows_of(_fibermap(file), *_FLAGS, "on_target")
    names = _distinct(chosen.strings("catalogid"), chosen.integers("positionerId"))
    return sky_list(chosen, {"target_id": names}), SkyField.of_confsummary(file.keywords, str(path))


def write_targets(targets: TargetList, path: str | Path, comments: tuple[str, ...] = ()) -> None:
    """Write a CSV file that `read_targets` reads; comments go to the top, after #."""
    lines = [f"# {c}" for c in comments] + [",".join(REQUIRED + OPTIONAL)]
    for i in range(len(targets)):
        cells = [
            targets.target_id[i],
            f"{targets.x_mm[i]:.6f}",
            f"{targets.y_mm[i]:.6f}",
            f"{targets.priority[i]:g}",
            targets.fibre[i],
            str(targets.positioner_id[i]),
        ]
        lines.append(",".join(cells))
    write_whole(path, "\n".join(lines) + "\n")


def _from_table(table: TableFile) -> TargetList:
    if "x_mm" not in table and is_sky(table):
        raise InputError(
            f"{table.path}: has RA and Dec; give the field with --field field.toml (`fiberloom sky --help`)"
        )
    table.require(*REQUIRED)
    table.unique("target_id")
    for row in np.flatnonzero(table.strings("target_id") == "").tolist():
        raise table.error(row, "target_id", "is empty")
    n = len(table)
    positioner = positioners(table, "positioner_id") if "positioner_id" in table else np.full(n, FREE)
    return TargetList(
        target_id=table.strings("target_id"),
        x_mm=table.numbers("x_mm"),
        y_mm=table.numbers("y_mm"),
        priority=table.numbers("priority") if "priority" in table else np.zeros(n),
        fibre=table.strings("fibre") if "fibre" in table else np.full(n, "", dtype=np.str_),
        positioner_id=positioner,
    )


_FLAGS = ("valid", "assigned")
_NEEDED = ("positionerId", "fiberType", "assigned", "valid", "xwok", "ywok", "catalogid")


def _from_confsummary(file: Yanny) -> TargetList:
    table = _fibermap(file)
    table.require(*_NEEDED)
    chosen = _rows_of(table, *_FLAGS)
    fibre, positioner = chosen.strings("fiberType"), chosen.integers("positionerId")
    return TargetList(
        target_id=_distinct(chosen.strings("catalogid"), positioner),
        x_mm=chosen.numbers("xwok"),
        y_mm=chosen.numbers("ywok"),
        priority=np.zeros(len(chosen)),
        fibre=fibre,
        positioner_id=positioner,
    )


def _rows_of(table: TableFile, *flags: str) -> TableFile:
    """Rows whose flags are all 1, each of a positioner of its own."""
    table.require("positionerId", *flags)
    keep = np.all([table.integers(flag) == 1 for flag in flags], axis=0)
    if not keep.any():
        raise InputError(f"{table.path}: no row with {' and '.join(f'{flag} = 1' for flag in flags)}")
    chosen = table.select(np.flatnonzero(keep))
    chosen.unique("positionerId", number=True)
    return chosen


def _fibermap(file: Yanny) -> TableFile:
    if "FIBERMAP" not in file.structs:
        raise InputError(
            f"{file.path}: no structure FIBERMAP; a confSummary has one "
            f"(found {', '.join(file.structs) or 'none'})"
        )
    columns = {name: [row[name] for row in file.rows["FIBERMAP"]] for name in file.structs["FIBERMAP"]}
    return TableFile(file.path, columns, [f"line {n}" for n in file.lines["FIBERMAP"]])


def _distinct(catalogid: Array, positioner: Array) -> Array:
    """catalogid where it names one row only; sky places share -999 and get their positioner."""
    names, count = np.unique(catalogid, return_counts=True)
    shared = np.isin(catalogid, names[count > 1])
    made = [f"{c}-P{p}" for c, p in zip(catalogid, positioner, strict=True)]
    return np.where(shared, made, catalogid)
