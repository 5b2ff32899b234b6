"""Which positioners have no datum on record, and how one is told where it is (SET_ACTUAL_POSITION, 33).

A positioner without its datum refuses to move. What is declared is what it reports, or that and whole motor
turns: the angle within a turn is the hall sensor's, and stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.bus.protocol import Status
from fiberloom.operation.motion import FieldMotion
from fiberloom.typing import Flags, Floats, Ints

_DATUM_SET, _RESTORED = int(Status.DATUMS_INITIALIZED), int(Status.POSITION_RESTORED)


@dataclass(frozen=True, eq=False)
class PowerUp:
    """What the positioners of a field say of their counters; (N,) flags."""

    lost: Flags
    """The datum of an axis is not known."""
    restored: Flags
    """Of those: the position was restored as power came on. A gear that cannot be driven back keeps its arm
    where it was, so only the count of motor turns is in doubt."""


async def powered_up(motion: FieldMotion) -> PowerUp:
    """What all positioners of the field of `motion` say that are on the bus."""
    plane = motion.plane
    if not motion.has_client:
        none = np.zeros(len(plane), dtype=bool)  # what has lost its count there, its drive sees to
        return PowerUp(none, none)
    rows = np.flatnonzero(np.isin(plane.positioner_id, motion.client.ids) & ~plane.offline)
    bits = await _bits(motion, rows)
    lost = bits & _DATUM_SET != _DATUM_SET
    return PowerUp(lost & (bits >= 0), lost & (bits >= 0) & (bits & _RESTORED != 0))


async def unreferenced(motion: FieldMotion, rows: Ints | None = None) -> Flags:
    """(N,) which answer that the datum of an axis is not known.

    `motion`: of the field; `rows`: of those that are asked, None: all that are on the bus.
    """
    if rows is None:
        return (await powered_up(motion)).lost
    bits = await _bits(motion, rows)
    return np.asarray((bits >= 0) & (bits & _DATUM_SET != _DATUM_SET))


async def _bits(motion: FieldMotion, rows: Ints) -> Ints:
    """(N,) status bits of those in `rows`; -1 of those that do not answer, and of all others."""
    bits = np.full(len(motion.plane), -1, dtype=np.int64)
    if len(rows):
        answers = await motion.client.status(motion.plane.positioner_id[rows])
        bits[rows] = [int(answer.values[0]) if answer.ok else -1 for answer in answers.values()]
    return bits


async def declare_seen_right(motion: FieldMotion) -> None:
    """One without a datum refuses to move: where the image has proved its report, it is told so."""
    if not motion.has_client:
        return
    rows = np.flatnonzero(motion.state.mobile)
    await declare(motion, rows[(await unreferenced(motion, rows))[rows]])


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
