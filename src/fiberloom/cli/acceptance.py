"""`fiberloom acceptance`: units on the bench, against the instrument's requirements."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from fiberloom.calibration.bench.acceptance import (
    AcceptanceData,
    AcceptanceSettings,
    Check,
    UnitVerdict,
    judge,
    measure_acceptance,
)
from fiberloom.cli.bench import CLOSE_UP_UM, BenchRequest, BenchRig, counting, on_bench
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError
from fiberloom.report.acceptance import acceptance_html, found_text
from fiberloom.report.outputs import marks, prepare_folder
from fiberloom.store.calibrations import record_calibration


def run_acceptance(
    request: BenchRequest, settings: AcceptanceSettings, serial: str, engineer: str
) -> dict[str, Any]:
    """Measures all units, writes acceptance.json, the maps and a page for each unit."""
    plane = request.plane
    if plane.instrument.acceptance is None:
        raise InputError(
            f"{plane.instrument.name}: no requirements; add [acceptance] to the instrument's file"
        )
    if serial and plane.n > 1:
        raise InputError(f"--serial {serial}: {plane.n} units are on the bench; test one at a time")
    prepare_folder(request.out)
    with waiting(request.quiet) as wait:
        wait.say("acceptance")

        async def work(rig: BenchRig) -> tuple[AcceptanceData, dict[int, str]]:
            data = await measure_acceptance(
                rig.client, rig.camera, rig.close_up, CLOSE_UP_UM, plane, settings,
                seed=request.seed, progress=counting(wait.count),
            )  # fmt: skip
            return data, await rig.client.firmware_versions()

        _, (data, firmware) = on_bench(request, work)
        verdicts = judge(data, plane)
        content = marks(plane, request.seed) | {"bench": "twin", "settings": asdict(settings)}
        content |= {"units": [_unit(v, serial) for v in verdicts]}
        file = request.out / "acceptance.json"
        file.write_text(json.dumps(content, indent=2) + "\n")
        judged = [v.positioner_id for v in verdicts if not v.reason]
        record_calibration(file, "acceptance", judged, content, " ".join(sys.argv))
        data.maps.save(request.out / "transmission.npz")
        for verdict in verdicts:
            page = acceptance_html(
                verdict, data, _head(request, verdict, settings, firmware, serial, engineer)
            )
            (request.out / page_name(verdict)).write_text(page, encoding="utf-8")
    if not request.quiet:
        _print(verdicts, request)
    return content


def page_name(verdict: UnitVerdict) -> str:
    """File name of a unit's report."""
    return f"acceptance-{verdict.positioner_id}.html"


def _unit(verdict: UnitVerdict, serial: str) -> dict[str, Any]:
    return {
        "positioner_id": verdict.positioner_id,
        "serial": serial,
        "accepted": verdict.passed,
        "reason": verdict.reason,
        "report": page_name(verdict),
        "checks": [asdict(c) | {"verdict": c.verdict} | _finite(c) for c in verdict.checks],
    }


def _finite(check: Check) -> dict[str, Any]:
    """JSON has no infinity: a target that was never seen has no distance."""
    bad = check.value is not None and not np.isfinite(check.value)
    return {"value": None} if bad else {}


def _head(
    request: BenchRequest,
    verdict: UnitVerdict,
    settings: AcceptanceSettings,
    firmware: dict[int, str],
    serial: str,
    engineer: str,
) -> dict[str, Any]:
    plane = request.plane
    run = marks(plane, request.seed)
    return {
        "Unit": f"positioner {verdict.positioner_id}, hole {plane.hole[verdict.row]}",
        "Serial number": serial or "______________",
        "Engineer": engineer or "______________",
        "Instrument": f"{plane.instrument.name}: {plane.instrument.description}",
        "Requirements": plane.instrument.acceptance.source or plane.instrument.name,  # type: ignore[union-attr]
        "Measured": run["utc"],
        "Bench": f"twin, seed {request.seed}; camera {plane.instrument.metrology.noise_rms_um:g} µm, "
        f"close up {CLOSE_UP_UM:g} µm rms",
        "Procedure": f"{settings.n_points} points per axis and direction; {settings.n_targets} targets of "
        f"{settings.n_moves} moves; 3 x {settings.visits} visits per axis",
        "fiberloom": run["version"],
        "Firmware": firmware.get(verdict.positioner_id, "unknown"),
        "Configuration": run["config_hash"],
    }


def _print(verdicts: list[UnitVerdict], request: BenchRequest) -> None:
    console = Console()
    for verdict in verdicts:
        word = "accepted" if verdict.passed else "NOT accepted"
        title = f"positioner {verdict.positioner_id}: {word}"
        if verdict.reason:
            console.print(f"{title}: {verdict.reason}", style="red")
            continue
        console.print(_table(title, verdict.checks))
    passed = sum(v.passed for v in verdicts)
    console.print(
        f"{passed} of {len(verdicts)} accepted; reports in {request.out}/: "
        f"{page_name(verdicts[0])}{', ...' if len(verdicts) > 1 else ''}, acceptance.json, transmission.npz"
    )


def _table(title: str, checks: tuple[Check, ...]) -> Table:
    table = Table(box=box.SIMPLE, title=title, title_justify="left")
    for name, justify in (("requirement", "left"), ("found", "right"), ("at most", "right"), ("", "left")):
        table.add_column(name, justify=justify, no_wrap=name != "requirement")  # type: ignore[arg-type]
    for check in checks:
        style = {"pass": "green", "fail": "red"}.get(check.verdict, "dim")
        limit = "" if check.limit is None else f"{check.limit:g} {check.unit}"
        table.add_row(check.name, found_text(check), limit, f"[{style}]{check.verdict}[/]")
    return table
