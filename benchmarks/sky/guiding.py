"""What guiding with N stars leaves: the formula beside fits to drawn stars.

`python -m benchmarks.sky.guiding [--star UM] [--draws N] [--instrument NAME]`
"""

from __future__ import annotations

import argparse

import numpy as np

from fiberloom.instruments import generate, load_instrument
from fiberloom.sky.guiding import expected_um, fit_guiding
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM

COUNTS = (3, 4, 6, 8, 12, 16, 32)
RING = 0.9
"""Radius of the ring of guide stars, over that of the field."""


def drawn_um(n: int, star_um: float, field_mm: float, places: Floats, draws: int, seed: int) -> Floats:
    """(len(places),) rms error per axis of `places` in the field, over fits to `n` stars on the ring."""
    rng = np.random.default_rng(seed)
    ring = RING * field_mm * np.exp(2j * np.pi * (np.arange(n) + 0.5) / n)
    stars_mm = np.column_stack([ring.real, ring.imag])
    square = np.zeros(len(places))
    for _ in range(draws):
        seen_mm = stars_mm + rng.normal(0.0, star_um / UM_PER_MM, stars_mm.shape)
        fit = fit_guiding(stars_mm, seen_mm)
        square += np.sum((fit.applied(places) - places) ** 2, axis=1) / 2.0
    return UM_PER_MM * np.sqrt(square / draws)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--star", type=float, default=5.0, metavar="UM", help="of one star, per axis")
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--instrument", default="sdssv")
    asked = parser.parse_args()
    centres_mm = generate(load_instrument(asked.instrument), asked.seed).centres_mm
    field_mm = float(np.hypot(*centres_mm.T).max())
    radii_mm = np.array([0.0, 0.5, 1.0]) * field_mm
    places = np.column_stack([radii_mm, np.zeros(3)])
    ring_mm = RING * field_mm
    print(f"{asked.instrument}: stars of {asked.star:g} um on a ring of {ring_mm:.0f} mm, um per axis")
    print("| stars | centre: formula, drawn | half way | edge |\n|---|---|---|---|")
    for n in COUNTS:
        drawn = drawn_um(n, asked.star, field_mm, places, asked.draws, asked.seed)
        told = [expected_um(n, asked.star, ring_mm, float(r)) for r in radii_mm]
        pairs = " | ".join(f"{a:.2f}, {b:.2f}" for a, b in zip(told, drawn, strict=True))
        print(f"| {n} | {pairs} |")


if __name__ == "__main__":
    main()
