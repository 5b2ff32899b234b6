"""`fiberloom centroid` and `fiberloom match`: metrology alone, as plain functions."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments import METROLOGY, FocalPlane
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
    write_spots,
)
from fiberloom.units import MM_PER_UM, UM_PER_MM
from fiberloom.version import __version__

POSITION_COLUMNS = (
    "positioner_id", "x_mm", "y_mm", "x_err_um", "y_err_um", "status", "x_px", "y_px", "flux_e", "flags",
)  # fmt: skip
_FITS = (".fits", ".fit", ".fts", ".fz", ".gz")


@dataclass(frozen=True)
class CentroidRequest:
    """What `fiberloom centroid` was asked for."""

    image: Path
    out: Path = Path("spots.csv")
    gain_e_adu: float | None = None
    saturation_adu: float | None = None
    threshold: float = 6.0
    extension: str | None = None
    expected: Path | None = None
    """Table with x_px, y_px: look only there."""
    radius_px: float = 8.0
    plot: Path | None = None


def centroid(request: CentroidRequest) -> dict[str, Any]:
    """Find and measure the spots of an image, write them as CSV; returns a report."""
    image = read_image(
        request.image,
        extension=_extension(request.extension),
        gain_e_adu=request.gain_e_adu,
        saturation_adu=request.saturation_adu,
    )
    found = _find(image, request)
    _writable(request.out)
    write_spots(found.spots, request.out, _marks(image))
    if request.plot is not None:
        from fiberloom.report.exposure import plot_spots  # matplotlib takes a second

        _writable(request.plot)
        lit = found.spots.select(~found.spots.has(Flag.NOT_FOUND))
        plot_spots(request.plot, image, lit)
    return _report(image, found) | {"spots_file": str(request.out)}


def _extension(text: str | None) -> int | str | None:
    return int(text) if text is not None and text.lstrip("-").isdigit() else text


def _find(image: CameraImage, request: CentroidRequest) -> Found:
    settings = SpotSettings(image.gain_e_adu, image.saturation_adu, request.threshold)
    if request.expected is None:
        return find_spots(image.pixels, settings, fits_bytes=image.fits_bytes)
    expected = read_spots(request.expected).xy_px
    return find_expected(image.pixels, expected, request.radius_px, settings, fits_bytes=image.fits_bytes)


def _report(image: CameraImage, found: Found) -> dict[str, Any]:
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


def _marks(image: CameraImage) -> dict[str, object]:
    return {
        "version": __version__,
        "image": image.path,
        "utc": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "gain_e_adu": image.gain_e_adu,
    }


def _writable(path: Path) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a"):
            pass
    except OSError as error:
        raise InputError(
            f"--out {path}: cannot write there ({error.strerror or error}); choose another place"
        ) from None


@dataclass(frozen=True)
class MatchRequest:
    """What `fiberloom match` was asked for."""

    source: Path
    """Spots of `fiberloom centroid`, or an image."""
    out: Path = Path("positions.csv")
    expected: Path | None = None
    """Configuration (positioner_id, alpha_deg, beta_deg) that the positioners should have."""
    scale_mm_px: float | None = None
    rotation_deg: float | None = None
    rotation_tolerance_deg: float = 15.0
    flipped: bool | None = None
    fiducial_sigma_um: float = 0.0
    terms: Sequence[int] | None = None


def match(plane: FocalPlane, request: MatchRequest) -> dict[str, Any]:
    """Spots to positioners to focal-plane mm; writes one row per positioner; returns a report."""
    spots, width, height = _spots_of(request.source)
    if len(plane.fiducials) < 4:
        raise InputError(f"this focal plane has {len(plane.fiducials)} fiducials; at least 4 are needed")
    expected = _expected_mm(plane, request.expected)
    geometry = _geometry(plane, request, width, height)
    known = reduction_settings(plane.instrument.camera, geometry)
    found = acquire(
        spots.xy_px,
        plane.fiducials[:, :2],
        geometry,
        expected_mm=expected,
        covariance_px2=spots.covariance_px2,
        sigma_mm=request.fiducial_sigma_um * MM_PER_UM,
        terms=request.terms,
        radius_mm=known.radius_mm,
        settings=known.acquisition,
    )
    free = np.setdiff1d(np.arange(len(spots)), found.spot)
    others = spots.select(free)
    matched = match_spots(
        found.transform.to_mm(others.xy_px), expected, plane.centres_mm, metrology_reach_mm(plane)
    )
    _writable(request.out)
    _write_positions(request.out, plane, found, matched, others)
    return _match_report(plane, found, matched) | {"positions_file": str(request.out)}


def _spots_of(source: Path) -> tuple[Spots, int, int]:
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


def _expected_mm(plane: FocalPlane, path: Path | None) -> np.ndarray:
    if path is None:
        return np.full((len(plane), 2), np.nan)
    from fiberloom.planning import read_configuration

    alpha_deg, beta_deg = read_configuration(path, plane).T
    return plane.forward(alpha_deg, beta_deg, METROLOGY)


def _geometry(plane: FocalPlane, request: MatchRequest, width: int, height: int) -> CameraGeometry:
    camera = plane.instrument.camera
    if request.scale_mm_px is None:
        base = geometry_of(plane.instrument)
    elif not request.scale_mm_px > 0:
        raise InputError(f"--scale {request.scale_mm_px}: must be above 0 mm per pixel")
    else:
        base = CameraGeometry(width, height, request.scale_mm_px)
        if camera is not None:
            base = replace(base, flipped=camera.flipped, rotation_deg=camera.rotation_deg)
    return replace(
        base,
        rotation_deg=base.rotation_deg if request.rotation_deg is None else request.rotation_deg,
        flipped=base.flipped if request.flipped is None else request.flipped,
        rotation_tolerance_deg=request.rotation_tolerance_deg,
    )


def _write_positions(path: Path, plane: FocalPlane, found: Acquisition, matched: Match, spots: Spots) -> None:
    xy = found.transform.to_mm(spots.xy_px)
    error_um = UM_PER_MM * np.sqrt(
        np.diagonal(found.transform.covariance(spots.xy_px, spots.covariance_px2), axis1=1, axis2=2)
    )
    with path.open("w", encoding="utf-8") as out:
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


def _match_report(plane: FocalPlane, found: Acquisition, matched: Match) -> dict[str, Any]:
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
