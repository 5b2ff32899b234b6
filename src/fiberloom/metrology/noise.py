"""How much a measured move scatters: camera, arrivals, and what the maps do not know."""

from __future__ import annotations

from dataclasses import dataclass

from fiberloom.instruments import FocalPlane
from fiberloom.instruments.axis import DriveTable

_SAID = DriveTable()
WORKSPACE_UM = 0.669
"""Kronig 2020, Fig. 18: the camera of the full workspace on a static fibre, 2-D rms. For those who
name no instrument; an instrument says itself: `metrology.noise_rms_um`."""


@dataclass(frozen=True)
class CorrectionNoise:
    """What the filter believes of camera and positioners, 2-D rms in um."""

    camera_um: float = WORKSPACE_UM
    """Of a camera that does not tell the covariance of what it measures."""
    repeatability_um: float = _SAID.arrival_um
    """Scatter of arrivals at the same command."""
    blind_um: float = _SAID.blind_um
    """Error before the first image."""
    place_um: float = _SAID.place_um
    """What a fibre is off that no offset of its angles explains: lengths of the arms, the camera's frame."""
    drift_um: float = _SAID.drift_um
    """How much the offset itself changes from move to move."""
    slope: float = _SAID.slope
    """How much it changes over the way of a correction, as a share of that way, rms."""

    @classmethod
    def of(cls, plane: FocalPlane) -> CorrectionNoise:
        """With the camera and the motors of this instrument."""
        said = plane.instrument.drive
        return cls(
            camera_um=plane.instrument.metrology.noise_rms_um,
            repeatability_um=said.arrival_um,
            blind_um=said.blind_um,
            place_um=said.place_um,
            drift_um=said.drift_um,
            slope=said.slope,
        )
