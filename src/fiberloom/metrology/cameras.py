"""What the host knows of a camera before it has seen anything, and how its images are reduced."""

from __future__ import annotations

from dataclasses import replace

from fiberloom.errors import InputError
from fiberloom.instruments import Instrument
from fiberloom.instruments.model import CameraTable
from fiberloom.metrology.acquisition import AcquisitionSettings, CameraGeometry
from fiberloom.metrology.pipeline import ReductionSettings

BENCHES = {
    # Kronig 2020, Fig. 18: the bench with the whole workspace in view, and close up (assumed)
    "workspace": CameraGeometry(2048, 2048, 0.0225),
    "close-up": CameraGeometry(1024, 1024, 0.008),
}
ROTATOR_DEG, SHIFT_MM = 15.0, 20.0
"""How far a camera may hang from where it should, in the loop."""


def camera_of(instrument: Instrument) -> CameraTable:
    """The camera of an instrument that has one for images."""
    if instrument.camera is None:
        raise InputError(
            f"{instrument.name} has no [camera]: add the table to its TOML, or give the scale in mm per pixel"
        )
    return instrument.camera


def geometry_of(instrument: Instrument) -> CameraGeometry:
    """The nominal camera of an instrument."""
    camera = camera_of(instrument)
    return CameraGeometry(
        camera.width_px, camera.height_px, camera.scale_mm_px, camera.rotation_deg, camera.flipped
    )


def reduction_settings(camera: CameraTable | None, geometry: CameraGeometry) -> ReductionSettings:
    """How images of this camera become positions; the turn that is searched is that of a rotator."""
    loose = replace(geometry, rotation_tolerance_deg=ROTATOR_DEG, shift_tolerance_mm=SHIFT_MM)
    if camera is None:
        return ReductionSettings(loose)
    return ReductionSettings(
        loose,
        radius_mm=camera.field_radius_mm,
        fiducial_sigma_um=camera.fiducial_sigma_um,
        turbulence=camera.turbulence,
        acquisition=AcquisitionSettings(coarse_mm=camera.distortion_reach_mm),
    )
