"""Which positioners have no datum on record, and how one is told where it is (SET_ACTUAL_POSITION, 33).

A positioner without its datum refuses to move. What is declared is what it reports, or that and whole motor
turns: the angle within a turn is the hall sensor's, and stays.
"""

from __future__ import annotations

import numpy as np

from fiberloom.bus.protocol import Status
from fiberloom.operation.motion import FieldMotion
from fiberloom.typing import Flags, Floats, Ints

_DATUM_SET = int(Status.DATUMS_INITIALIZED)


async def unreferenced(motion: FieldMotion, rows: Ints | None = None) -> Flags:
    """(N,) which answer that the datum of an axis is not known.

    `motion`: of the field; `rows`: of those that are asked, None: all that are on the bus.
    """
    plane, client = motion.plane, motion.client
    if rows is None:
        rows = np.flatnonzero(np.isin(plane.positioner_id, client.ids) & ~plane.offline)
    answers = await client.status(plane.positioner_id[rows])
    lost = [answer.ok and answer.values[0] & _DATUM_SET != _DATUM_SET for answer in answers.values()]
    flags = np.zeros(len(plane), dtype=bool)
    flags[rows] = lost
    return flags


async def declare(motion: FieldMotion, rows: Ints, turns: Ints | None = None) -> Flags:
    """Tells positioners that they are where they report, or whole motor turns from there.

    `rows` (n,) of the field of `motion`, at rest; `turns` (n, 2): to add, of alpha and beta. Returns (n,)
    which have taken it; where those are is read anew if it has changed.
    """
    if not len(rows):
        return np.zeros(0, dtype=bool)
    ids, wire_deg = motion.plane.positioner_id[rows], motion.state.wire_deg[rows]
    moved_deg: Floats = np.zeros_like(wire_deg) if turns is None else turns * _turn_deg(motion)
    results = await motion.client.set_position(ids.tolist(), *(wire_deg + moved_deg).T)
    if moved_deg.any():
        await motion.read_positions(ids)
    return np.isin(ids, results.ok_ids)


def _turn_deg(motion: FieldMotion) -> Floats:
    """(2,) wire degrees of a motor turn, of alpha and beta."""
    return np.array([360.0 / axis.gear for axis in motion.plane.instrument.axes])
