"""`fiberloom calibrate fibres`: where the science fibres are on their arms, by dithered stars."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.array.options import ArmsFileOptions, ExcludeOptions
from fiberloom.cli.observe import TWIN, FaultsOption, MapsOption, check, field_of
from fiberloom.cli.options import (
    JsonOptions,
    PlaneOptions,
    RequireOptions,
    TimingsOptions,
    require_file,
    require_folder,
)
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError
from fiberloom.wholefile import write_whole

if TYPE_CHECKING:
    from fiberloom.calibration.fibres.offsets import FibreOffsets
    from fiberloom.instruments import FocalPlane
    from fiberloom.operation.results import Observation
    from fiberloom.targets import TargetList


@dataclass(frozen=True, kw_only=True)
class FibreOptions(
    ExcludeOptions, ArmsFileOptions, RequireOptions, PlaneOptions, TimingsOptions, JsonOptions
):
    """Of `calibrate fibres`."""

    exposures: Annotated[
        list[Path] | None, typer.Option(help="Recorded exposures of a field; once for each. Nothing moves.")
    ] = None
    fields: Annotated[
        int, typer.Option(min=1, max=20, help="Fields of stars on the twin, of each fibre.")
    ] = 3
    dithers: Annotated[int, typer.Option(min=4, max=13, help="Exposures of each field.")] = 13
    step_um: Annotated[
        float, typer.Option(min=10.0, max=200.0, help="Distance of neighbouring dithers, um.")
    ] = 45.0
    core_um: Annotated[
        float, typer.Option(min=10.0, max=1000.0, help="Diameter of the fibres' cores, um, to 1 %.")
    ] = 120.0
    fibre: Annotated[str | None, typer.Option(help="Only this science fibre; default: all.")] = None
    moves: Annotated[int, typer.Option(min=1, help="Moves of each field of the twin.")] = 3
    camera: Annotated[str | None, typer.Option(help="image or noise of the twin (default: noise).")] = None
    faults: FaultsOption = ""
    errors: Annotated[
        str, typer.Option(help="What is off its tables in the twin: all, none, or some, with factors.")
    ] = "all"
    calibration: MapsOption = None
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/fibres")


def fibres(options: FibreOptions) -> int:
    """Find where the science fibres are on their arms, by stars that are moved across them.

    With the offsets comes by how much the camera's frame is off. Exit code 1 where fewer of the fibres with a
    star than `--require` says get an offset.
    """
    for path in options.exposures or []:
        require_file(path)
    if options.bus is not None and not options.bus.startswith(TWIN) and not options.exposures:
        raise InputError(
            "--bus: an array has no sky here; record the exposures and name them: --exposures FILE"
        )
    check(options)
    options.met(0, 0)  # a share that is none is told before anything moves
    require_folder(options.out)
    plane = options.plane()
    if options.fibre is not None and options.fibre not in plane.science_fibres:
        raise InputError(f"--fibre {options.fibre}: known are {', '.join(plane.science_fibres)}")
    found, rows, about = _recorded(options, plane) if options.exposures else _on_twin(options, plane)
    return _keep(options, plane, found, {"fields": rows} | about)


Result = tuple["FibreOffsets", list[dict[str, Any]], dict[str, Any]]


def _settings(options: FibreOptions) -> Any:
    from fiberloom.calibration.fibres.model import FieldSettings

    return FieldSettings(core_um=options.core_um)


def _recorded(options: FibreOptions, plane: FocalPlane) -> Result:
    """Of files of exposures."""
    from fiberloom.calibration.fibres.combine import combine
    from fiberloom.calibration.fibres.estimate import estimate
    from fiberloom.calibration.fibres.exposures_file import read_all
    from fiberloom.calibration.fibres.frame import radius_of
    from fiberloom.calibration.fibres.offsets import FibreOffsets
    from fiberloom.calibration.fibres.rows import combined_row, field_row

    found = [estimate(one, _settings(options)) for one in read_all(options.exposures or [])]
    together = combine(found, radius_mm=radius_of(plane))
    offsets = FibreOffsets.of(together, plane)
    rows = [field_row(one.name, one) for one in found] + [combined_row("combined", offsets)]
    return offsets, rows, {"place_um": together.place_um}


def _on_twin(options: FibreOptions, plane: FocalPlane) -> Result:
    """Of fields that the twin observes."""
    from fiberloom.calibration.fibres.exposures_file import write_exposures
    from fiberloom.report.outputs import marks
    from fiberloom.studies.star_fields import StarFields, calibrate_on_stars

    field_ = field_of(options, camera="noise")
    field_.command_line = " ".join(sys.argv)
    names = [options.fibre] if options.fibre else list(plane.science_fibres)
    known = options.out / "fibres.ecsv"

    def observe(stars: TargetList, offsets: FibreOffsets | None, name: str) -> Observation:
        field_.watcher.say(f"{name}: {len(stars.target_id)} stars")
        if offsets is not None:
            offsets.write(known, marks(plane, options.seed))
        return field_.run.observe(
            stars,
            options.moves - 1,
            out=options.out,
            arms=options.arms,
            fibres=None if offsets is None else known,
        )

    asked = StarFields(options.fields, options.dithers, options.step_um, options.seed, _settings(options))
    with waiting(options.as_json, options.timings) as field_.watcher:
        made = calibrate_on_stars(plane, names, observe, asked)
    stamp = marks(plane, options.seed)
    for number, one in enumerate(made.recorded, 1):
        write_exposures(options.out / f"exposures-{number}.ecsv", one, stamp)
    return made.offsets, made.rows, {"put_in": asked.conditions.put_in() | field_.source.about()["put_in"]}


def _keep(options: FibreOptions, plane: FocalPlane, found: FibreOffsets, about: dict[str, Any]) -> int:
    from fiberloom.report.outputs import marks
    from fiberloom.store.calibrations import record_calibration

    stamp = marks(plane, options.seed)
    file = options.out / "fibres.ecsv"
    found.write(file, stamp)
    refused = found.reason[~found.ok].tolist()
    summary = stamp | {
        "fibres": len(found),
        "calibrated": int(found.ok.sum()),
        "camera_frame_um": None if found.frame is None else found.frame.rms_um,
        "refused": {reason: refused.count(reason) for reason in sorted(set(refused))},
        "offsets": str(file),
        **about,
    }
    write_whole(options.out / "fibres.json", json.dumps(summary, indent=2) + "\n")
    record_calibration(file, "fibres", sorted(set(found.positioner_id[found.ok])), stamp, " ".join(sys.argv))
    if options.as_json:
        options.print_json(summary)
    else:
        options.show(summary["fields"])
        typer.echo(f"{summary['calibrated']} of {summary['fibres']} fibres calibrated: {file}")
        if found.frame is not None:
            typer.echo(f"camera frame: off by {found.frame.rms_um:.1f} um rms (shift, rotation, scale apart)")
        for reason, n in summary["refused"].items():
            typer.echo(f"refused {n}: {reason}")
    return 0 if options.met(summary["calibrated"], summary["fibres"]) else 1
