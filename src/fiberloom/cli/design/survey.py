"""`fiberloom design survey`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.design.throughput import ExposureOptions
from fiberloom.cli.options import require_file, require_instrument
from fiberloom.cli.terminal import waiting

if TYPE_CHECKING:
    from fiberloom.design.survey import HoursSettings, SurveyTime


@dataclass(frozen=True, kw_only=True)
class DesignSurveyOptions(ExposureOptions):
    """Of `fiberloom design survey`."""

    targets: Annotated[Path, typer.Option(help="The list, in mm, of one field of the array.")]
    visits: Annotated[int, typer.Option(min=1, help="That each target wants.")] = 1
    share: Annotated[
        float, typer.Option(help="Of the visits to targets in reach that are to be made, 0 to 1.")
    ] = 0.95
    overhead: Annotated[
        float, typer.Option(help="From one exposure to the next: readout, move, corrections, s.")
    ] = 60.0
    most: Annotated[int, typer.Option(min=1, help="Exposures at most.")] = 12
    turns: Annotated[
        int, typer.Option(min=2, help="Orientations of the list on the array, for the errors.")
    ] = 3
    positioners: Annotated[
        int | None, typer.Option(min=1, help="Only so many, the inner ones; default: all.")
    ] = None
    seed: Annotated[int, typer.Option(min=0, help="The one seed of everything random.")] = 0


def survey(options: DesignSurveyOptions) -> int:
    """Hours that a list of targets takes: exposures of one field, chosen together, until enough is done.

    Errors are of the mean over orientations of the list on the array. Exit code 1 where the share is not
    reached within the most exposures.
    """
    require_instrument(options.file)
    require_file(options.targets)
    from fiberloom.design.survey import HoursSettings, survey_time
    from fiberloom.instruments import generate, load_instrument
    from fiberloom.targets import read_targets

    settings = HoursSettings(
        visits=options.visits,
        share=options.share,
        exposure_s=options.exposure,
        overhead_s=options.overhead,
        most=options.most,
        turns=options.turns,
        seed=options.seed,
    )
    instrument = load_instrument(options.file)
    plane = generate(instrument, options.seed, n_positioners=options.positioners)
    targets = read_targets(options.targets)
    with waiting() as shown:
        shown.say("choosing exposures")
        found = survey_time(plane, targets, settings, shown.count)
    report = {"steps": _steps(found), "survey": _told(found, settings)}
    if options.as_json:
        options.print_json(report)
    else:
        for part in report.values():
            options.show(part)
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
