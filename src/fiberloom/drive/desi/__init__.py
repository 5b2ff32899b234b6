"""DESI's open-loop motors on a rotating field: move tables, their frames, and the laws that steer by them."""

from fiberloom.drive.desi.frames import DesiCommand, DesiFrame, TableRow, checksum, decode_row, encode_row
from fiberloom.drive.desi.laws import TrackingLaw
from fiberloom.drive.desi.maps.learned import PLANETARY, SMOOTH, LearnedMaps, MapBasis
from fiberloom.drive.desi.paths import FieldPath, executed_path
from fiberloom.drive.desi.tables import MoveTables, move_tables

__all__ = [
    "PLANETARY",
    "SMOOTH",
    "DesiCommand",
    "DesiFrame",
    "FieldPath",
    "LearnedMaps",
    "MapBasis",
    "MoveTables",
    "TableRow",
    "TrackingLaw",
    "checksum",
    "decode_row",
    "encode_row",
    "executed_path",
    "move_tables",
]
