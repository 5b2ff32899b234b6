"""Instruments and focal planes: what there is, where it is, and what it can reach."""

from fiberloom.instruments.focal_plane import FocalPlane, Inverse
from fiberloom.instruments.generate import generate
from fiberloom.instruments.layout import read_layout, write_layout
from fiberloom.instruments.load import instrument_names, load_instrument, parse_instrument
from fiberloom.instruments.model import AXES, METROLOGY, Instrument

__all__ = [
    "AXES",
    "METROLOGY",
    "FocalPlane",
    "Instrument",
    "Inverse",
    "generate",
    "instrument_names",
    "load_instrument",
    "parse_instrument",
    "read_layout",
    "write_layout",
]
