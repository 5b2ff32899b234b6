"""The twin of any instrument, by the protocol of its motors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fiberloom.instruments import FocalPlane

if TYPE_CHECKING:
    from fiberloom.twin.cobras.source import CobraSource
    from fiberloom.twin.desi.source import DesiSource
    from fiberloom.twin.source import TwinSource
    from fiberloom.twin.steppers.source import StepperSource

    AnySource = TwinSource | DesiSource | CobraSource | StepperSource


def source_of(plane: FocalPlane, seed: int, camera: str, faults: str = "", errors: str = "none") -> AnySource:
    """The twin of a `plane`, with the motors and the boards of its instrument.

    `seed` of units and noise; `camera`: noise or image; `faults` and `errors`: what goes wrong, and what is
    off its tables. InputError where the twin does not have such motors, or does not know one of these.
    """
    # the motors of all instruments take a while to load, and an array has those of one
    protocol = plane.instrument.drive.protocol
    if protocol in ("sdssv", "none"):
        from fiberloom.twin.source import TwinSource

        return TwinSource(plane, seed, camera, faults, errors)
    if protocol == "pfs":
        from fiberloom.twin.cobras.source import CobraSource

        return CobraSource(plane, seed, camera, faults, errors)
    if protocol == "desi":
        from fiberloom.twin.desi.source import DesiSource

        return DesiSource(plane, seed, camera, faults, errors)
    from fiberloom.twin.steppers.kinds import KINDS
    from fiberloom.twin.steppers.source import StepperSource

    return StepperSource(plane, KINDS[protocol], seed, camera, faults, errors)
