"""What `fiberloom calibrate friction`, `inertia` and `stiffness` find on a bench; Fig. 11 to 14."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from fiberloom.blocking import finish
from fiberloom.calibration import (
    Estimate,
    Friction,
    FrictionData,
    FrictionSettings,
    Inertia,
    InertiaData,
    StiffnessData,
    TorqueScale,
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
from fiberloom.studies.paper.bench import PaperBench, make_bench
from fiberloom.studies.paper.outcome import Settings
from fiberloom.twin import TwinWeights

UNITS = 6
RUN_RPM = (500.0, 1000.0, 1500.0, 2000.0)


@dataclass(frozen=True, eq=False)
class Identified:
    """Data and estimates of one seed's units, alpha first."""

    bench: PaperBench
    scale: tuple[TorqueScale, ...]
    friction_data: tuple[FrictionData, ...]
    friction: tuple[Friction, ...]
    inertia_data: tuple[InertiaData, ...]
    inertia: tuple[Inertia, ...]
    stiffness_data: tuple[StiffnessData, ...]
    stiffness: tuple[Estimate, ...]


@lru_cache(maxsize=8)
def identified(seed: int, n_units: int = UNITS) -> Identified:
    """All of it, once; torques are scaled by weights on the arms."""
    return finish(_identify(make_bench(seed, n_units), seed))


def each_seed(settings: Settings, figure: int) -> list[Identified]:
    """All of it for every seed, told to the user as work for this figure."""
    found = []
    for seed in settings.seeds:
        settings.say(f"Figure {figure}: seed {seed}")
        found.append(identified(seed))
    return found


async def _identify(bench: PaperBench, seed: int) -> Identified:
    client, camera, plane = bench.client, bench.camera, bench.plane
    weights = TwinWeights(bench.twin, seed=seed)
    # a weight on an arm is what the firmware's watch takes for a contact
    await client.set_loop(bench.ids, closed=True, collision_detection=False)
    scales = [identify_torque_scale(d) for d in await measure_torque_scale(client, None, weights, plane)]
    scale = tuple(measured_scale(found) for found in scales)
    friction = await measure_friction(client, None, plane, FrictionSettings(run_rpm=RUN_RPM))
    inertia = await measure_inertia(client, None, plane)
    stiffness = await measure_stiffness(client, camera, weights, plane)
    return Identified(
        bench,
        scale,
        friction,
        tuple(identify_friction(d, s) for d, s in zip(friction, scale, strict=True)),
        inertia,
        tuple(identify_inertia(d, s) for d, s in zip(inertia, scale, strict=True)),
        stiffness,
        tuple(identify_stiffness(d) for d in stiffness),
    )
