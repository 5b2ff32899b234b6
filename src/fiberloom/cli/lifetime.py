"""`fiberloom lifetime`: wear, calibrations that age, and maps that learn. Kronig 2020, Section 4.3."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.options import JsonOptions, require_folder, require_instrument
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError

if TYPE_CHECKING:
    from fiberloom.studies.campaign import Campaign
    from fiberloom.studies.workers import Rows


@dataclass(frozen=True, kw_only=True)
class LifetimeOptions(JsonOptions):
    """Of `fiberloom lifetime`."""

    cycles: Annotated[int, typer.Option(min=1, help="Cycles of 15260 moves each, as in the paper.")] = 100
    positioners: Annotated[int, typer.Option(min=1, help="How many, each on a bench of its own.")] = 2
    instrument: Annotated[str, typer.Option(help="Preset name, or a TOML file of your own.")] = "sdssv"
    points: Annotated[int, typer.Option(min=8, help="Points of a calibration, per axis and direction.")] = 200
    targets: Annotated[int, typer.Option(min=1, help="Random targets a cycle; each one takes ten moves.")] = (
        1220
    )
    every: Annotated[int, typer.Option(min=1, help="Simulate one in this many cycles.")] = 1
    gears: Annotated[
        str, typer.Option(help="Orders that the gears' deviations have: stages, teeth or family.")
    ] = "stages"
    faults: Annotated[
        str,
        typer.Option(help="Ailments of the first positioners, half-way, e.g. broken_tooth=1,loose_arm=1."),
    ] = ""
    workers: Annotated[int, typer.Option(min=1, help="Processes of this machine.")] = 1
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask scheduler, e.g. tcp://host:8786, instead.")
    ] = None
    seed: Annotated[int, typer.Option(min=0, help="The one seed of everything random.")] = 0
    out: Annotated[Path, typer.Option(help="Folder for the results; an interrupted run continues in it.")] = (
        Path("runs/lifetime")
    )


def lifetime(options: LifetimeOptions) -> int:
    """Wear positioners out, and compare calibrations of their gears (Kronig 2020, Fig. 21 to 26).

    Exit code 1 where learning or maps gain less than is required.
    """
    _check(options)
    from fiberloom.instruments import load_instrument
    from fiberloom.studies import campaign
    from fiberloom.studies.lifetime import LifetimeSettings
    from fiberloom.studies.lifetime_results import lifetime_campaign, within_requirement, write_results
    from fiberloom.twin.errors.switches import gear_spectrum

    load_instrument(options.instrument)  # a broken file is refused before anything is started
    settings = LifetimeSettings(
        instrument=options.instrument,
        cycles=options.cycles,
        points=options.points,
        approaches=options.targets,
        cycle_step=options.every,
        gears=gear_spectrum(options.gears),
        faults=options.faults,
    )
    study = lifetime_campaign(options.positioners, options.seed, settings)
    result = write_results(options.out, study, _run(options, study))
    campaign.forget(study, options.out)
    _print(options, result)
    return 0 if within_requirement(result["summary"]) else 1


def _check(options: LifetimeOptions) -> None:
    from fiberloom.twin.faults.grammar import parse_faults
    from fiberloom.twin.faults.kinds import AGED

    for request in parse_faults(options.faults, AGED):
        if not 1 <= (request.positioner_id or 1) <= options.positioners:
            raise InputError(
                f"--faults {request}: no such positioner; they are 1 to {options.positioners} here"
            )
    require_instrument(options.instrument)
    require_folder(options.out)


def _run(options: LifetimeOptions, study: Campaign) -> Rows:
    from fiberloom.studies import campaign

    with waiting(options.as_json) as wait:
        wait.say(f"{options.cycles} cycles of {options.positioners} positioners")
        try:
            return campaign.run(
                study,
                options.out,
                workers=options.workers,
                scheduler=options.scheduler,
                progress=wait.count,
            )
        except KeyboardInterrupt:
            print(
                f"what is finished is kept in {options.out}/chunks: the same command continues",
                file=sys.stderr,
            )
            raise


def _print(options: LifetimeOptions, result: dict[str, Any]) -> None:
    from fiberloom.studies.lifetime_results import blind_errors

    if options.as_json:
        options.print_json(result)
        return
    typer.echo("Blind moves, rms in um as measured:")
    options.show(blind_errors(result))
    options.show(result["summary"] | {"results": str(options.out)})
