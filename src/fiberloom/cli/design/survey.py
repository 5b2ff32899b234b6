"""`fiberloom design survey`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.design.throughput import ExposureOptions
from fiberloom.cli.options import naming, require_file, require_instrument
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from fiberloom.design.survey import HoursSettings, SurveyTime
    from fiberloom.design.survey.tiling import FieldTargets
    from fiberloom.instruments import FocalPlane
    from fiberloom.targets import TargetList
    from fiberloom.typing import Floats


@dataclass(frozen=True, kw_only=True)
class DesignSurveyOptions(ExposureOptions):
    """Of `fiberloom design survey`."""

    targets: Annotated[
        Path,
        typer.Option(help="The list, in mm or with ra and dec; one larger than a field is cut into fields."),
    ]
    visits: Annotated[int, typer.Option(min=1, help="That each target wants.")] = 1
    share: Annotated[
        float, typer.Option(help="Of the visits to targets in reach that are to be made, 0 to 1.")
    ] = 0.95
    overhead: Annotated[
        float, typer.Option(help="From one exposure to the next: readout, move, corrections, s.")
    ] = 60.0
    most: Annotated[int, typer.Option(min=1, help="Exposures of a field at most.")] = 12
    turns: Annotated[
        int, typer.Option(min=2, help="Orientations of the list on the array, for the errors.")
    ] = 3
    positioners: Annotated[
        int | None, typer.Option(min=1, help="Only so many, the inner ones; default: all.")
    ] = None
    fields: Annotated[
        int, typer.Option(min=1, help="Of many fields: so many of each orientation are planned, drawn.")
    ] = 12
    scale: Annotated[
        float | None, typer.Option(help="Of the focal plane, um per arcsec; for a list with ra and dec.")
    ] = None
    seed: Annotated[int, typer.Option(min=0, help="The one seed of everything random.")] = 0


def survey(options: DesignSurveyOptions) -> int:
    """Hours that a list of targets takes: exposures, chosen together, until enough is done.

    Of one field, or of as many as the list fills. Errors are of the mean over orientations of the list on the
    array. Exit code 1 where the share is not reached within the most exposures.
    """
    require_instrument(options.file)
    require_file(options.targets)
    if options.scale is not None and not options.scale > 0.0:
        raise InputError(f"--scale {options.scale:g}: must be above 0 um per arcsec")
    from fiberloom.design.survey import HoursSettings, larger_than, survey_time
    from fiberloom.instruments import generate, load_instrument

    settings = HoursSettings(
        visits=options.visits,
        share=options.share,
        exposure_s=options.exposure,
        overhead_s=options.overhead,
        most=options.most,
        turns=options.turns,
        seed=options.seed,
        fields=options.fields,
    )
    instrument = load_instrument(options.file)
    plane = generate(instrument, options.seed, n_positioners=options.positioners)
    wanted, radec_deg = _list(options)
    if radec_deg is not None or larger_than(plane, wanted):
        return _many(options, plane, wanted, radec_deg, settings)
    with waiting() as shown:
        shown.say("choosing exposures")
        found = survey_time(plane, wanted, settings, shown.count)
    _print(options, {"steps": _steps(found), "survey": _told(found, settings)})
    return int(found.exposures is None)


def _print(options: DesignSurveyOptions, report: dict[str, Any]) -> None:
    if options.as_json:
        options.print_json(report)
    else:
        for part in report.values():
            options.show(part)


def _list(options: DesignSurveyOptions) -> tuple[TargetList, Floats | None]:
    """The targets; of a list on the sky (n, 2) RA and Dec in deg beside them, and no places in mm."""
    import numpy as np

    from fiberloom.tables import read_table
    from fiberloom.targets import TargetList, read_targets
    from fiberloom.targets.columns import is_sky
    from fiberloom.targets.read import PAR_SUFFIXES, read_sky

    if options.targets.name.lower().endswith(PAR_SUFFIXES) or not is_sky(read_table(options.targets)):
        return read_targets(options.targets), None
    if options.scale is None:
        raise InputError(f"{options.targets}: has ra and dec; give the focal plane's --scale, um per arcsec")
    both = read_sky(options.targets)[0]
    sky = both.targets.select(~both.is_guide)
    nowhere = np.zeros(len(sky))
    wanted = TargetList(sky.target_id, nowhere, nowhere, sky.priority, sky.fibre, sky.positioner_id)
    return wanted, np.column_stack([sky.ra_deg, sky.dec_deg])


def _many(
    options: DesignSurveyOptions,
    plane: FocalPlane,
    wanted: TargetList,
    radec_deg: Floats | None,
    settings: HoursSettings,
) -> int:
    """Of a list of many fields."""
    from fiberloom.design.survey import tiled_survey
    from fiberloom.design.survey.tiling import fields_in_mm, fields_on_sky, hexagon_of

    hexagon = hexagon_of(plane)

    def tiling(angle_rad: float, phase: Floats) -> Iterable[FieldTargets]:
        if radec_deg is None:
            return fields_in_mm(wanted.xy_mm, hexagon, angle_rad, phase)
        return fields_on_sky(radec_deg, options.scale or 0.0, hexagon, angle_rad, phase)

    with waiting() as shown, naming(options.targets):
        shown.say("choosing exposures of many fields")
        found = tiled_survey(plane, wanted, tiling, settings, shown.count)
    told: dict[str, Any] = {
        "targets": len(wanted),
        "share": settings.share,
        "fields": round(found.fields, 2),
        "fields_error": round(found.fields_error, 2),
        "fields_planned": found.planned,
        "in_reach": round(found.reachable, 4),
    }
    if found.exposures is None or found.exposures_error is None:
        told |= {"hours": f"not within {settings.most} exposures of each field"}
    else:
        told |= {
            "fibres_used": round(found.used, 4),
            "exposures": round(found.exposures, 1),
            "exposures_error": round(found.exposures_error, 1),
            "hours": round(settings.hours(found.exposures), 2),
            "hours_error": round(settings.hours(found.exposures_error), 2),
        }
    _print(options, {"survey": told})
    return int(found.exposures is None)


def _steps(found: SurveyTime) -> list[dict[str, Any]]:
    return [{name: round(value, 4) for name, value in vars(one).items()} for one in found.steps]


def _told(found: SurveyTime, settings: HoursSettings) -> dict[str, Any]:
    told: dict[str, Any] = {"share": settings.share, "in_reach": round(found.reachable, 4)}
    if found.exposures is None or found.exposures_error is None:
        return told | {"hours": f"not within {settings.most} exposures"}
    return told | {
        "exposures": round(found.exposures, 2),
        "exposures_error": round(found.exposures_error, 2),
        "hours": round(settings.hours(found.exposures), 3),
        "hours_error": round(settings.hours(found.exposures_error), 3),
    }
