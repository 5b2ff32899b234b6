"""What a drive asks of an assignment, by the protocol of its instrument."""

from __future__ import annotations

from collections.abc import Callable

from fiberloom.assignment.candidates import WayRule
from fiberloom.drive.desi.maps.reach import SureReach
from fiberloom.drive.piezo.ways_out import WaysOut
from fiberloom.instruments import FocalPlane


def way_rule(plane: FocalPlane) -> WayRule | None:
    """The rule for the targets of a `plane`; None: its drive finds a way to all that do not touch."""
    rules: dict[str, Callable[[FocalPlane], WayRule]] = {"pfs": WaysOut.of, "desi": SureReach.of}
    rule = rules.get(plane.instrument.drive.protocol)
    return None if rule is None else rule(plane)
