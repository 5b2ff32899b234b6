"""Instruments and focal planes: what there is, where it is, and what it can reach."""

from typing import TYPE_CHECKING

from fiberloom.lazy import on_use

if TYPE_CHECKING:
    from fiberloom.instruments.arms import Inverse
    from fiberloom.instruments.focal_plane import FocalPlane
    from fiberloom.instruments.generated import generate
    from fiberloom.instruments.layouts import read_layout, write_layout
    from fiberloom.instruments.load import load_instrument, parse_instrument
    from fiberloom.instruments.model import AXES, METROLOGY, Instrument
    from fiberloom.instruments.names import instrument_names

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

__getattr__ = on_use(__name__)
