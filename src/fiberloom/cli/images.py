"""`fiberloom centroid` and `fiberloom match`: metrology alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fiberloom.cli.options import JsonOptions, PlaneOptions, RequireOptions, require_file
from fiberloom.report.folder import prepare_file

if TYPE_CHECKING:
    from fiberloom.instruments import FocalPlane
    from fiberloom.metrology.acquisition import CameraGeometry
    from fiberloom.typing import Floats


@dataclass(frozen=True, kw_only=True)
class CentroidOptions(JsonOptions):
    """Of `fiberloom centroid`."""

    image: Annotated[Path, typer.Argument(help="FITS image of back-lit fibres.")]
    out: Annotated[Path, typer.Option(help="Spots to write.")] = Path("spots.csv")
    gain_e_adu: Annotated[
        float | None, typer.Option("--gain", help="Electrons per count; default: the header's.")
    ] = None
    saturation_adu: Annotated[
        float | None, typer.Option("--saturation", help="Counts; default: the header's.")
    ] = None
    threshold: Annotated[float, typer.Option(help="Faintest spot, in sigmas of the noise.")] = 6.0
    extension: Annotated[str | None, typer.Option(help="HDU, by number or name.")] = None
    expected: Annotated[Path | None, typer.Option(help="Search only there: CSV with x_px, y_px.")] = None
    plot: Annotated[Path | None, typer.Option(help="Picture of the image with its spots.")] = None

    @property
    def hdu(self) -> int | str | None:
        """Number or name of the extension."""
        text = self.extension
        return int(text) if text is not None and text.lstrip("-").isdecimal() else text


def centroid(options: CentroidOptions) -> int:
    """Find and measure the spots of a camera image.

    Exit code 1 where the image has no spot.
    """
    require_file(options.image)
    require_file(options.expected)
    from fiberloom.metrology import one_image
    from fiberloom.metrology.images import read_image
    from fiberloom.metrology.spots import Flag, write_spots

    image = read_image(
        options.image,
        extension=options.hdu,
        gain_e_adu=options.gain_e_adu,
        saturation_adu=options.saturation_adu,
    )
    found = one_image.spots_of_image(image, options.threshold, options.expected)
    write_spots(found.spots, prepare_file(options.out), one_image.image_marks(image))
    if options.plot is not None:
        from fiberloom.report.exposure import plot_spots

        plot_spots(prepare_file(options.plot), image, found.spots.select(~found.spots.has(Flag.NOT_FOUND)))
    report = one_image.spots_report(image, found) | {"spots_file": str(options.out)}
    options.show(report)
    return 0 if report["spots"] else 1


@dataclass(frozen=True, kw_only=True)
class MatchOptions(RequireOptions, PlaneOptions, JsonOptions):
    """Of `fiberloom match`."""

    source: Annotated[Path, typer.Argument(help="Spots of `centroid`, or an image.")]
    expected: Annotated[
        Path | None, typer.Option(help="Configuration CSV that the positioners should have.")
    ] = None
    out: Annotated[Path, typer.Option(help="Positions to write.")] = Path("positions.csv")
    scale_mm_px: Annotated[
        float | None, typer.Option("--scale", help="mm per pixel; default: the instrument's camera.")
    ] = None
    rotation_deg: Annotated[
        float | None,
        typer.Option("--rotation", help="Direction of the pixel x axis in the focal plane, deg."),
    ] = None
    rotation_tolerance_deg: Annotated[
        float, typer.Option("--rotation-tolerance", min=0, help="Largest error of --rotation, deg.")
    ] = 15.0
    flipped: Annotated[
        bool | None, typer.Option("--flipped/--not-flipped", help="Is the image a mirror image?")
    ] = None


def match(options: MatchOptions) -> int:
    """Find the positioner of each spot, and its position in the focal plane.

    Exit code 1 where fewer positioners than `--require` says are matched.
    """
    required = options.required_share
    require_file(options.source)
    require_file(options.expected)
    options.check_plane()
    from fiberloom.metrology import one_image

    plane = options.plane()
    spots, *size_px = one_image.read_source(options.source)
    one_image.require_fiducials(plane)
    expected_mm = _expected_mm(plane, options.expected)
    geometry = one_image.camera_geometry(plane.instrument, (size_px[0], size_px[1]), options.scale_mm_px)
    identified = one_image.identify(plane, spots, _turned(geometry, options), expected_mm)
    one_image.write_positions(prepare_file(options.out), identified)
    report = one_image.match_report(identified)
    wanted = int((~plane.offline).sum())
    report["required"] = f"{100.0 * required:g} % of {wanted}"
    options.show(report | {"positions_file": str(options.out)})
    return 0 if options.met(report["matched"], wanted) else 1


def _turned(geometry: CameraGeometry, options: MatchOptions) -> CameraGeometry:
    """The geometry with the direction that the options give."""
    rotation_deg, flipped = options.rotation_deg, options.flipped
    return replace(
        geometry,
        rotation_deg=geometry.rotation_deg if rotation_deg is None else rotation_deg,
        flipped=geometry.flipped if flipped is None else flipped,
        rotation_tolerance_deg=options.rotation_tolerance_deg,
    )


def _expected_mm(plane: FocalPlane, path: Path | None) -> Floats:
    import numpy as np

    from fiberloom.instruments import METROLOGY
    from fiberloom.planning import read_configuration

    if path is None:
        return np.full((len(plane), 2), np.nan)
    alpha_deg, beta_deg = read_configuration(path, plane).T
    return plane.forward(alpha_deg, beta_deg, METROLOGY)
