"""One image at a time: spots of a file, and which positioner each of them is."""

from __future__ import annotations

import datetime
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane, Instrument
from fiberloom.metrology.acquisition import Acquisition, CameraGeometry, acquire
from fiberloom.metrology.cameras import geometry_of, reduction_settings
from fiberloom.metrology.images import CameraImage, read_image, trouble
from fiberloom.metrology.matching import Match, MatchStatus, match_spots
from fiberloom.metrology.pipeline import metrology_reach_mm
from fiberloom.metrology.spots import (
    Flag,
    Found,
    Spots,
    SpotSettings,
    find_expected,
    find_spots,
    read_spots,
)
from fiberloom.metrology.transform import PlaceErrors
from fiberloom.typing import Floats
from fiberloom.units import MM_PER_UM, UM_PER_MM
from fiberloom.version import __version__
from fiberloom.wholefile import whole

POSITION_COLUMNS = (
    "positioner_id", "x_mm", "y_mm", "x_err_um", "y_err_um", "status", "x_px", "y_px", "flux_e", "flags",
)  # fmt: skip
FEWEST_FIDUCIALS = 4
_FITS = (".fits", ".fit", ".fts", ".fz", ".gz")


def spots_of_image(
    image: CameraImage, threshold: float = 6.0, expected: Path | None = None, radius_px: float = 8.0
) -> Found:
    """Spots of an `image` brighter than `threshold` sigmas of the noise.

    All of them, or those within `radius_px` of the places (x_px, y_px) of the table `expected`.
    """
    settings = SpotSettings(image.gain_e_adu, image.saturation_adu, threshold)
    if expected is None:
        return find_spots(image.pixels, settings, fits_bytes=image.fits_bytes)
    xy_px = read_spots(expected).xy_px
    return find_expected(image.pixels, xy_px, radius_px, settings, fits_bytes=image.fits_bytes)


def spots_report(image: CameraImage, found: Found) -> dict[str, Any]:
    """How many spots, how sharp, how well known; where there is none, why."""
    spots = found.spots.select(~found.spots.has(Flag.NOT_FOUND))
    height, width = image.shape
    report: dict[str, Any] = {
        "image_px": [width, height],
        "spots": len(spots),
        "background_adu": round(found.background_adu, 2),
        "noise_adu": round(found.noise_adu, 3),
        "gain_e_adu": image.gain_e_adu,
    }
    if not len(spots):
        report["note"] = trouble(image)
    if len(found.spots) > len(spots):
        report["not_found"] = len(found.spots) - len(spots)
    if len(spots):
        middle = np.array([[0.5 * width, 0.5 * height]])
        report |= {
            "fwhm_px": round(float(found.profile.fwhm_px(middle)[0]), 2),
            "median_error_px": round(float(np.median(np.hypot(spots.x_err_px, spots.y_err_px))), 5),
            "flagged": {
                f.name.lower(): int(spots.has(f).sum()) for f in Flag if f.name and spots.has(f).any()
            },
        }
    return report


def image_marks(image: CameraImage) -> dict[str, object]:
    """Version, image, UTC time and gain (electrons per count), for the head of a file of spots."""
    return {
        "version": __version__,
        "image": image.path,
        "utc": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "gain_e_adu": image.gain_e_adu,
    }


@dataclass(frozen=True)
class MatchedImage:
    """Which spot is which fiducial or positioner."""

    plane: FocalPlane
    acquisition: Acquisition
    match: Match
    spots: Spots
    """All that are not fiducials; `match` counts in these."""


def read_source(source: Path) -> tuple[Spots, int, int]:
    """Spots of a table or of an image, and the width and height of the image in px.

    Raises InputError where there is no such file, or no spot in the table.
    """
    if not source.is_file():
        raise InputError(f"{source}: no such file")
    if source.suffix.lower() in _FITS and not source.name.endswith(".csv.gz"):
        image = read_image(source)
        settings = SpotSettings(image.gain_e_adu, image.saturation_adu)
        found = find_spots(image.pixels, settings, fits_bytes=image.fits_bytes)
        return found.spots, image.shape[1], image.shape[0]
    spots = read_spots(source)
    spots = spots.select(np.isfinite(spots.xy_px).all(axis=1) & ~spots.has(Flag.NOT_FOUND))
    if not len(spots):
        raise InputError(f"{source}: no spots")
    return spots, int(spots.x_px.max()) + 1, int(spots.y_px.max()) + 1


