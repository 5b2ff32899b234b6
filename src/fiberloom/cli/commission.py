"""`fiberloom commission`: from a unit on the bench to a unit that is ready for its instrument."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from fiberloom.cli.calibrate.bench import CreepOptions, UnitOptions
from fiberloom.cli.calibrate.identification import WeightsOptions
from fiberloom.errors import InputError


@dataclass(frozen=True, kw_only=True)
class CommissionOptions(WeightsOptions, CreepOptions, UnitOptions):
    """Of `fiberloom commission`."""

    earlier: Annotated[
        Path | None,
        typer.Option("--from", help="Folder with results of `calibrate ...`; missing ones are measured."),
    ] = None
    targets: Annotated[int, typer.Option(min=1, help="Random targets of the acceptance.")] = 20
    file: Annotated[
        bool, typer.Option("--file", help="Parameter files for flashing only; nothing over the bus.")
    ] = False
    accept: Annotated[
        bool, typer.Option("--acceptance/--no-acceptance", help="Hand over to the acceptance.")
    ] = True
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/commission")


def commission(options: CommissionOptions) -> int:
    """Measure units, derive their firmware parameters, write them over the bus, accept.

    Exit code 1 where a unit is not commissioned or not accepted.
    """
    if options.earlier is not None and not options.earlier.is_dir():
        raise InputError(f"--from {options.earlier}: no such folder; give that of `fiberloom calibrate`")
    options.check(options.out)
    from fiberloom.calibration import FrictionSettings, RepeatabilitySettings
    from fiberloom.calibration.bench.acceptance import AcceptanceSettings
    from fiberloom.cli.calibrate.commissioning import CommissionSettings, Job, run_commission

    judged = AcceptanceSettings(
        n_points=options.points, n_targets=options.targets, visits=options.visits, tilt_deg=options.tilt
    )
    settings = CommissionSettings(
        friction=FrictionSettings(n_angles=options.places, run_span_deg=options.span),
        repeatability=RepeatabilitySettings(visits=options.visits),
        n_points=min(options.points, 60),
        weights=options.weights,
        acceptance=judged if options.accept else None,
        earlier=options.earlier,
        file_only=options.file,
        serial=options.serial,
        engineer=options.engineer,
    )
    plane = options.plane()
    rig, _ = options.rig(plane, firmware="nominal")
    content = run_commission(Job(plane, options.seed, options.out, options.as_json), rig, settings)
    if options.as_json:
        options.print_json(content)
    return 0 if all(u["commissioned"] and u["accepted"] is not False for u in content["units"]) else 1
