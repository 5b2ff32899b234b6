"""Instruments and focal planes: what there is, where it stands, and what it can reach."""

from .focal_plane import FocalPlane, Inverse
from .generate import generate
from .layout import read_layout, write_layout
from .load import instrument_names, load_instrument, parse_instrument
from .model import METROLOGY, Instrument

__all__ = [
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
