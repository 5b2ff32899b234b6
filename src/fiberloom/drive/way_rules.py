"""What a drive asks of an assignment, by the protocol of its instrument."""

from __future__ import annotations

from fiberloom.assignment.candidates import WayRule
from fiberloom.drive.piezo.ways_out import WaysOut
from fiberloom.instruments import FocalPlane


def way_rule(plane: FocalPlane) -> WayRule | None:
    """The rule for the targets of a `plane`; None: its drive finds a way to all that do not touch."""
    return WaysOut.of(plane) if plane.instrument.drive.protocol == "pfs" else None
