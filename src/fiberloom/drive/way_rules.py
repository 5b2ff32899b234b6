"""What a drive asks of an assignment, by the protocol of its instrument."""

from __future__ import annotations

from collections.abc import Callable

from fiberloom.assignment.candidates import WayRule
from fiberloom.drive.desi.maps.reach import SureReach
from fiberloom.drive.piezo.ways_out import WaysOut
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats


def way_rule(plane: FocalPlane, scatter: Floats | None = None) -> WayRule | None:
    """The rule for the targets of a `plane`; None: its drive finds a way to all that do not touch.

    `scatter` (N, 2), dimensionless: rms by which moves of both motors miss, of their way; None: not known.
    """
    rules: dict[str, Callable[[FocalPlane], WayRule]] = {
        "pfs": lambda known: WaysOut.of(known, scatter),
        "desi": SureReach.of,
    }
    rule = rules.get(plane.instrument.drive.protocol)
    return None if rule is None else rule(plane)
