"""Focal planes as built: folders of tables, our own and those of instruments."""

from collections.abc import Callable
from pathlib import Path

from fiberloom.errors import InputError
from fiberloom.instruments.focal_plane import FocalPlane
from fiberloom.instruments.layouts.desi import CALIBRATIONS, read_desi
from fiberloom.instruments.layouts.folder import newest
from fiberloom.instruments.layouts.megara import TABLES, read_megara
from fiberloom.instruments.layouts.own import INDEX, read_own, write_layout
from fiberloom.instruments.layouts.pfs import SCALARS, read_pfs
from fiberloom.instruments.layouts.sdssv import read_sdssv
from fiberloom.instruments.model import Instrument

__all__ = ["read_layout", "write_layout"]

Reader = Callable[[Path, Instrument], FocalPlane]

_BY_FILE: dict[tuple[str, ...], tuple[str, Reader]] = {
    (INDEX,): ("a layout of fiberloom", read_own),
    ("positionerTable.csv",): ("SDSS-V", read_sdssv),
    CALIBRATIONS: ("DESI", read_desi),
    (*SCALARS, *(f"derived/{name}" for name in SCALARS)): ("PFS", read_pfs),
    TABLES: ("MEGARA", read_megara),
}
"""By the files that give a folder away: whose it is, and its reader."""


def read_layout(directory: str | Path, instrument: Instrument) -> FocalPlane:
    """The focal plane in a folder: one that `write_layout` wrote, or the tables of an instrument.

    Parameters
    ----------
    directory : str or Path
        The folder. Which kind it is, its files tell.
    instrument : Instrument
        That the tables belong to.

    Returns
    -------
    FocalPlane

    Raises
    ------
    InputError
        No such folder, no table of a known kind in it, a table that cannot be read, or one of another
        instrument.
    """
    folder = Path(directory)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such directory; a layout is a folder of tables")
    for patterns, (_, read) in _BY_FILE.items():
        if newest(folder, *patterns) is not None:
            return read(folder, instrument)
    known = ", ".join(f"{patterns[0]} ({whose})" for patterns, (whose, _) in _BY_FILE.items())
    raise InputError(f"{folder}: none of {known} in it")
