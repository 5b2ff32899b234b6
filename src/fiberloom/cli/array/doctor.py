"""`fiberloom doctor`: what is wrong with an array; moves nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import typer

from fiberloom.cli.array.options import ArrayOptions
from fiberloom.cli.options import JsonOptions
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError


@dataclass(frozen=True, kw_only=True)
class DoctorOptions(ArrayOptions, JsonOptions):
    """Of `fiberloom doctor`."""

    disk_mb: Annotated[float, typer.Option(min=0.0, help="Free space wanted, MB.")] = 500.0
    calibration_days: Annotated[float, typer.Option(help="Age from which a calibration is old.")] = 180.0
    clock_s: Annotated[float, typer.Option(help="By which clocks may differ, s.")] = 2.0


def doctor(options: DoctorOptions) -> int:
    """Look at everything of an array and move nothing; exit code 1 where something is wrong."""
    options.check()
    from fiberloom.blocking import finish
    from fiberloom.operation.session.doctor.doctor import Doctor
    from fiberloom.operation.session.doctor.findings import DoctorLimits, Verdict, wrong

    limits = DoctorLimits(options.disk_mb, options.calibration_days, options.clock_s)
    unfit = []
    try:
        known = options.known()
    except InputError as error:
        if options.calibration is None:
            raise
        # maps that lack a positioner of the layout: the rest is looked at without them
        unfit = [wrong("calibration", "calibration of other units", f"{options.calibration}: {error}")]
        known = replace(options, calibration=None).known()
    with waiting(options.as_json) as watcher:
        findings = unfit + finish(Doctor(known, options.address, limits, watcher.say).look())
    options.show([finding.as_row() for finding in findings])
    return 1 if any(finding.verdict is Verdict.WRONG for finding in findings) else 0
