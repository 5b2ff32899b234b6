"""How much a measured move scatters: camera, arrivals, and what the maps do not know."""

from __future__ import annotations

from dataclasses import dataclass

from fiberloom.instruments import FocalPlane

WORKSPACE_UM = 0.669
"""Kronig 2020, Fig. 18: the camera of the full workspace on a static fibre, 2-D rms. For those who
name no instrument; an instrument says itself: `metrology.noise_rms_um`."""


@dataclass(frozen=True)
class CorrectionNoise:
    """What the filter believes of camera and positioners, 2-D rms in um."""

    camera_um: float = WORKSPACE_UM
    """Of a camera that does not tell the covariance of what it measures."""
    repeatability_um: float = 0.2
    """Scatter of arrivals at the same command."""
    blind_um: float = 10.0
    """Error before the first image."""
    place_um: float = 6.0
    """What a fibre is off that no offset of its angles explains: lengths of the arms, the camera's frame.
    On the twin 6 and 10 um do as well, with arms that are calibrated and with arms of a table."""
    drift_um: float = 0.0
    """How much the offset itself changes from move to move."""
    slope: float = 0.1
    """How much it changes over the way of a correction, as a share of that way, rms: the derivative
    of what the transmission map does not know. SDSS-V accepts gears up to 0.15."""

    @classmethod
    def of(cls, plane: FocalPlane) -> CorrectionNoise:
        """With the camera of this instrument."""
        return cls(camera_um=plane.instrument.metrology.noise_rms_um)
