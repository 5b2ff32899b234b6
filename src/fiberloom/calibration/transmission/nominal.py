"""Maps where nothing was calibrated: the nominal ratio of the gears."""

from __future__ import annotations

import numpy as np

from fiberloom.calibration.transmission.maps import Provenance, TransmissionMaps
from fiberloom.instruments import FocalPlane

NOMINAL = "nominal ratio, not calibrated"


def nominal_maps(plane: FocalPlane) -> TransmissionMaps:
    """The identity for all N positioners of the plane: the wire position is the output angle, in deg."""
    ends = np.broadcast_to(plane.hard_stops_deg[None, :, None, :], (plane.n, 2, 2, 2)).copy()
    gear = float(plane.instrument.alpha.gear)
    provenance = Provenance(plane.config_hash(), gear=gear, note=NOMINAL)
    return TransmissionMaps(plane.positioner_id, ends, ends.copy(), provenance)
