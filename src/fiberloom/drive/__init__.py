"""What an instrument's own motors make of a planned way: the port that operation sees, and the drives."""

from typing import TYPE_CHECKING

from fiberloom.lazy import on_use

if TYPE_CHECKING:
    from fiberloom.drive.port import BelievedPlaces, Drive, DriveModel, Programme, Suspect, Wanted

__all__ = ["BelievedPlaces", "Drive", "DriveModel", "Programme", "Suspect", "Wanted"]

__getattr__ = on_use(__name__)
