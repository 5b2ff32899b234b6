"""Focal planes as built: folders of tables, our own and those of instruments."""

from pathlib import Path

from fiberloom.errors import InputError
from fiberloom.instruments.focal_plane import FocalPlane
from fiberloom.instruments.layouts.own import INDEX, read_own, write_layout
from fiberloom.instruments.layouts.sdssv import read_sdssv
from fiberloom.instruments.model import Instrument

__all__ = ["read_layout", "write_layout"]


def read_layout(directory: str | Path, instrument: Instrument) -> FocalPlane:
    """The focal plane in a folder: one that `write_layout` wrote, or SDSS-V calibrations."""
    folder = Path(directory)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such directory; a layout is a folder of tables")
    if (folder / INDEX).is_file():
        return read_own(folder, instrument)
    if (folder / "positionerTable.csv").is_file():
        return read_sdssv(folder, instrument)
    raise InputError(
        f"{folder}: neither {INDEX} (a layout of fiberloom) nor positionerTable.csv (SDSS-V) in it"
    )
