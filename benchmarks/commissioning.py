"""What commissioning is worth: tracking errors along the ramps of Fig. 16.

    python benchmarks/commissioning.py --units 50 --seed 0 [--out FILE.json]

Units of the twin whose firmware holds the nominal unit's parameters are put on a bench: own calibrations of
hall sensors and cogging, torque scale by weights, friction, inertia, stiffness, backlash; what follows is
written over the bus, read back, saved, and survives a power cut. Then three twins of the same units, with the
factory's parameters, the commissioned ones (as read over the bus) and the true ones, drive the ramps of
Kronig 2020, Fig. 16. The figures are largest errors, commanded minus true motor angle, motor deg.

"Eq. 21": the paper's law; the drag is not learnt and the watches are off, so that every unit gets to the end.
"as shipped": everything on; units that stop with a false collision are counted.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.bus import Client, WireTrajectory
from fiberloom.bus.parameters import read_parameters
from fiberloom.calibration import (
    StiffnessSettings,
    SweepSettings,
    calibrate_transmission,
    identify_friction,
    identify_inertia,
    identify_stiffness,
    identify_torque_scale,
    measure_friction,
    measure_inertia,
    measure_stiffness,
    measure_torque_scale,
    measured_scale,
)
from fiberloom.calibration.commissioning.commission import Commissioned, begin, derive_units, write_units
from fiberloom.calibration.commissioning.measured import Quantities, merged, of_estimates, of_maps
from fiberloom.instruments import FocalPlane, generate, load_instrument
from fiberloom.studies.paper.control.fig16_tracking import ramps
from fiberloom.twin import NoiseCamera, Twin, TwinTransport, TwinWeights, Units, draw_units

START_DEG = 60.0
ALARMS = ("collision_torque", "contact_torque", "touch_torque")
SOURCE = "benchmark, twin"


def bench(plane: FocalPlane, units: Units, seed: int) -> tuple[Twin, Client]:
    """Units alone, at START_DEG."""
    twin = Twin(plane, units, seed=seed, neighbours=False, start_deg=START_DEG)
    return twin, Client(TwinTransport(twin))


async def identified(twin: Twin, client: Client, seed: int) -> dict[int, Quantities]:
    """What the bench finds of every unit; the truth is not asked."""
    plane = twin.plane
    weights = TwinWeights(twin, seed=seed)
    camera = NoiseCamera(twin, plane.instrument.metrology.noise_rms_um, seed + 1)
    scales = [identify_torque_scale(d) for d in await measure_torque_scale(client, None, weights, plane)]
    known = [measured_scale(s) for s in scales]
    friction, inertia = list(scales), []
    for data, scale in zip(await measure_friction(client, None, plane), known, strict=True):
        friction += identify_friction(data, scale).estimates
    for pushes, scale in zip(await measure_inertia(client, None, plane), known, strict=True):
        found = identify_inertia(pushes, scale)
        inertia += [found.inertia, found.drag]
    pulled = await measure_stiffness(client, camera, weights, plane, StiffnessSettings(repeats=5))
    stiffness = [identify_stiffness(d) for d in pulled]
    maps = (await calibrate_transmission(client, camera, plane, SweepSettings(60), seed=seed)).maps
    return {
        int(number): merged(
            {
                "friction": of_estimates(friction, row, SOURCE),
                "inertia": of_estimates(inertia, row, SOURCE),
                "stiffness": of_estimates(stiffness, row, SOURCE),
                "transmission": of_maps(maps, row, SOURCE),
            }
        )
        for row, number in enumerate(plane.positioner_id)
    }


async def commission(plane: FocalPlane, units: Units, seed: int) -> tuple[np.ndarray, list[Commissioned]]:
    """Parameters as the units hold them after a power cut, (N, 2) records; and how each fared."""
    twin, client = bench(plane, units, seed)
    await client.discover()
    before = await begin(client, plane)
    found = await identified(twin, client, seed)
    done = await write_units(client, before, derive_units(before, found))
    for number in client.ids:
        twin.power_cycle(number)
    held = await read_parameters(client, client.ids)
    return np.array([held[int(i)].values for i in plane.positioner_id]), done


def eq_21(firmware: np.ndarray) -> np.ndarray:
    """The paper's law with the watches off."""
    out = firmware.copy()
    out["drag_learning_time"] = 0.0
    for alarm in ALARMS:
        out[alarm] *= 100.0
    return out


