"""Calibration of the transmission with bus and camera alone. Kronig 2020, Eq. 6 and 7.

Each axis in turn is driven through `n_points` wire positions, first upward, then downward, and the
camera looks after every step; the other axis does not move. All positioners do it at once, so they
must be where they cannot touch each other: on a bench, or with the neighbours away.

A pass begins with a run-up larger than the largest backlash, and precise moves are off, so that
each point of a pass has the same contact. An equal spacing of 360 / 200 deg samples the 36 tooth
pairings of a turn five and a half times each; ripple of more than 100 cycles a turn is beyond 200
points and folds back: take more points where an instrument has it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fiberloom import units
from fiberloom.bus.client import Client
from fiberloom.bus.outcome import Results
from fiberloom.calibration.transmission.evaluate import CalibrationReport, evaluate
from fiberloom.calibration.transmission.maps import Provenance, TransmissionMaps
from fiberloom.calibration.transmission.sweep_data import SweepData
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Camera
from fiberloom.typing import Floats

Progress = Callable[[int, int], None]
"""Called with (points done, points in all)."""


_POLL_S = 0.02
_SOONER_S = 0.002
"""So much sooner the next point is asked for, where one poll was enough."""


@dataclass(frozen=True)
class SweepSettings:
    """How to sweep; angles are wire positions."""

    n_points: int = 200
    images: int = 1
    """Images averaged at each point."""
    speed_rpm: float = 2000.0
    run_up_deg: float | None = None
    """Larger than the largest backlash; default: the instrument's approach."""
    beta_lever_deg: float = 75.0
    """Angle of beta while alpha turns: a long lever, away from the singularity."""
    alpha_rest_deg: float = 180.0
    """Angle of alpha while beta turns."""
    settle_s: float = 0.0
    """Between the end of a move and the image."""
    seen_at_least: float = 0.8
    """Share of the points of a pass that must be seen."""

    def run_up_of(self, plane: FocalPlane) -> float:
        """The run-up in deg on this plane."""
        return plane.instrument.approach_deg if self.run_up_deg is None else self.run_up_deg

    def __post_init__(self) -> None:
        if self.n_points < 8:
            raise InputError(f"n_points = {self.n_points}: a sweep needs at least 8 points")
        if self.images < 1:
            raise InputError(f"images = {self.images}: must be at least 1")


@dataclass(frozen=True)
class Calibration:
    """Maps and how good they are."""

    maps: TransmissionMaps
    report: CalibrationReport
    data: SweepData

    def summary(self) -> dict[str, Any]:
        """How many positioners have a map, why the others have none, and how good the maps are."""
        report, ok = self.report, self.report.ok
        counts = {
            "positioners": len(self.maps),
            "calibrated": int(ok.sum()),
            "refused": {int(p): r for p, r in zip(report.positioner_id, report.reason, strict=True) if r},
        }
        return counts | self._figures() if ok.any() else counts

    def _figures(self) -> dict[str, Any]:
        """How good the maps are of those that have one."""
        report, maps = self.report, self.maps
        ok = report.ok
        # at the knots themselves: between them the interpolation of both directions would come in
        gap_deg = maps.output_deg[ok, :, 0] - maps.output_deg[ok, :, 1]
        backlash = maps.provenance.gear * gap_deg
        return {
            "backlash_motor_deg": [float(backlash.min()), float(backlash.max())],
            "circle_rms_um": [float(np.median(c)) for c in report.circle_rms_um[ok].T],
            "l_alpha_se_um": units.UM_PER_MM * float(np.median(report.l_alpha_se_mm[ok])),
            "l_beta_se_um": units.UM_PER_MM * float(np.median(report.l_beta_se_mm[ok])),
        }


