"""The paper's positioners on a bench: each alone under the camera, driven over the bus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from fiberloom import units as convert
from fiberloom.blocking import finish
from fiberloom.bus import Client
from fiberloom.calibration import Calibration, SweepSettings, calibrate_transmission
from fiberloom.instruments import FocalPlane, Instrument, generate, load_instrument
from fiberloom.instruments.model import METROLOGY
from fiberloom.metrology import Camera
from fiberloom.twin import NoiseCamera, Twin, TwinTransport, Units, draw_units
from fiberloom.twin.errors.switches import GearSpectrum
from fiberloom.typing import Floats

L_BETA_MM = 15.0
"""Kronig 2020, Table 1. The preset's 14.314 is where the telescope's metrology fibre sits; the paper's
bench looked at the fibre at the end of the arm."""
CLOSE_UP_UM = 0.101
"""Kronig 2020, Fig. 18: repeatability of the camera close to the fibre, frames averaged."""


def paper_instrument() -> Instrument:
    """SDSS-V with the camera looking at the fibre of the paper's bench."""
    preset = load_instrument("sdssv")
    seen = preset.positioner.points[METROLOGY].model_copy(update={"x_mm": L_BETA_MM})
    points = {**preset.positioner.points, METROLOGY: seen}
    positioner = preset.positioner.model_copy(update={"points": points})
    return preset.model_copy(update={"positioner": positioner})


def paper_plane(seed: int, n: int) -> FocalPlane:
    """`n` of the paper's positioners with units drawn by the seed."""
    return generate(paper_instrument(), seed, n_positioners=n)


@dataclass(frozen=True)
class PaperBench:
    """A bus, a camera, and (for instruments that a host does not have) the twin behind them."""

    plane: FocalPlane
    units: Units
    twin: Twin
    client: Client
    camera: Camera

    @property
    def ids(self) -> list[int]:
        """Numbers on the bus, by row."""
        return [int(i) for i in self.plane.positioner_id]

    def rest_wire_deg(self, output_deg: ArrayLike) -> Floats:
        """(N, 2) wire positions of these output angles, of the true gear: where a twin is started."""
        output = np.broadcast_to(np.asarray(output_deg, dtype=float), (len(self.plane), 2))
        rows = range(len(self.plane))
        return np.array(
            [[self.units.transmission(r, axis, output[r, axis])[0][0] for axis in (0, 1)] for r in rows]
        )


def make_bench(
    seed: int,
    n: int,
    *,
    noise_um: float | None = None,
    change: Callable[[Units], None] | None = None,
    start_deg: ArrayLike | None = None,
    gears: GearSpectrum = "stages",
) -> PaperBench:
    """A bench with `n` units of this `seed`; `change` may alter them before power-up.

    `noise_um`: of the camera, rms; the instrument's when None; `start_deg` (N, 2): where the arms are
    at power-up; `gears`: the spectrum of the gears.
    """
    plane = paper_plane(seed, n)
    units = draw_units(plane, seed, gears=gears)
    if change:
        change(units)
    twin = Twin(plane, units, seed=seed, neighbours=False, start_deg=start_deg)
    rms_um = plane.instrument.metrology.noise_rms_um if noise_um is None else noise_um
    client = Client(TwinTransport(twin))
    bench = PaperBench(plane, units, twin, client, NoiseCamera(twin, rms_um, seed + 1))
    finish(client.discover())
    return bench


@lru_cache(maxsize=16)
def calibrated(seed: int, n: int, n_points: int = 200, gears: GearSpectrum = "stages") -> Calibration:
    """What `fiberloom calibrate transmission` finds on the bench of this `seed`.

    `n` units with this spectrum of `gears`; `n_points` per axis and direction.
    """
    bench = make_bench(seed, n, gears=gears)
    return finish(
        calibrate_transmission(bench.client, bench.camera, bench.plane, SweepSettings(n_points), seed=seed)
    )


class Mover:
    """Moves a whole bench and waits for it, with as few questions on the bus as it takes."""

    def __init__(self, bench: PaperBench) -> None:
        self._client, self._ids = bench.client, bench.ids
        self._overrun_s = 0.0

    async def goto(self, wire_deg: Floats) -> None:
        """To wire positions (N, 2); raises where a healthy positioner fails to arrive."""
        client = self._client
        begun = await client.goto(self._ids, wire_deg[:, 0], wire_deg[:, 1])
        begun_s = client.time_s
        estimate_s = float(begun.values_array(2).max(initial=0)) * convert.TICK_S
        ended = await client.wait_until_done(
            self._ids,
            estimate_s + 10.0,
            expected_s=estimate_s + self._overrun_s,
            poll_s=0.02,
            stop_on_collision=False,
        )
        if begun.failed or ended.failed:
            raise RuntimeError(f"a healthy positioner did not arrive: {begun.failed or ended}")
        # landing and settling are not in the estimate; nearly the same every time
        self._overrun_s = min(max(client.time_s - begun_s - estimate_s - 0.02, 0.0), 1.0)
