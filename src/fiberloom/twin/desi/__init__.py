"""DESI in the twin: units, controllers, true motion and contacts."""

from fiberloom.twin.desi.array import DesiTwin
from fiberloom.twin.desi.units import PERFECT_ARMS, PUBLISHED_FAULTS, DesiSizes, DesiUnits, draw_desi_units

__all__ = ["PERFECT_ARMS", "PUBLISHED_FAULTS", "DesiSizes", "DesiTwin", "DesiUnits", "draw_desi_units"]
