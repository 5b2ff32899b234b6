"""Units alone on a bench, any number of them, each known by its index: what campaigns take."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from fiberloom.instruments import FocalPlane, generate, load_instrument
from fiberloom.twin.draw import draw_units
from fiberloom.twin.units import Units


def bench_units(instrument: str, seed: int, units: range) -> tuple[FocalPlane, Units]:
    """Layout and truth of units `units` of an instrument (preset or file), as many arrays as it takes.

    Unit i is the same in every range that holds it; its `positioner_id` is i + 1, which is a number on
    a bus up to 2047 only.
    """
    index = np.fromiter(units, dtype=np.int64)
    size = len(_array(instrument, seed))
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
    return plane, draw_units(plane, seed)


@lru_cache(maxsize=4)
def _array(instrument: str, seed: int) -> FocalPlane:
    return generate(load_instrument(instrument), seed)
