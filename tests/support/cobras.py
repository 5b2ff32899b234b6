"""Focal planes of cobras for tests: whole modules, as `FocalPlane.of("pfs", n=...)` does not have them."""

from dataclasses import replace

import numpy as np

from fiberloom.instruments import FocalPlane


def pfs_plane(n=2394, seed=0, fiducials=True):
    """Cobras 1 to n, as they are drawn."""
    plane = FocalPlane.of("pfs", seed=seed).select(np.arange(n))
    return plane if fiducials else replace(plane, fiducials=np.zeros((0, 3)))
