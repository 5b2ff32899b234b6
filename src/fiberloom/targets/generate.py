"""Example target lists."""

import numpy as np
from scipy.spatial import cKDTree

from fiberloom.instruments import FocalPlane
from fiberloom.targets.target_list import FREE, TargetList
from fiberloom.typing import Floats

PRIORITIES = (1, 2, 3, 4, 5)
SHARE_SPECIFIC = 0.3
"""Share of targets that ask for one fibre; the others take any."""


def random_targets(plane: FocalPlane, n: int, seed: int) -> TargetList:
    """n targets, uniform over the field that the plane reaches, with priorities 1 to 5.

    The field is the disc around the middle of the positioners that just holds their reach; places
    that no positioner reaches are drawn again. Three in ten ask for one fibre by name.
    """
    rng = np.random.default_rng(seed)
    xy = _uniform_reachable(plane, n, rng)
    fibres = np.array(plane.science_fibres)
    specific = rng.random(n) < SHARE_SPECIFIC
    fibre = np.where(specific, fibres[rng.integers(len(fibres), size=n)], "")
    digits = len(str(n))
    return TargetList(
        target_id=np.array([f"T{i + 1:0{digits}d}" for i in range(n)], dtype=np.str_),
        x_mm=xy[:, 0].round(6),
        y_mm=xy[:, 1].round(6),
        priority=rng.choice(PRIORITIES, size=n).astype(np.float64),
        fibre=fibre.astype(np.str_),
        positioner_id=np.full(n, FREE),
    )


def _uniform_reachable(plane: FocalPlane, n: int, rng: np.random.Generator) -> Floats:
    inner, outer = plane.instrument.reach_mm
    centres = plane.centres_mm
    middle = (centres.min(axis=0) + centres.max(axis=0)) / 2
    radius = np.linalg.norm(centres - middle, axis=1).max() + outer
    # eight nearest centres: of seven hexagons around a place, at least one is neither too near
    # nor too far if any is
    tree = cKDTree(centres)
    found = np.empty((0, 2))
    while len(found) < n:
        r, angle = radius * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
        xy = middle + np.column_stack([r * np.cos(angle), r * np.sin(angle)])
        distance, _ = tree.query(xy, k=min(8, len(centres)))
        distance = distance.reshape(n, -1)
        found = np.vstack([found, xy[((distance > inner) & (distance < outer)).any(axis=1)]])
    return found[:n]
