"""What the host knows of a camera before it has seen anything, and how its images are reduced."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane, Instrument
from fiberloom.instruments.model import CameraTable
from fiberloom.metrology import zhao_burge
from fiberloom.metrology.acquisition import AcquisitionSettings, CameraGeometry
from fiberloom.metrology.pipeline import ImageCamera, ImageSource, ReductionSettings

BENCHES = {
    # Kronig 2020, Fig. 18: the bench with the whole workspace in view, and close up (assumed)
    "workspace": CameraGeometry(2048, 2048, 0.0225),
    "close-up": CameraGeometry(1024, 1024, 0.008),
}
ROTATOR_DEG, SHIFT_MM = 15.0, 20.0
"""How far a camera that no instrument describes may hang from where it should, in the loop."""
FIDUCIALS = 4
"""Fewer do not tell where the camera looks."""
ALL_IN_VIEW_PX = 4096
"""Width and height of a camera that no instrument describes."""


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
    if camera is None:
        return ReductionSettings(_loose(geometry, ROTATOR_DEG, SHIFT_MM))
    loose = _loose(geometry, camera.turn_tolerance_deg, camera.shift_tolerance_mm)
    return ReductionSettings(
        loose,
        terms=range(zhao_burge.N_TERMS) if camera.terms == "all" else None,
        radius_mm=camera.field_radius_mm,
        fiducial_sigma_um=camera.fiducial_sigma_um,
        turbulence=camera.turbulence,
        acquisition=AcquisitionSettings(coarse_mm=camera.distortion_reach_mm),
    )


def _loose(geometry: CameraGeometry, turn_deg: float, shift_mm: float) -> CameraGeometry:
    return replace(geometry, rotation_tolerance_deg=turn_deg, shift_tolerance_mm=shift_mm)


def view_of(plane: FocalPlane) -> tuple[CameraGeometry, float]:
    """Nominal camera of a focal plane, and the radius in mm of the field on which its distortion counts.

    Its instrument's, or one that just sees all of the plane.
    """
    if plane.instrument.camera is not None:
        return geometry_of(plane.instrument), plane.instrument.camera.field_radius_mm
    places = np.vstack([plane.centres_mm, plane.fiducials[:, :2]])
    radius_mm = float(np.hypot(*places.T).max()) + float(plane.body_reach_mm.max())
    return CameraGeometry(ALL_IN_VIEW_PX, ALL_IN_VIEW_PX, 2.1 * radius_mm / ALL_IN_VIEW_PX), radius_mm


def check_fiducials(plane: FocalPlane) -> None:
    """Refuses a focal plane whose images could not be read."""
    if len(plane.fiducials) < FIDUCIALS:
        raise InputError(
            f"{plane.instrument.name}: {len(plane.fiducials)} fiducials in the layout, images need at "
            f"least {FIDUCIALS} to be read; add some, or take --camera noise"
        )


def image_camera_of(
    source: ImageSource, plane: FocalPlane, geometry: CameraGeometry | None = None, radius_mm: float = 0.0
) -> ImageCamera:
    """What measures the positioners of `plane` in the images of `source`, whatever that is.

    `geometry` of the nominal camera, and `radius_mm` of its field; the instrument's when left out.
    """
    check_fiducials(plane)
    nominal, field_mm = view_of(plane)
    settings = reduction_settings(plane.instrument.camera, geometry or nominal)
    return ImageCamera(source, plane, replace(settings, radius_mm=radius_mm or field_mm))
