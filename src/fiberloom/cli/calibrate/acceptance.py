"""`fiberloom acceptance`: units on the bench, compared with the instrument's requirements."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from fiberloom.cli.calibrate.bench import UnitOptions, counting, on_bench
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError
from fiberloom.wholefile import write_whole

if TYPE_CHECKING:
    from rich.table import Table

    from fiberloom.calibration.bench.acceptance import AcceptanceData, Check, UnitVerdict
    from fiberloom.calibration.bench.bench import Progress
    from fiberloom.calibration.bench.rig import BenchRig
    from fiberloom.instruments import FocalPlane
    from fiberloom.report.acceptance_records import Paperwork


@dataclass(frozen=True, kw_only=True)
class AcceptanceOptions(UnitOptions):
    """Of `fiberloom acceptance`."""

    targets: Annotated[int, typer.Option(min=1, help="Random targets for blind moves.")] = 20
    out: Annotated[Path, typer.Option(help="Folder for the reports.")] = Path("runs/acceptance")


def acceptance(options: AcceptanceOptions) -> int:
    """Measure units on the bench and compare them with the instrument's requirements.

    Exit code 1 where a unit is not accepted.
    """
    options.check(options.out)
    from fiberloom.calibration.bench.acceptance import AcceptanceSettings
    from fiberloom.report.acceptance_records import Paperwork

    plane = options.plane()
    _refuse(plane, options.serial)
    settings = AcceptanceSettings(
        n_points=options.points, n_targets=options.targets, visits=options.visits, tilt_deg=options.tilt
    )
    rig, _ = options.rig(plane)
    papers = Paperwork(plane, options.seed, settings, rig.close_up_um, options.serial, options.engineer)
    with waiting(options.as_json) as wait:
        wait.say("acceptance")
        found = on_bench(rig, lambda rig: acceptance_of(rig, papers, counting(wait.count)))
    content, verdicts = write_acceptance(options.out, papers, found)
    if options.as_json:
        options.print_json(content)
    else:
        _print(verdicts, options.out, options.serial)
    return 0 if all(verdict.passed for verdict in verdicts) else 1


def _refuse(plane: FocalPlane, serial: str) -> None:
    if plane.instrument.acceptance is None:
        raise InputError(
            f"{plane.instrument.name}: no requirements; add [acceptance] to the instrument's file"
        )
    if serial and plane.n > 1:
        raise InputError(f"--serial {serial}: {plane.n} units are on the bench; test one at a time")


AcceptanceFound: TypeAlias = "tuple[AcceptanceData, dict[int, str]]"
"""The measurements, and the firmware's versions by positioner."""


async def acceptance_of(rig: BenchRig, papers: Paperwork, progress: Progress) -> AcceptanceFound:
    """Measures all units of a bench."""
    from fiberloom.calibration.bench.acceptance import AcceptanceBench, measure_acceptance

    bench = AcceptanceBench(rig.client, rig.camera, rig.close_up, rig.close_up_um)
    data = await measure_acceptance(bench, papers.plane, papers.settings, seed=papers.seed, progress=progress)
    return data, await rig.client.firmware_versions()


def write_acceptance(
    out: Path, papers: Paperwork, found: AcceptanceFound
) -> tuple[dict[str, Any], list[UnitVerdict]]:
    """Writes acceptance.json, the maps, and a page for each unit; the content and the verdicts."""
    from fiberloom.calibration.bench.acceptance import judge
    from fiberloom.report.acceptance import acceptance_html
    from fiberloom.report.acceptance_records import page_head, page_name, unit_record
    from fiberloom.report.outputs import marks
    from fiberloom.store.calibrations import record_calibration

    data, firmware = found
    verdicts = judge(data, papers.plane, papers.settings.tilt_deg)
    content = marks(papers.plane, papers.seed) | {"bench": "twin", "settings": asdict(papers.settings)}
    content |= {"units": [unit_record(v, papers.serial) for v in verdicts]}
    file = out / "acceptance.json"
    write_whole(file, json.dumps(content, indent=2) + "\n")
    judged = [v.positioner_id for v in verdicts if not v.reason]
    record_calibration(file, "acceptance", judged, content, " ".join(sys.argv))
    data.maps.save(out / "transmission.npz")
    for verdict in verdicts:
        head = page_head(verdict, papers, firmware.get(verdict.positioner_id, "unknown"))
        write_whole(out / page_name(verdict, papers.serial), acceptance_html(verdict, data, head))
    return content, verdicts


def _print(verdicts: Sequence[UnitVerdict], out: Path, serial: str) -> None:
    from rich.console import Console
    from rich.markup import escape

    from fiberloom.report.acceptance_records import page_name

    console = Console()
    for verdict in verdicts:
        word = verdict.word.replace("not", "NOT")
        unit = f"positioner {verdict.positioner_id}" + (f", serial {escape(serial)}" if serial else "")
        title = f"{unit}: {word}"
        if verdict.reason:
            console.print(f"{title}: {verdict.reason}", style="red")
            continue
        console.print(_table(title, verdict.checks))
        for name in verdict.missing:
            console.print(f"not measured: {name}; without it the unit is not accepted", style="red")
    passed = sum(v.passed for v in verdicts)
    pages = page_name(verdicts[0], serial) + (", ..." if len(verdicts) > 1 else "")
    console.print(
        f"{passed} of {len(verdicts)} accepted; reports in {out}/: {pages}, acceptance.json, transmission.npz"
    )


def _table(title: str, checks: Sequence[Check]) -> Table:
    from rich import box
    from rich.table import Table

    from fiberloom.report.acceptance import found_text

    table = Table(box=box.SIMPLE, title=title, title_justify="left")
    table.add_column("requirement")
    for name in ("found", "at most"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for check in checks:
        style = {"pass": "green", "fail": "red"}.get(check.verdict, "dim")
        limit = "" if check.limit is None else f"{check.limit:g} {check.unit}"
        table.add_row(check.name, found_text(check), limit, f"[{style}]{check.verdict}[/]")
    return table
