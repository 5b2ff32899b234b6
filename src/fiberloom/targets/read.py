"""Read target lists: CSV, ECSV, FITS with our columns, or SDSS-V confSummary files."""

from pathlib import Path

import numpy as np

from fiberloom.errors import InputError
from fiberloom.tables import TableFile, read_table
from fiberloom.targets.target_list import FREE, TargetList
from fiberloom.targets.yanny import Yanny, read_yanny
from fiberloom.typing import Array, Ints
from fiberloom.wholefile import write_whole

REQUIRED = ("target_id", "x_mm", "y_mm")
OPTIONAL = ("priority", "fibre", "positioner_id")
PAR_SUFFIXES = (".par", ".par.gz")


def read_targets(path: str | Path) -> TargetList:
    """The targets of a file, by the suffix of its name.

    Parameters
    ----------
    path : str or Path
        CSV, ECSV or FITS with the columns target_id, x_mm, y_mm, and where they are there priority (higher
        first, default 0), fibre (default any) and positioner_id (default any, -1). From a confSummary of
        SDSS-V (.par, .par.gz) come the rows with valid = 1 and assigned = 1, each on its own positioner
        and fibre at xwok, ywok.

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
    if path.name.lower().endswith(PAR_SUFFIXES):
        return _from_confsummary(read_yanny(path))
    return _from_table(read_table(path))


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
    if "x_mm" not in table and _is_sky(table):
        raise InputError(
            f"{table.path}: sky coordinates are not supported yet; give x_mm, y_mm in the focal plane"
        )
    table.require(*REQUIRED)
    table.unique("target_id")
    for row in np.flatnonzero(table.strings("target_id") == "").tolist():
        raise table.error(row, "target_id", "is empty")
    n = len(table)
    positioner = _positioners(table) if "positioner_id" in table else np.full(n, FREE)
    return TargetList(
        target_id=table.strings("target_id"),
        x_mm=table.numbers("x_mm"),
        y_mm=table.numbers("y_mm"),
        priority=table.numbers("priority") if "priority" in table else np.zeros(n),
        fibre=table.strings("fibre") if "fibre" in table else np.full(n, "", dtype=np.str_),
        positioner_id=positioner,
    )


def _is_sky(table: TableFile) -> bool:
    names = {name.lower() for name in table.columns}
    return bool(names & {"ra", "ra_deg", "racat"}) and bool(names & {"dec", "dec_deg", "deccat"})


def _positioners(table: TableFile) -> Ints:
    """Whole numbers; empty cells are free. Two targets must not demand one positioner."""
    cells = [text or str(FREE) for text in table.strings("positioner_id")]
    filled = TableFile(table.path, {"positioner_id": cells}, table.places)
    ids = filled.integers("positioner_id")
    first: dict[int, int] = {}
    for row in np.flatnonzero(ids != FREE).tolist():
        if ids[row] < 0:
            raise table.error(row, "positioner_id", f"= {ids[row]}: -1 means any, others count up")
        if (other := first.setdefault(int(ids[row]), row)) != row:
            raise table.error(row, "positioner_id", f"= {ids[row]} is demanded by {table.places[other]} too")
    return ids


_NEEDED = ("positionerId", "fiberType", "assigned", "valid", "xwok", "ywok", "catalogid")


def _from_confsummary(file: Yanny) -> TargetList:
    table = _fibermap(file)
    table.require(*_NEEDED)
    keep = (table.integers("valid") == 1) & (table.integers("assigned") == 1)
    if not keep.any():
        raise InputError(f"{file.path}: no row with valid = 1 and assigned = 1")
    rows = np.flatnonzero(keep).tolist()
    chosen = TableFile(
        file.path,
        {name: [cells[i] for i in rows] for name, cells in table.columns.items()},
        [table.places[i] for i in rows],
    )
    chosen.unique("positionerId", number=True)
    fibre, positioner = chosen.strings("fiberType"), chosen.integers("positionerId")
    return TargetList(
        target_id=_distinct(chosen.strings("catalogid"), positioner),
        x_mm=chosen.numbers("xwok"),
        y_mm=chosen.numbers("ywok"),
        priority=np.zeros(len(rows)),
        fibre=fibre,
        positioner_id=positioner,
    )


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
