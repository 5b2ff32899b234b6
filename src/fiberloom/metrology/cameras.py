"""What is known of the cameras of instruments before they have seen anything."""

from __future__ import annotations

from fiberloom.errors import InputError
from fiberloom.metrology.acquisition import CameraGeometry

GEOMETRIES = {
    # header of an SDSS-V frame of MJD 60039: NAXIS 6000 x 6132, FVC_SCL 0.12149; handedness assumed
    "sdssv": CameraGeometry(6000, 6132, 0.12149, flipped=True),
    # desimeter's stored transforms: 0.140 mm/px in the middle, 0.158 at the edge
    "desi": CameraGeometry(6000, 6000, 0.148, rotation_deg=180.0, flipped=True),
    # PFS metrology camera: 8960 x 5778 px over a field of 448 mm (scale derived)
    "pfs": CameraGeometry(8960, 5778, 0.0846),
    # Kronig 2020, Fig. 18: the bench with the whole workspace in view, and close up (assumed)
    "workspace": CameraGeometry(2048, 2048, 0.0225),
    "close-up": CameraGeometry(1024, 1024, 0.008),
}


def nominal_geometry(name: str) -> CameraGeometry:
    """Of an instrument, or of a bench."""
    try:
        return GEOMETRIES[name]
    except KeyError:
        raise InputError(
            f"camera of '{name}': not known; known are {', '.join(GEOMETRIES)}, "
            "or give its scale in mm per pixel"
        ) from None
