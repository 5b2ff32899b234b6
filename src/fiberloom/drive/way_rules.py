"""What a drive asks of an assignment, by the protocol of its instrument."""

from __future__ import annotations

from fiberloom.assignment.candidates import WayRule
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats


def way_rule(plane: FocalPlane, scatter: Floats | None = None) -> WayRule | None:
    """The rule for the targets of a `plane`; None: its drive finds a way to all that do not touch.

    `scatter` (N, 2), dimensionless: rms by which moves of both motors miss, of their way; None: not known.
    """
    # motors of all kinds take a while to load, and an array has those of one
    protocol = plane.instrument.drive.protocol
    if protocol == "pfs":
        from fiberloom.drive.piezo.ways_out import WaysOut

        return WaysOut.of(plane, scatter)
    if protocol == "desi":
        from fiberloom.drive.desi.maps.reach import SureReach

        return SureReach.of(plane)
    return None
