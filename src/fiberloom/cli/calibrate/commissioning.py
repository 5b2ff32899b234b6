"""`fiberloom commission`: measure, derive, write over the bus, read back, save, accept."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from fiberloom.calibration import (
    ArmsSettings,
    FrictionSettings,
    InertiaSettings,
    RepeatabilitySettings,
    StiffnessSettings,
)
from fiberloom.calibration.bench.acceptance import AcceptanceSettings
from fiberloom.calibration.bench.rig import BenchRig
from fiberloom.calibration.commissioning.commission import (
    Before,
    Commissioned,
    begin,
    derive_units,
    parameter_file,
    write_units,
)
from fiberloom.calibration.commissioning.derive import Derivation
from fiberloom.calibration.commissioning.measured import Quantities, merged, of_data_sheet, of_file, of_maps
from fiberloom.calibration.transmission import maps as maps_file
from fiberloom.calibration.transmission.sweep import SweepSettings, calibrate_transmission
from fiberloom.cli.calibrate.acceptance import AcceptanceFound, acceptance_of, write_acceptance
from fiberloom.cli.calibrate.bench import counting, on_bench
from fiberloom.cli.calibrate.identification import (
    Task,
    Work,
    arms_work,
    complete_row,
    friction_work,
    inertia_work,
    repeatability_work,
    stiffness_work,
)
from fiberloom.cli.terminal import Waiting, waiting
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.report.acceptance_records import Paperwork
from fiberloom.report.commissioning import commissioning_html, limits_text, number_text
from fiberloom.report.estimates import estimate_records
from fiberloom.report.outputs import marks
from fiberloom.store.calibrations import record_calibration
from fiberloom.units import AXES
from fiberloom.wholefile import write_whole

TRANSMISSION = "transmission"
FIRMWARE_QUANTITIES = ("torque at full voltage", "inertia", "drag", "drag of the pushes", "Coulomb friction",
                       "spring at 0 deg", "spring rate", "cogging", "cogging phase")  # fmt: skip


@dataclass(frozen=True)
class CommissionSettings:
    """Settings of the measurements, and where their results go."""

    friction: FrictionSettings = field(default_factory=FrictionSettings)
    inertia: InertiaSettings = field(default_factory=InertiaSettings)
    stiffness: StiffnessSettings = field(default_factory=StiffnessSettings)
    arms: ArmsSettings = field(default_factory=ArmsSettings)
    repeatability: RepeatabilitySettings = field(default_factory=lambda: RepeatabilitySettings(visits=30))
    n_points: int = 60
    """Of the transmission, per axis and direction."""
    weights: bool = True
    acceptance: AcceptanceSettings | None = field(default_factory=AcceptanceSettings)
    """None: no acceptance."""
    earlier: Path | None = None
    """Folder with results of earlier measurements; what it lacks is measured."""
    file_only: bool = False
    """Write parameter files only, and nothing over the bus."""
    serial: str = ""
    engineer: str = ""


@dataclass(frozen=True)
class Job:
    """Which units, and where the results go."""

    plane: FocalPlane
    seed: int
    out: Path
    quiet: bool = False


Parts = dict[str, dict[int, Quantities]]
"""Measured quantities, by measurement and by positioner."""


@dataclass(frozen=True)
class _Whole:
    before: Before
    found: dict[int, Quantities]
    derivations: dict[int, Derivation]
    units: list[Commissioned]
    accepted: AcceptanceFound | None


def run_commission(request: Job, rig: BenchRig, settings: CommissionSettings) -> dict[str, Any]:
    """Commissions all units of the bench; the content of commissioning.json.

    Writes a file for each measurement as it ends, commissioning.json, a parameter file and a page for each
    unit, and the files of the acceptance.
    """
    plane = request.plane
    if settings.serial and plane.n > 1:
        raise InputError(
            f"--serial {settings.serial}: {plane.n} units are on the bench; commission one at a time"
        )
    if settings.acceptance is not None and plane.instrument.acceptance is None:
        raise InputError(
            f"{plane.instrument.name}: no requirements; add [acceptance] to the instrument's file, or "
            "give --no-acceptance"
        )
    if settings.earlier is not None and not settings.earlier.is_dir():
        raise InputError(f"--from {settings.earlier}: no such folder; give that of `fiberloom calibrate`")
    with waiting(request.quiet) as wait:
        whole = on_bench(rig, lambda rig: _commission(rig, request, settings, wait))
    content = _write(request, settings, whole, rig.close_up_um)
    if not request.quiet:
        _print(content, request)
    return content


async def _commission(rig: BenchRig, request: Job, settings: CommissionSettings, wait: Waiting) -> _Whole:
    wait.say("own calibrations")
    before = await begin(rig.client, request.plane)
    parts: Parts = {}
    if not settings.weights:
        sheet = of_data_sheet(request.plane)
        parts["data sheet"] = {int(i): sheet for i in request.plane.positioner_id}
    for name, work in _works(settings).items():
        wait.say(f"measuring {name}")
        try:
            parts[name] = await _part(name, work, rig, request, settings, wait)
        except Refused as refused:
            before = _without(before, f"{name}: {refused}")
    found = {
        int(i): merged({name: part.get(int(i), {}) for name, part in parts.items()})
        for i in request.plane.positioner_id
    }
    derivations = derive_units(before, found, request.plane.instrument.care)
    for derivation in derivations.values():
        _write_parameters(request, before, derivation)
    wait.say("writing parameters")
    wanted = {} if settings.file_only else derivations
    units = [
        replace(u, derivation=derivations.get(u.positioner_id))
        for u in await write_units(rig.client, before, wanted)
    ]
    accepted = None
    if settings.acceptance is not None and before.good():
        wait.say("acceptance")
        papers = _papers(request, settings, rig.close_up_um)
        accepted = await acceptance_of(rig, papers, counting(wait.count))
    return _Whole(before, found, derivations, units, accepted)


def _works(settings: CommissionSettings) -> dict[str, Work | None]:
    """Measurements in their order; None for the transmission, which gives maps and no Estimates."""
    return {
        "friction": friction_work(settings.friction, settings.weights),
        "inertia": inertia_work(settings.inertia, settings.weights),
        "stiffness": stiffness_work(settings.stiffness),
        "arms": arms_work(settings.arms),
        "repeatability": repeatability_work(settings.repeatability),
        TRANSMISSION: None,
    }


class Refused(Exception):
    """A measurement that failed on every unit of the bench."""


def _without(before: Before, reason: str) -> Before:
    """The same, with this reason for every unit that has none."""
    return replace(before, trouble={i: old or reason for i, old in before.trouble.items()})


async def _part(
    name: str,
    work: Work | None,
    rig: BenchRig,
    request: Job,
    settings: CommissionSettings,
    wait: Waiting,
) -> dict[int, Quantities]:
    """Reads a measurement from the folder of earlier results, else measures and writes it."""
    if work is None:
        return await _backlash(rig, request, settings, wait)
    file = f"{name}.json"
    if settings.earlier is not None and (settings.earlier / file).exists():
        return of_file(settings.earlier / file, marks(request.plane, request.seed))
    try:
        found = await work(Task(rig, request.plane, counting(wait.count)))
    except InputError as error:
        raise Refused(str(error)) from None
    content = estimate_records(request.plane, request.seed, found.estimates, {})
    write_whole(request.out / file, json.dumps(content, indent=2) + "\n")
    whole = np.all([e.ok for e in found.estimates], axis=0)
    ids = request.plane.positioner_id[whole]
    record_calibration(request.out / file, name, ids, content, " ".join(sys.argv))
    found.draw(request.out / f"{name}.png", complete_row(found.estimates))
    return of_file(request.out / file, content)


async def _backlash(
    rig: BenchRig, request: Job, settings: CommissionSettings, wait: Waiting
) -> dict[int, Quantities]:
    plane, earlier = request.plane, settings.earlier
    file = f"{TRANSMISSION}.npz"
    refused = [""] * plane.n
    if earlier is not None and (earlier / file).exists():
        maps = maps_file.load(earlier / file)
        if (maps.provenance.config_hash, maps.provenance.seed) != (plane.config_hash(), request.seed):
            raise InputError(f"{earlier / file}: its configuration or seed is not this bench's: other units")
        maps = maps.select(maps.rows_of(plane.positioner_id))
    else:
        calibration = await calibrate_transmission(
            rig.client,
            rig.camera,
            plane,
            SweepSettings(settings.n_points),
            seed=request.seed,
            progress=wait.count,
        )
        maps, refused = calibration.maps, list(calibration.report.reason)
        maps.save(request.out / file)
    source = f"{file}, bench twin, {maps.provenance.utc}"
    return {
        int(number): of_maps(maps, row, source, refused[row])
        for row, number in enumerate(plane.positioner_id)
    }


# files


def _papers(request: Job, settings: CommissionSettings, close_up_um: float) -> Paperwork:
    asked = settings.acceptance or AcceptanceSettings()
    return Paperwork(request.plane, request.seed, asked, close_up_um, settings.serial, settings.engineer)


def _write(request: Job, settings: CommissionSettings, whole: _Whole, close_up_um: float) -> dict[str, Any]:
    content = marks(request.plane, request.seed) | {"bench": "twin", "written": not settings.file_only}
    accepted: Mapping[int, bool] = {}
    if whole.accepted is not None and settings.acceptance is not None:
        papers = _papers(request, settings, close_up_um)
        judged, _ = write_acceptance(request.out, papers, whole.accepted)
        accepted = {u["positioner_id"]: u["accepted"] for u in judged["units"]}
    content |= {"units": [_record(unit, whole, settings, accepted) for unit in whole.units]}
    for unit in content["units"]:
        page = commissioning_html(unit, _head(request, unit, content))
        write_whole(request.out / unit["report"], page)
    path = request.out / "commissioning.json"
    write_whole(path, json.dumps(content, indent=2) + "\n")
    good = [u["positioner_id"] for u in content["units"] if u["commissioned"]]
    record_calibration(path, "commission", good, content, " ".join(sys.argv))
    return content


def _record(
    unit: Commissioned, whole: _Whole, settings: CommissionSettings, accepted: Mapping[int, bool]
) -> dict[str, Any]:
    number = unit.positioner_id
    host = {
        name: asdict(q)
        for name, q in whole.found.get(number, {}).items()
        if not name.endswith(FIRMWARE_QUANTITIES)
    }
    good = not unit.reasons and (unit.ok or settings.file_only)
    return unit.record() | {
        "commissioned": good,
        "serial": settings.serial,
        "engineer": settings.engineer,
        "accepted": accepted.get(number),
        "host": host,
        "report": f"commissioning-{number}.html",
    }


def _write_parameters(request: Job, before: Before, derivation: Derivation) -> None:
    """Writes the parameters for flashing, of a unit that is not refused."""
    if derivation.refused:
        return
    number = derivation.positioner_id
    content = marks(request.plane, request.seed) | {
        "positioner_id": number,
        "parameters": parameter_file(derivation.values(before.own[number])),
    }
    write_whole(request.out / f"parameters-{number}.json", json.dumps(content, indent=2) + "\n")


def _head(request: Job, unit: dict[str, Any], content: dict[str, Any]) -> dict[str, Any]:
    plane = request.plane
    told = {None: "not tested", True: "accepted", False: "not accepted"}[unit["accepted"]]
    return {
        "Unit": f"positioner {unit['positioner_id']}",
        "Serial number": unit["serial"] or "______________",
        "Engineer": unit["engineer"] or "______________",
        "Instrument": f"{plane.instrument.name}: {plane.instrument.description}",
        "Measured": content["utc"],
        "Bench": f"twin, seed {request.seed}",
        "In force": f"{unit['in_force']} parameters",
        "Acceptance": told,
        "fiberloom": content["version"],
        "Configuration": content["config_hash"],
    }


# terminal


def _print(content: dict[str, Any], request: Job) -> None:
    console = Console()
    for unit in content["units"]:
        word = "commissioned" if unit["commissioned"] else "NOT commissioned"
        for axis in AXES:
            mine = [p for p in unit["parameters"] if p["axis"] == axis]
            console.print(_table(f"positioner {unit['positioner_id']}, {axis}: {word}", mine))
        for reason in unit["reasons"]:
            console.print(f"  refused: {reason}", style="red")
        if unit["accepted"] is not None:
            console.print(f"  {'accepted' if unit['accepted'] else 'NOT accepted'}")
    good = sum(u["commissioned"] for u in content["units"])
    how = "read back and saved" if content["written"] else "in files for flashing, nothing written"
    console.print(
        f"{good} of {len(content['units'])} commissioned, {how}; results in {request.out}/: "
        "commissioning.json, parameters-*.json, commissioning-*.html"
    )


def _table(title: str, records: list[dict[str, Any]]) -> Table:
    kept = sum(r["origin"] == "factory" for r in records)
    table = Table(
        box=box.SIMPLE, title=title, title_justify="left", padding=(0, 1, 0, 0),
        caption=f"{kept} parameters kept from the factory", caption_justify="left",
    )  # fmt: skip
    for name in ("parameter", "factory", "found", "unit", "limits", ""):
        table.add_column(name, justify="right" if name in ("factory", "found") else "left", no_wrap=True)
    for r in records:
        if r["origin"] == "factory":
            continue
        style = {"good": "green", "refused": "red"}.get(r["verdict"], "dim")
        word = "own" if r["verdict"] == "kept" else r["verdict"]
        table.add_row(
            r["parameter"], f"{r['factory']:.3g}", number_text(r), r["unit"],
            limits_text(r["low"], r["high"]), f"[{style}]{word}[/]",
        )  # fmt: skip
    return table
