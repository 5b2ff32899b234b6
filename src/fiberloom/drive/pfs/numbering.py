"""Which module, board, sector and plug a cobra has (ics_cobraCharmer, pfs_utils grandfibermap)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.errors import InputError
from fiberloom.typing import Ints

MODULES, COBRAS_PER_MODULE = 42, 57
COBRAS = MODULES * COBRAS_PER_MODULE
BOARDS, COBRAS_PER_BOARD = 2 * MODULES, 29
SECTORS, BOARDS_PER_SECTOR = 6, 14


class Plugs(NamedTuple):
    """Where cobras are plugged in: arrays of the same shape."""

    board: Ints
    """1 to 84; the odd cobras of a module are on its first board."""
    cobra: Ints
    """1 to 29 on that board."""


def plugs_of(cobra_id: ArrayLike) -> Plugs:
    """Board and plug of cobras 1 to 2394 (dimensionless numbers)."""
    ids = np.asarray(cobra_id, dtype=np.int64)
    wrong = (ids < 1) | (ids > COBRAS)
    if np.any(wrong):
        raise InputError(f"cobra {ids[wrong].flat[0]}: cobras are numbered 1 to {COBRAS}")
    module, place = np.divmod(ids - 1, COBRAS_PER_MODULE)
    return Plugs(2 * module + 1 + place % 2, place // 2 + 1)


def cobras_at(board: ArrayLike, cobra: ArrayLike) -> Ints:
    """Cobra ids of plugs (any shape, dimensionless); 0 for none: an even board has 28 cobras."""
    boards, plugs = np.asarray(board, dtype=np.int64), np.asarray(cobra, dtype=np.int64)
    module, even = np.divmod(boards - 1, 2)
    place = 2 * (plugs - 1) + even
    there = (boards >= 1) & (boards <= BOARDS) & (plugs >= 1) & (place < COBRAS_PER_MODULE)
    return np.where(there, COBRAS_PER_MODULE * module + place + 1, 0)


def sector_of(board: ArrayLike) -> Ints:
    """Sector, from 0, of boards 1 to 84 (dimensionless): each has a supply of its own."""
    return (np.asarray(board, dtype=np.int64) - 1) // BOARDS_PER_SECTOR
