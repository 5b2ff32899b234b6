"""The bench of the twin: units alone, any number of them, each known by its index; cameras and weights."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import lru_cache

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.calibration.bench.rig import BenchRig
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane, Instrument, generate, load_instrument
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.draw import draw_units
from fiberloom.twin.errors.switches import GearSpectrum
from fiberloom.twin.hardware import faulty_transport, foreign_motors
from fiberloom.twin.twin import Twin
from fiberloom.twin.units import Units
from fiberloom.twin.weights import TwinWeights

CLOSE_UP_UM = 0.101
"""Kronig 2020, Fig. 18: the camera close up, frames averaged; two-dimensional rms."""


def bench_rig(plane: FocalPlane, units: Units, seed: int, faults: str = "") -> BenchRig:
    """Each of the `units` of a `plane` alone under the cameras, with weights.

    `seed` decides noise, the weights' own errors and which positioners have the `faults`, a text of
    `--faults`; InputError where it cannot be read.
    """
    check_bench(plane.instrument)
    twin = Twin(plane, units, seed=seed, neighbours=False)
    noise_um = plane.instrument.metrology.noise_rms_um
    return BenchRig(
        Client(faulty_transport(twin, faults, seed)),
        NoiseCamera(twin, noise_um, seed + 1),
        NoiseCamera(twin, CLOSE_UP_UM, seed + 2),
        CLOSE_UP_UM,
        TwinWeights(twin, seed=seed),
    )


def check_bench(instrument: Instrument) -> None:
    """Refuses an instrument whose motors this bench does not have."""
    if foreign := foreign_motors(instrument):
        raise InputError(foreign)


def seed_of_serial(seed: int, serial: str) -> int:
    """The seed of the unit with this serial number; that of the bench without one."""
    if not serial:
        return seed
    return int.from_bytes(hashlib.sha256(f"{seed}:{serial}".encode()).digest()[:6], "big")


def bench_units(
    instrument: str, seed: int, units: range, gears: GearSpectrum = "stages"
) -> tuple[FocalPlane, Units]:
    """Layout and truth of units `units` of an `instrument` (preset or file), as many arrays as it takes.

    `seed` draws them, `gears` is the spectrum of their gears; InputError where it is not known.
    Unit i is the same in every range that holds it; its `positioner_id` is i + 1, which is a number on
    a bus up to 2047 only.
    """
    index = np.fromiter(units, dtype=np.int64)
    whole = _array(instrument, seed)
    check_bench(whole.instrument)
    size = len(whole)
    parts = [
        _array(instrument, seed + int(a)).select(index[index // size == a] % size)
        for a in np.unique(index // size)
    ]
    plane = replace(
        parts[0],
        positioner_id=index + 1,
        hole=np.concatenate([p.hole for p in parts]),
        arms=np.concatenate([p.arms for p in parts]),
        points={name: np.concatenate([p.points[name] for p in parts]) for name in parts[0].points},
        offline=np.zeros(len(index), dtype=bool),
        offline_position_deg=np.concatenate([p.offline_position_deg for p in parts]),
    )
    return plane, draw_units(plane, seed, gears=gears)


@lru_cache(maxsize=4)
def _array(instrument: str, seed: int) -> FocalPlane:
    return generate(load_instrument(instrument), seed)
