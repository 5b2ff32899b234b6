"""Identifies many random units of the twin, and compares with what they really are."""

import asyncio
from dataclasses import dataclass

import numpy as np

from fiberloom.bus import Client
from fiberloom.calibration import (
    ArmsSettings,
    CoastSettings,
    FrictionSettings,
    InertiaSettings,
    RepeatabilitySettings,
    StiffnessSettings,
    identify_arms,
    identify_coast,
    identify_friction,
    identify_inertia,
    identify_repeatability,
    identify_stiffness,
    identify_torque_scale,
    measure_arms,
    measure_coast,
    measure_friction,
    measure_inertia,
    measure_repeatability,
    measure_stiffness,
    measure_torque_scale,
    measured_scale,
)
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import NoiseCamera, Twin, TwinTransport, TwinWeights, draw_units
from fiberloom.twin.truth import true_values
from fiberloom.units import wrap_deg

WORKSPACE_UM, CLOSE_UP_UM = 0.669, 0.101  # Kronig 2020, Fig. 18


@dataclass(frozen=True)
class Size:
    """How much is measured: enough for honest errors, not more."""

    friction: FrictionSettings
    inertia: InertiaSettings
    stiffness: StiffnessSettings
    arms: ArmsSettings
    repeatability: RepeatabilitySettings
    coast: CoastSettings


SMALL = Size(
    FrictionSettings(n_angles=2, run_span_deg=20.0),
    InertiaSettings(pushes=4),
    StiffnessSettings(repeats=6, images=1),
    ArmsSettings(n_points=24),
    RepeatabilitySettings(visits=30),
    CoastSettings(repeats=2),
)
FULL = Size(
    FrictionSettings(),
    InertiaSettings(),
    StiffnessSettings(),
    ArmsSettings(),
    RepeatabilitySettings(visits=100),
    CoastSettings(),
)


def recover(n, seed, size):
    """Estimates by name, and the truth by the same names."""
    plane = generate(load_instrument("sdssv"), seed=seed, n_positioners=n)
    units = draw_units(plane, seed)
    twin = Twin(plane, units, seed=seed, threads=1, neighbours=False)
    estimates = asyncio.run(_all(plane, twin, seed, size))
    return {e.name: e for e in estimates}, true_values(plane, units)


async def _all(plane, twin, seed, size):
    client = Client(TwinTransport(twin))
    await client.discover()
    weights = TwinWeights(twin, seed=seed)
    camera = NoiseCamera(twin, WORKSPACE_UM, seed)
    close_up = NoiseCamera(twin, CLOSE_UP_UM, seed + 1)
    scales = [identify_torque_scale(d) for d in await measure_torque_scale(client, None, weights, plane)]
    friction = await measure_friction(client, None, plane, size.friction)
    inertia = await measure_inertia(client, None, plane, size.inertia)
    stiffness = await measure_stiffness(client, camera, weights, plane, size.stiffness)
    out = [*scales, *(identify_stiffness(d) for d in stiffness)]
    inertias = []
    for axis, scale in enumerate(map(measured_scale, scales)):
        out += identify_friction(friction[axis], scale).estimates
        inertias.append(identify_inertia(inertia[axis], scale).inertia)
        out.append(inertias[-1])
    out += identify_arms(await measure_arms(client, camera, plane, size.arms)).estimates
    for data in await measure_repeatability(client, close_up, plane, size.repeatability):
        out.append(identify_repeatability(data, CLOSE_UP_UM, camera_relative_error=0.0).angle)
    for data, of_axis in zip(await measure_coast(client, None, plane, size.coast), inertias, strict=True):
        out += identify_coast(data, of_axis).estimates
    return out


def errors(estimate, true):
    """(N,) value minus truth; phases on the circle."""
    off = estimate.value - true
    return np.deg2rad(wrap_deg(np.rad2deg(off))) if estimate.unit == "rad" else off


def covered(estimate, true):
    """(N,) whether the 95 % interval holds the truth."""
    half = 0.5 * np.diff(estimate.interval(), axis=0)[0]
    return np.abs(errors(estimate, true)) <= half


def table(estimates, truth):
    """One line for each quantity."""
    out = []
    for name, e in estimates.items():
        off = errors(e, truth[name])
        of_mean = e.standard_error.mean() / np.sqrt(len(e))
        out.append(
            f"{name:30s} {e.unit:12s} true {truth[name].mean():11.5g}  bias {off.mean():10.2e}"
            f"  se {e.standard_error.mean():9.2e}  bias/se {off.mean() / e.standard_error.mean():6.2f}"
            f"  bias/se of mean {off.mean() / of_mean:6.2f}  covered {covered(e, truth[name]).mean():.2f}"
        )
    return "\n".join(out)


if __name__ == "__main__":
    import sys

    print(table(*recover(int(sys.argv[1]), int(sys.argv[2]), FULL if "full" in sys.argv else SMALL)))
