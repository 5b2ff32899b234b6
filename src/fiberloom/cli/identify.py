"""`fiberloom calibrate friction|stiffness|inertia|arms|repeatability`: measure, identify, write, draw."""

from __future__ import annotations

import json
import sys
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fiberloom.calibration import (
    ArmsSettings,
    FrictionSettings,
    InertiaSettings,
    RepeatabilitySettings,
    StiffnessSettings,
    TorqueScale,
    identify_arms,
    identify_friction,
    identify_inertia,
    identify_repeatability,
    identify_stiffness,
    identify_torque_scale,
    measure_arms,
    measure_friction,
    measure_inertia,
    measure_repeatability,
    measure_stiffness,
    measure_torque_scale,
    measured_scale,
)
from fiberloom.calibration.bench.bench import Progress
from fiberloom.calibration.bench.estimate import Estimate
from fiberloom.calibration.bench.torque import data_sheet_scale
from fiberloom.cli.bench import (
    CLOSE_UP_UM,
    BenchRequest,
    BenchRig,
    counting,
    on_bench,
    refused,
    results,
    table_rows,
)
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError
from fiberloom.report import identification as figures
from fiberloom.report.outputs import prepare_folder
from fiberloom.store.calibrations import record_calibration
from fiberloom.tables import write_ecsv


@dataclass(frozen=True)
class Identified:
    """What a measurement gave."""

    estimates: list[Estimate]
    draw: Callable[[BenchRequest], None]
    """Draws the figure of the first positioner."""


Work = Callable[[BenchRig, Progress], Awaitable[Identified]]


def run_identification(name: str, request: BenchRequest, work: Work) -> tuple[dict[str, Any], bool]:
    """Measures on the bench; writes NAME.json, NAME.ecsv and NAME.png. Returns the content, and
    whether every positioner has all its estimates."""
    prepare_folder(request.out)
    with waiting(request.quiet) as wait:
        wait.say(f"measuring {name}")
        try:
            rig, found = on_bench(request, lambda rig: work(rig, counting(wait.count)))
        except InputError as error:
            ids = ", ".join(map(str, request.plane.positioner_id[:3]))
            raise InputError(f"calibrate {name}, positioner {ids}: {error}") from None
    content = results(request, rig, found.estimates)
    file = request.out / f"{name}.json"
    file.write_text(json.dumps(content, indent=2) + "\n")
    whole = np.all([e.ok for e in found.estimates], axis=0)
    record_calibration(file, name, request.plane.positioner_id[whole], content, " ".join(sys.argv))
    head = {key: value for key, value in content.items() if key != "positioners"}
    write_ecsv(request.out / f"{name}.ecsv", table_rows(content), head)
    found.draw(request)
    return content, not refused(found.estimates)


def friction_work(request: BenchRequest, settings: FrictionSettings, weights: bool) -> Work:
    """Fig. 11 and 12."""

    async def work(rig: BenchRig, progress: Progress) -> Identified:
        scales, found = await _scales(rig, request, weights, progress)
        data = await measure_friction(rig.client, None, request.plane, settings, progress)
        both = [identify_friction(d, s) for d, s in zip(data, scales, strict=True)]

        def draw(request: BenchRequest) -> None:
            figures.plot_friction(
                request.out / "friction.png", request.plane, data, both, scales, _row(found_all)
            )

        found_all = [*found, *(e for axis in both for e in axis.estimates)]
        return Identified(found_all, draw)

    return work


def inertia_work(request: BenchRequest, settings: InertiaSettings, weights: bool) -> Work:
    """Fig. 14."""

    async def work(rig: BenchRig, progress: Progress) -> Identified:
        scales, found = await _scales(rig, request, weights, progress)
        data = await measure_inertia(rig.client, None, request.plane, settings, progress)
        both = [identify_inertia(d, s) for d, s in zip(data, scales, strict=True)]
        all_of = [*found, *(e for axis in both for e in (axis.inertia, axis.drag))]

        def draw(request: BenchRequest) -> None:
            figures.plot_inertia(request.out / "inertia.png", request.plane, data, both, scales, _row(all_of))

        return Identified(all_of, draw)

    return work


def stiffness_work(request: BenchRequest, settings: StiffnessSettings) -> Work:
    """Fig. 13."""

    async def work(rig: BenchRig, progress: Progress) -> Identified:
        data = await measure_stiffness(rig.client, rig.camera, rig.weights, request.plane, settings, progress)
        both = [identify_stiffness(d) for d in data]

        def draw(request: BenchRequest) -> None:
            figures.plot_stiffness(request.out / "stiffness.png", request.plane, data, both, _row(both))

        return Identified(both, draw)

    return work


def arms_work(request: BenchRequest, settings: ArmsSettings) -> Work:
    """Two circles."""

    async def work(rig: BenchRig, progress: Progress) -> Identified:
        data = await measure_arms(rig.client, rig.camera, request.plane, settings, progress)
        arms = identify_arms(data)
        every = list(arms.estimates)

        def draw(request: BenchRequest) -> None:
            figures.plot_arms(request.out / "arms.png", request.plane, data, arms, _row(every))

        return Identified(every, draw)

    return work


def repeatability_work(request: BenchRequest, settings: RepeatabilitySettings) -> Work:
    """Fig. 17, with the camera close up."""

    async def work(rig: BenchRig, progress: Progress) -> Identified:
        data = await measure_repeatability(rig.client, rig.close_up, request.plane, settings, progress)
        both = [identify_repeatability(d, CLOSE_UP_UM) for d in data]
        every = [e for axis in both for e in (axis.measured, axis.own, axis.angle)]

        def draw(request: BenchRequest) -> None:
            figures.plot_repeatability(
                request.out / "repeatability.png", request.plane, data, both, _row(every)
            )

        return Identified(every, draw)

    return work


async def _scales(
    rig: BenchRig, request: BenchRequest, weights: bool, progress: Progress
) -> tuple[list[TorqueScale], list[Estimate]]:
    """By weights, or by the data sheet."""
    if not weights:
        return [data_sheet_scale(request.plane, axis) for axis in range(2)], []
    data = await measure_torque_scale(rig.client, None, rig.weights, request.plane, progress=progress)
    found = [identify_torque_scale(d) for d in data]
    return [measured_scale(e) for e in found], found


def _row(estimates: list[Estimate]) -> int:
    """The first positioner that has everything, else the first."""
    good = np.all([e.ok for e in estimates], axis=0)
    return int(np.argmax(good))
