"""The lifetime test behind Fig. 21, 22, 25 and 26, run once for all four."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from fiberloom.studies.lifetime import DELTAS, WAYS, LifetimeSettings, delta_angles_deg, lifetime
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings
from fiberloom.studies.paper.quantity import Quantity
from fiberloom.studies.paper.spectra import SPECTRA
from fiberloom.twin.bench import bench_units
from fiberloom.twin.errors.switches import GearSpectrum
from fiberloom.typing import Array, Floats, Ints

UNITS, CYCLES = 4, 100
BETA = 1
DEFAULT = LifetimeSettings(cycles=CYCLES, cycle_step=9, snapshots=(1, 10, 55, 100))
FULL = LifetimeSettings(cycles=CYCLES)
SMALLER = (
    f"every ninth cycle of {CYCLES} is simulated (wear goes on in between, but maps learn from every ninth "
    f"cycle only), on {UNITS} units per seed instead of two."
)
HOW = (
    "The statistical twin (standstill positions of the same units, held against the full physics by its "
    f"tests) goes through {CYCLES} cycles of 15260 moves: a calibration, then 1220 random targets, blind "
    "and nine corrections. How much wear there is was put in (arms, Fig. 21) or tuned (gears, Fig. 22); how "
    "many marks, how wide and how fast is assumed (docs/twin.md). Arms are the preset's, 7.4 and 14.3 mm."
)


@dataclass(frozen=True)
class Study:
    """One seed's lifetime test."""

    settings: LifetimeSettings
    angles_deg: Floats
    """(points,) of beta at which delta is kept."""
    rows: dict[str, Array]

    @property
    def cycles(self) -> Ints:
        """Simulated ones."""
        return self.settings.simulated

    def blind_um(self, way: str) -> Floats:
        """(cycles,) rms of blind moves over units, as measured."""
        each: Floats = self.rows["measured_um"][:, WAYS.index(way)]
        return np.asarray(np.sqrt(np.mean(each**2, axis=0)))

    def late_um(self, way: str) -> float:
        """The same over the later half of the cycles."""
        late = self.blind_um(way)[len(self.cycles) // 2 :]
        return float(np.sqrt(np.mean(late**2)))

    def delta_deg(self, name: str) -> Floats:
        """(N, snapshots, points) of beta."""
        return np.asarray(self.rows["delta_deg"][:, :, DELTAS.index(name), BETA])


@lru_cache(maxsize=32)
def study(seed: int, settings: LifetimeSettings, n_units: int = UNITS) -> Study:
    """Simulates the units of this seed."""
    plane, _ = bench_units(settings.instrument, seed, range(n_units), settings.gears)
    return Study(settings, delta_angles_deg(plane)[BETA], lifetime(range(n_units), seed, settings))


def studies(settings: Settings, figure: int, gears: GearSpectrum = SPECTRA[0]) -> list[Study]:
    """One for each seed, told to the user as work for this `figure`, with this spectrum of `gears`."""
    out, known = [], "" if gears == SPECTRA[0] else f", gears '{gears}'"
    for seed in settings.seeds:
        settings.say(f"Figure {figure}: lifetime test, seed {seed}{known}")
        out.append(study(seed, replace(FULL if settings.full else DEFAULT, gears=gears)))
    return out


def smaller(settings: Settings) -> str:
    """What is said of the size."""
    return "" if settings.full else SMALLER


def compared(
    settings: Settings,
    figure: int,
    quantities: Callable[[list[Study]], list[Quantity]],
    draw: Callable[[Study], Drawing],
) -> FigureOutcome:
    """Every seed's test beside the paper's figure.

    `settings` of the reproduction; `figure`: its number; `quantities` of all seeds' tests; `draw`: the
    picture of the first seed's.
    """
    found = studies(settings, figure)
    return FigureOutcome(quantities(found), [draw(found[0])], HOW, smaller(settings))
