"""`fiberloom calibrate transmission`, and the cache of its maps."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.calibration.transmission import maps as maps_file
from fiberloom.calibration.transmission.cache import cache_path
from fiberloom.calibration.transmission.evaluate import CalibrationReport
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.calibration.transmission.sweep import Calibration, SweepSettings, calibrate_transmission
from fiberloom.cli.terminal import Waiting, waiting
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.report.outputs import marks, prepare_folder
from fiberloom.report.transmission import plot_transmission
from fiberloom.store.calibrations import record_calibration
from fiberloom.twin import Units, bench_hardware, draw_units

POINTS = 200
"""Per axis and direction, as the paper's Fig. 10."""


@dataclass(frozen=True)
class _Key:
    """What a cached calibration depends on beside the layout and the seed."""

    sweep: SweepSettings
    units: str
    """Digest of the true units: on a twin, other units are other hardware."""


def run_calibrate_transmission(
    plane: FocalPlane, seed: int, points: int, out: Path, quiet: bool
) -> dict[str, Any]:
    """Calibrate every positioner on the bench twin; write maps, report and a figure."""
    prepare_folder(out)
    with waiting(quiet) as wait:
        units = draw_units(plane, seed)
        calibration = _calibrate(plane, units, seed, points, wait)
    calibration.maps.save(out / "transmission.npz")
    summary = marks(plane, seed) | _summary(calibration)
    (out / "transmission.json").write_text(json.dumps(summary, indent=2) + "\n")
    made = plane.positioner_id[calibration.report.ok]
    record_calibration(out / "transmission.npz", "transmission", made, summary, " ".join(sys.argv))
    plot_transmission(out / "transmission.png", calibration.maps, row=0)
    return summary | {"maps": str(out / "transmission.npz")}


def calibrated_maps(
    plane: FocalPlane, units: Units, seed: int, wait: Waiting, path: Path | None = None
) -> TransmissionMaps:
    """Maps from `path`, from the cache, or from a calibration that fills the cache."""
    if path is not None:
        return _in_rows_of(plane, maps_file.load(path))
    cached = maps_path(plane, units, seed)
    if cached.exists():
        return _in_rows_of(plane, maps_file.load(cached))
    calibration = _calibrate(plane, units, seed, POINTS, wait)
    with contextlib.suppress(InputError):  # where nothing can be kept, calibrate again next time
        calibration.maps.save(cached)
    return calibration.maps


def maps_path(plane: FocalPlane, units: Units, seed: int, path: Path | None = None) -> Path:
    """The file of these maps: `path`, else the cache's, there or not yet."""
    # the true units belong to the key: on a twin, other units are other hardware
    key = _Key(SweepSettings(POINTS), units.digest())
    return path or cache_path(plane.config_hash(), seed, key)


def _calibrate(plane: FocalPlane, units: Units, seed: int, points: int, wait: Waiting) -> Calibration:
    wait.say("calibrating transmissions")
    hardware = bench_hardware(plane, units, seed)
    client = Client(hardware.transport)

    async def whole() -> Calibration:
        await client.discover()
        return await calibrate_transmission(
            client, hardware.camera, plane, points, seed=seed, progress=wait.count
        )

    return asyncio.run(whole())


def _in_rows_of(plane: FocalPlane, maps: TransmissionMaps) -> TransmissionMaps:
    return maps.select(maps.rows_of(plane.positioner_id))


def _summary(calibration: Calibration) -> dict[str, Any]:
    report, maps = calibration.report, calibration.maps
    ok = report.ok
    # at the knots themselves: between them the interpolation of both directions would come in
    gap_deg = maps.output_deg[ok, :, 0] - maps.output_deg[ok, :, 1]
    backlash = maps.provenance.gear * gap_deg
    return {
        "positioners": len(maps),
        "calibrated": int(ok.sum()),
        "refused": _refused(report),
        "backlash_motor_deg": [float(backlash.min()), float(backlash.max())],
        "circle_rms_um": [float(np.median(c)) for c in report.circle_rms_um[ok].T],
        "l_alpha_se_um": 1e3 * float(np.median(report.l_alpha_se_mm[ok])),
        "l_beta_se_um": 1e3 * float(np.median(report.l_beta_se_mm[ok])),
    }


def _refused(report: CalibrationReport) -> dict[int, str]:
    return {int(p): r for p, r in zip(report.positioner_id, report.reason, strict=True) if r}