def camera_geometry(
    instrument: Instrument, size_px: tuple[int, int], scale_mm_px: float | None = None
) -> CameraGeometry:
    """Of the instrument's camera, or of one with another scale and (width, height)."""
    camera = instrument.camera
    if scale_mm_px is None:
        return geometry_of(instrument)
    if not scale_mm_px > 0:
        raise InputError(f"--scale {scale_mm_px}: must be above 0 mm per pixel")
    base = CameraGeometry(*size_px, scale_mm_px)
    return base if camera is None else replace(base, flipped=camera.flipped, rotation_deg=camera.rotation_deg)


def require_fiducials(plane: FocalPlane) -> None:
    """Raises InputError unless there are enough to find the camera's place by."""
    if (n := len(plane.fiducials)) < FEWEST_FIDUCIALS:
        raise InputError(f"this focal plane has {n} fiducials; at least {FEWEST_FIDUCIALS} are needed")


def identify(plane: FocalPlane, spots: Spots, geometry: CameraGeometry, expected_mm: Floats) -> MatchedImage:
    """Which of the `spots` are fiducials, and which are positioners of the `plane`.

    `geometry`: what is known of the camera; `expected_mm` (N, 2): where the metrology fibres should be,
    NaN where that is not known.

    Raises InputError with fewer than four fiducials, AcquisitionError where they are not found.
    """
    require_fiducials(plane)
    known = reduction_settings(plane.instrument.camera, geometry)
    found = acquire(
        spots.xy_px,
        plane.fiducials[:, :2],
        geometry,
        expected_mm=expected_mm,
        errors=PlaceErrors(spots.covariance_px2, known.fiducial_sigma_um * MM_PER_UM),
        settings=known.search,
    )
    others = spots.select(np.setdiff1d(np.arange(len(spots)), found.spot))
    matched = match_spots(
        found.transform.to_mm(others.xy_px), expected_mm, plane.centres_mm, metrology_reach_mm(plane)
    )
    return MatchedImage(plane, found, matched, others)


def write_positions(path: Path, identified: MatchedImage) -> None:
    """One row for each positioner: position in mm and its error in um, status, spot."""
    plane, found, matched, spots = (
        identified.plane, identified.acquisition, identified.match, identified.spots
    )  # fmt: skip
    xy = found.transform.to_mm(spots.xy_px)
    error_um = UM_PER_MM * np.sqrt(
        np.diagonal(found.transform.covariance(spots.xy_px, spots.covariance_px2), axis1=1, axis2=2)
    )
    with whole(path) as part, part.open("w", encoding="utf-8") as out:
        out.write(f"# version: {__version__}\n# instrument: {plane.instrument.name}\n")
        out.write(f"# config_hash: {plane.config_hash()}\n")
        out.write(",".join(POSITION_COLUMNS) + "\n")
        for row, k in enumerate(matched.spot):
            status = MatchStatus(matched.status[row]).name.lower()
            head = f"{plane.positioner_id[row]},"
            if k < 0:
                out.write(f"{head},,,,{status},,,,\n")
                continue
            numbers = "{:.6f},{:.6f},{:.3f},{:.3f}".format(*xy[k], *error_um[k])
            pixel = f"{spots.x_px[k]:.5f},{spots.y_px[k]:.5f},{spots.flux_e[k]:.1f},{spots.flags[k]}"
            out.write(f"{head}{numbers},{status},{pixel}\n")


def match_report(identified: MatchedImage) -> dict[str, Any]:
    """How many of each, and how well the fiducials fit (um)."""
    plane, found, matched = identified.plane, identified.acquisition, identified.match
    base = found.transform.similarity
    return {
        "positioners": len(plane),
        "matched": int(matched.matched.sum()),
        "dark": _named(plane, matched, MatchStatus.DARK),
        "ambiguous": _named(plane, matched, MatchStatus.AMBIGUOUS),
        "stray_spots": len(matched.stray),
        "fiducials_found": f"{len(found.fiducial)} of {len(plane.fiducials)}",
        "fiducial_rms_um": round(found.fit.rms_um, 3),
        "left_out_rms_um": round(found.fit.leave_one_out_rms_um, 3),
        "scale_mm_px": round(base.scale_mm_px, 6),
        "rotation_deg": round(base.rotation_deg, 4),
        "terms": len(found.transform.terms),
    }


def _named(plane: FocalPlane, matched: Match, status: MatchStatus) -> list[int]:
    return [int(p) for p in plane.positioner_id[matched.status == status]]