def as_shipped(firmware: np.ndarray) -> np.ndarray:
    """As it is."""
    return firmware


async def _track(plane: FocalPlane, units: Units, seed: int, axis: int) -> tuple[np.ndarray, int]:
    twin, client = bench(plane, units, seed)
    await client.discover()
    time_s, path_deg = ramps()
    paths = {}
    for row, number in enumerate(client.ids):
        wire = [units.transmission(row, k, START_DEG)[0][0] + np.zeros_like(path_deg) for k in (0, 1)]
        wire[axis] = wire[axis] + path_deg
        paths[number] = WireTrajectory.from_deg(time_s, *wire)
    await client.send_trajectories(paths)
    scopes = [twin.scope(row, axis) for row in range(len(plane))]
    await client.start()
    await client.sleep(time_s[-1] + 0.2)
    logs = [scope.take()["tracking_deg"] for scope in scopes]
    errors = [(np.abs(log).max(), np.sqrt(np.mean(log**2))) for log in logs]
    return np.array(errors), len({c.positioner for c in client.collisions})


def tracking(
    plane: FocalPlane, units: Units, seed: int, law: Callable[[np.ndarray], np.ndarray]
) -> list[dict[str, Any]]:
    """Of alpha and of beta: largest and rms error over units, and how many stopped with a false collision."""
    changed = replace(units, firmware=law(units.firmware))
    out = []
    for axis, name in enumerate(("alpha", "beta")):
        errors, stopped = asyncio.run(_track(plane, changed, seed, axis))
        largest, rms = errors.T
        out.append(
            {
                "axis": name,
                "largest_median_deg": float(np.median(largest)),
                "largest_worst_deg": float(largest.max()),
                "rms_median_deg": float(np.median(rms)),
                "rms_worst_deg": float(rms.max()),
                "stopped": stopped,
            }
        )
    return out


def refusals(done: list[Commissioned]) -> Counter[str]:
    """Reasons, without their numbers, and how many units each refused."""
    return Counter(reason.split(":")[0] for unit in done for reason in set(unit.reasons))


def _line(law: str, kind: str, found: dict[str, Any]) -> str:
    keys = ("largest_median_deg", "largest_worst_deg", "rms_median_deg", "rms_worst_deg")
    numbers = " ".join(f"{found[key]:8.2f}" for key in keys)
    return f"{law:<11} {kind:<13} {found['axis']:<6} {numbers} {found['stopped']:8d}"


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--units", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    begun_s = time.process_time()
    plane = generate(load_instrument("sdssv"), given.seed, n_positioners=given.units)
    factory = draw_units(plane, given.seed, firmware="nominal")
    held, done = asyncio.run(commission(plane, factory, given.seed))
    kinds = {
        "factory": factory,
        "commissioned": replace(factory, firmware=held),
        "true": draw_units(plane, given.seed, firmware="true"),
    }
    print(f"{sum(c.ok for c in done)} of {len(done)} units commissioned, read back and saved")
    for reason, count in refusals(done).items():
        print(f"  refused {count}: {reason}")
    rows = []
    print(f"{'':<32}  largest error      rms error       stopped")
    print(f"{'law':<11} {'parameters':<13} {'axis':<6}  median   worst   median   worst")
    for law in (eq_21, as_shipped):
        for kind, units in kinds.items():
            for found in tracking(plane, units, given.seed, law):
                rows.append({"law": law.__name__, "parameters": kind} | found)
                print(_line(law.__name__, kind, found), flush=True)
    print(f"CPU {time.process_time() - begun_s:.0f} s")
    if given.out:
        content = {"units": given.units, "seed": given.seed, "commissioned": sum(c.ok for c in done)}
        given.out.write_text(json.dumps(content | {"tracking": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
