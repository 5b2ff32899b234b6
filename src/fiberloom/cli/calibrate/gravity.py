"""`fiberloom calibrate gravity`: by how much the arms turn when the focal plane is tilted and turned."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.array.options import ArmsFileOptions, ExcludeOptions
from fiberloom.cli.calibrate.focal_plane import SurveyCameraOption
from fiberloom.cli.observe import FaultsOption, MapsOption, check, field_of
from fiberloom.cli.options import (
    ErrorsOptions,
    JsonOptions,
    PlaneOptions,
    RequireOptions,
    TimingsOptions,
    require_file,
    require_folder,
)
from fiberloom.cli.terminal import waiting
from fiberloom.wholefile import write_whole

if TYPE_CHECKING:
    from fiberloom.calibration.gravity.images import TiltImages
    from fiberloom.calibration.gravity.sag import ArmSag
    from fiberloom.instruments import FocalPlane


@dataclass(frozen=True, kw_only=True)
class GravityOptions(
    ExcludeOptions, ArmsFileOptions, RequireOptions, ErrorsOptions, PlaneOptions, TimingsOptions, JsonOptions
):
    """Of `calibrate gravity`."""

    images: Annotated[
        Path | None, typer.Option(help="Recorded images of a still, tilted array. Nothing moves.")
    ] = None
    configurations: Annotated[
        int, typer.Option(min=1, max=100, help="Configurations in which the array of the twin rests.")
    ] = 6
    rotators: Annotated[int, typer.Option(min=2, max=36, help="Rotator angles of each, over a turn.")] = 6
    zenith: Annotated[
        float, typer.Option(min=0.0, max=90.0, help="Zenith distance of the twin's images, deg.")
    ] = 60.0
    camera: SurveyCameraOption = None
    faults: FaultsOption = ""
    calibration: MapsOption = None
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/gravity")


def gravity(options: GravityOptions) -> int:
    """Find by how much each arm turns under gravity, by images of a still array at several rotator angles.

    Exit code 1 where fewer of the positioners than `--require` says get numbers.
    """
    require_file(options.images)
    check(options)
    options.met(0, 0)  # a share that is none is told before anything moves
    require_folder(options.out)
    plane = _plane(options)
    seen, about = _recorded(options) if options.images else _on_twin(options, plane)
    from fiberloom.calibration.gravity.estimate import estimate

    return _keep(options, plane, estimate(plane, seen), about | {"images": len(seen.pointing)})


def _plane(options: GravityOptions) -> FocalPlane:
    plane = options.plane()
    if options.arms is None:
        return plane
    from fiberloom.calibration.focal_plane.arms_file import load_arms

    return load_arms(options.arms, plane)


def _recorded(options: GravityOptions) -> tuple[TiltImages, dict[str, Any]]:
    from fiberloom.calibration.gravity.images import read_tilts

    assert options.images is not None
    return read_tilts(options.images), {}


def _on_twin(options: GravityOptions, plane: FocalPlane) -> tuple[TiltImages, dict[str, Any]]:
    from fiberloom.blocking import finish
    from fiberloom.operation.sweep.tilts import TiltRun, TiltSettings, record_tilts
    from fiberloom.report.outputs import marks, prepare_folder

    field = field_of(options, camera="noise")
    settings = TiltSettings(options.configurations, options.rotators, options.zenith, options.seed)
    stamp = marks(options.plane(), options.seed)
    run = TiltRun(" ".join(sys.argv), prepare_folder(options.out), stamp)
    with waiting(options.as_json, options.timings) as watcher:
        field.watcher = watcher
        known = plane, field.run.calibrate()
        watcher.say("tilting and looking")
        seen = finish(record_tilts(known, field.source, settings, run, watcher.count))
    seen.write(options.out / "images.ecsv", stamp)
    return seen, field.source.about()


def _keep(options: GravityOptions, plane: FocalPlane, found: ArmSag, about: dict[str, Any]) -> int:
    from fiberloom.report.outputs import marks, prepare_folder
    from fiberloom.store.calibrations import record_calibration

    stamp = marks(options.plane(), options.seed)
    file = prepare_folder(options.out) / "gravity.ecsv"
    found.write(file, stamp)
    refused = found.reason[~found.ok].tolist()
    summary = stamp | {
        "positioners": len(found),
        "calibrated": int(found.ok.sum()),
        "at_1_g_um": found.size_um(plane),
        "formal_um": found.formal_um(plane),
        "refused": {reason: refused.count(reason) for reason in sorted(set(refused))},
        "sag": str(file),
        **about,
    }
    write_whole(options.out / "gravity.json", json.dumps(summary, indent=2) + "\n")
    record_calibration(file, "gravity", found.positioner_id[found.ok], stamp, " ".join(sys.argv))
    if options.as_json:
        options.print_json(summary)
    else:
        typer.echo(f"{summary['calibrated']} of {summary['positioners']} positioners calibrated: {file}")
        typer.echo(f"at 1 g: {summary['at_1_g_um']:.2f} um rms, known to {summary['formal_um']:.2f} um")
        for reason, n in summary["refused"].items():
            typer.echo(f"refused {n}: {reason}")
    return 0 if options.met(summary["calibrated"], summary["positioners"]) else 1