async def calibrate_transmission(
    client: Client,
    camera: Camera,
    plane: FocalPlane,
    settings: SweepSettings | None = None,
    *,
    seed: int | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Sweeps both axes of all positioners of the `plane` and builds their maps.

    `client` and `camera` of the bench; `settings`: how to sweep; `seed` goes into the provenance; `progress`
    is called with (points done, points in all).
    A positioner that does not take part as it should gets the identity as its map and a reason in the
    report; the others are calibrated. InputError for fewer than 8 points.
    """
    settings = settings or SweepSettings()
    data = await measure_sweeps(client, camera, plane, settings, progress)
    return calibration_of(plane, data, settings, seed)


def calibration_of(
    plane: FocalPlane, data: SweepData, settings: SweepSettings, seed: int | None = None
) -> Calibration:
    """Maps and report of what a sweep of the `plane` has measured.

    `data`: N positioners, angles in deg and places in mm; `settings`: of the sweep; `seed` goes into the
    provenance.
    """
    provenance = Provenance(
        plane.config_hash(), seed, gear=plane.instrument.alpha.gear, note=f"{settings.n_points} points"
    )
    maps, report = evaluate(plane, data, settings.seen_at_least, provenance)
    return Calibration(maps, report, data)


async def measure_sweeps(
    client: Client,
    camera: Camera,
    plane: FocalPlane,
    settings: SweepSettings,
    progress: Progress | None = None,
) -> SweepData:
    """The moves and the images of a sweep.

    `client` and `camera` of the bench with the positioners of the `plane`; `settings`: points and
    speeds; `progress` is called with (points done, points in all).
    """
    bench = _Bench(client, camera, plane, settings, progress)
    await bench.prepare()
    wire = wire_grid(plane, settings)
    xy = np.full((2, 2, settings.n_points, plane.n, 2), np.nan)
    for axis, rest_deg in enumerate((settings.beta_lever_deg, settings.alpha_rest_deg)):
        await bench.sweep(axis, wire[axis], rest_deg, xy[axis])
    return SweepData(wire, xy, bench.trouble)


def wire_grid(plane: FocalPlane, settings: SweepSettings) -> Floats:
    """(2 axes, K) wire positions of a sweep, deg."""
    return np.stack([_grid(plane, axis, settings) for axis in range(2)])


def _grid(plane: FocalPlane, axis: int, settings: SweepSettings) -> Floats:
    """Equal steps over the angles that moves use: the targets' and the approach above them."""
    low, high = plane.limits_deg[axis]
    stop_low, stop_high = plane.hard_stops_deg[axis]
    # the zero of the wire may be a degree off the arm's: keep clear of the stops with it
    run_up = settings.run_up_of(plane)
    room = run_up + 1.0
    low = max(low, stop_low + room)
    high = min(high + run_up, stop_high - room)
    return np.linspace(low, high, settings.n_points)


class _Bench:
    """Moves all positioners, looks, and records which dropped out."""

    def __init__(
        self,
        client: Client,
        camera: Camera,
        plane: FocalPlane,
        settings: SweepSettings,
        progress: Progress | None,
    ) -> None:
        self.client, self.camera, self.plane, self.settings = client, camera, plane, settings
        self.trouble = ["offline" if off else "" for off in plane.offline]
        self._row = {int(p): row for row, p in enumerate(plane.positioner_id)}
        self._progress = progress or (lambda done, total: None)
        self._done, self._total = 0, 4 * settings.n_points
        self._overrun_s = 0.0

    @property
    def ids(self) -> list[int]:
        """Positioners that still take part."""
        return [p for p, row in self._row.items() if not self.trouble[row]]

    def _book(self, results: Results) -> None:
        for positioner, result in results.failed.items():
            self.trouble[self._row[positioner]] = str(result).partition(": ")[2]

    async def prepare(self) -> None:
        self._book(await self.client.set_precise_moves(self.ids, on=False))
        rpm = self.settings.speed_rpm
        self._book(await self.client.set_speed(self.ids, rpm, rpm))

    async def sweep(self, axis: int, wire_deg: Floats, rest_deg: float, xy: Floats) -> None:
        run_up = self.settings.run_up_of(self.plane)
        # the resting axis comes from above, like every final approach
        await self._goto(axis, wire_deg[0] - run_up, rest_deg + run_up)
        await self._goto(axis, wire_deg[0] - run_up, rest_deg)
        for k, position in enumerate(wire_deg):
            await self._goto(axis, position, rest_deg)
            await self._look(xy[1, k])
        await self._goto(axis, wire_deg[-1] + run_up, rest_deg)
        for k in range(len(wire_deg) - 1, -1, -1):
            await self._goto(axis, wire_deg[k], rest_deg)
            await self._look(xy[0, k])

    async def _look(self, xy: Floats) -> None:
        if self.settings.settle_s:
            await self.client.sleep(self.settings.settle_s)
        images = [self.camera.measure() for _ in range(self.settings.images)]
        seen = np.all([image.seen for image in images], axis=0)
        seen &= np.array([not reason for reason in self.trouble])
        xy[seen] = np.mean([image.xy_mm[seen] for image in images], axis=0)
        self._done += 1
        self._progress(self._done, self._total)

    async def _goto(self, axis: int, moving_deg: float, rest_deg: float) -> None:
        alpha, beta = (moving_deg, rest_deg) if axis == 0 else (rest_deg, moving_deg)
        begun = await self.client.goto(self.ids, float(alpha), float(beta))
        self._book(begun)
        estimate_s = float(begun.values_array(2).max(initial=0)) * units.TICK_S
        ended = await self.client.wait_until_done(
            begun.ok_ids,
            timeout_s=estimate_s + 10.0,
            expected_s=estimate_s + self._overrun_s,
            poll_s=_POLL_S,
            stop_on_collision=False,
        )
        self._book(ended)
        self._learn_overrun(ended.polls)

    def _learn_overrun(self, polls: int) -> None:
        """The estimate leaves landing and settling out, which take the same at every point: one poll of the
        whole array does, now and then two.
        """
        late_s = (polls - 1) * _POLL_S if polls > 1 else -_SOONER_S
        self._overrun_s = min(max(self._overrun_s + late_s, 0.0), 1.0)
