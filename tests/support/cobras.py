"""Focal planes of cobras for tests: whole modules, as `FocalPlane.of("pfs", n=...)` does not have them."""

from dataclasses import replace

import numpy as np

from fiberloom.instruments import FocalPlane


def pfs_plane(n=2394, seed=0, fiducials=True):
    """Cobras 1 to n, as they are drawn."""
    plane = FocalPlane.of("pfs", seed=seed).select(np.arange(n))
    return plane if fiducials else replace(plane, fiducials=np.zeros((0, 3)))


def cut_in_second_run(source):
    """Drops the connection to boards of a `source` in their second RUN; the list returned grows with RUNs."""
    take, runs = source.boards.boards.take, []

    def take_and_cut(data):
        if data[0] == 1:
            runs.append(len(data))
            if len(runs) == 2:
                source.boards.cut()
        return take(data)

    source.boards.boards.take = take_and_cut
    return runs
