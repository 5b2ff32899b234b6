"""Move tables: rows of creep and cruise that take both motors of every unit to their goals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.drive.desi.clock import (
    APPROACH_STEPS,
    CREEP_TICKS,
    CRUISE_TENTHS,
    FINAL_DIRECTION,
    LEAST_CRUISE_TENTHS,
    MOST_PAUSE_MS,
    MOST_STEPS,
    PAUSE_TICKS,
    SPIN_TENTHS,
    SPIN_TICKS,
    TICK_HZ,
    tenths_of,
)
from fiberloom.errors import InputError
from fiberloom.typing import Flags, Floats, Ints


@dataclass(frozen=True, eq=False)
class MoveTables:
    """Tables of N units with up to R rows; axis 0 is theta, 1 is phi, positive steps are positive angles.

    A row runs both motors at once, ends when both have ended, then waits. Rows without steps and pause are
    padding and take no time.

    Raises
    ------
    InputError
        Other shapes, more than 20 bits of steps, a cruise of no steps, or a pause out of 0..65535 ms.
    """

    steps: Ints
    """(N, R, 2) signed: creep steps of 0.1 motor deg, or ticks of cruise between the ramps."""
    cruise: Flags
    """(N, R, 2)."""
    pause_ms: Ints
    """(N, R) after the row."""

    def __post_init__(self) -> None:
        shape = self.steps.shape
        if len(shape) != 3 or shape[2] != 2 or self.cruise.shape != shape or self.pause_ms.shape != shape[:2]:
            raise InputError(
                f"move tables: steps {shape}, cruise {self.cruise.shape}, pauses {self.pause_ms.shape}; "
                "(N, R, 2) twice and (N, R) are needed"
            )
        self._refuse(np.abs(self.steps) > MOST_STEPS, f"more than {MOST_STEPS} steps; use two rows")
        self._refuse(self.cruise & (self.steps == 0), "a cruise of no steps has no direction; creep instead")
        outside = (self.pause_ms < 0) | (self.pause_ms > MOST_PAUSE_MS)
        self._refuse(outside, f"a pause must be 0 to {MOST_PAUSE_MS} ms")

    def _refuse(self, bad: Flags, why: str) -> None:
        if bad.any():
            unit, row = np.argwhere(bad)[0][:2]
            raise InputError(f"move tables: unit {unit}, row {row}: {why}")

    def __len__(self) -> int:
        return len(self.steps)

    @cached_property
    def rows(self) -> Ints:
        """(N,) rows that are not padding."""
        used = self.steps.any(axis=2) | (self.pause_ms > 0)
        return np.asarray(np.where(used, np.arange(1, used.shape[1] + 1), 0).max(axis=1, initial=0))

    @cached_property
    def way_tenths(self) -> Ints:
        """(N, R, 2) signed ways of the rows, exact, in tenths of a motor degree."""
        ramps = np.sign(self.steps) * 2 * SPIN_TENTHS
        return np.where(self.cruise, CRUISE_TENTHS * self.steps + ramps, self.steps)

    @cached_property
    def motor_ticks(self) -> Ints:
        """(N, R, 2) ticks that each motor turns in a row."""
        count = np.abs(self.steps)
        return np.where(self.cruise, 2 * SPIN_TICKS + count, CREEP_TICKS * count)

    @cached_property
    def ticks(self) -> Ints:
        """(N, R) ticks of the rows with their pauses."""
        return np.asarray(self.motor_ticks.max(axis=2) + PAUSE_TICKS * self.pause_ms, dtype=np.int64)

    @property
    def duration_s(self) -> Floats:
        """(N,) of the whole table, in s."""
        total: Floats = self.ticks.sum(axis=1) / TICK_HZ
        return total

    def select(self, index: ArrayLike) -> MoveTables:
        """Tables of some units, by rows or a mask."""
        at = np.asarray(index)
        return MoveTables(self.steps[at], self.cruise[at], self.pause_ms[at])


def row_ticks(way_tenths: ArrayLike) -> Ints:
    """Ticks that a motor needs for ways in tenths of a motor deg, by creep or cruise (`leg_steps`)."""
    steps, cruise, _ = leg_steps(np.asarray(way_tenths, dtype=np.int64))
    return np.where(cruise, 2 * SPIN_TICKS + np.abs(steps), CREEP_TICKS * np.abs(steps))


def leg_steps(way_tenths: Ints) -> tuple[Ints, Flags, Ints]:
    """Steps of ways, which of them are cruises, and what their rounding leaves, all of the shape of the ways.

    A way of more than two ramps and 180 motor deg is a cruise of whole steps of 3.3 motor deg. `way_tenths`
    and the rest are tenths of a motor deg.
    """
    far, sign = np.abs(way_tenths), np.sign(way_tenths)
    between = far - 2 * SPIN_TENTHS
    cruise = between > LEAST_CRUISE_TENTHS
    cruised = np.rint(between / CRUISE_TENTHS).astype(np.int64)
    steps = np.where(cruise, cruised, far)
    rest = np.where(cruise, between - CRUISE_TENTHS * cruised, 0)
    return sign * steps, cruise, sign * rest


def move_tables(
    ways_deg: ArrayLike, pause_ms: ArrayLike = 0, *, moving: ArrayLike | None = None
) -> MoveTables:
    """Tables that go some ways one after another, then overshoot and creep back in the final direction.

    Parameters
    ----------
    ways_deg : array_like
        (N, L, 2) ways of theta and phi in deg of the arm, or (N, 2) for one leg.
    pause_ms : array_like
        (N, L) after each leg, in ms.
    moving : array_like, optional
        (N,) flags; the others get an empty table. Left out: who has a way to go.

    Returns
    -------
    MoveTables
        With L + 2 rows. Theta ends in the negative direction, phi in the positive. The last row makes good
        what the cruises round off.

    Raises
    ------
    InputError
        Ways that are no numbers, or that need more steps than a row has.
    """
    ways = np.asarray(ways_deg, dtype=np.float64)
    ways = ways[:, None, :] if ways.ndim == 2 else ways
    if ways.ndim != 3 or ways.shape[2] != 2 or not np.isfinite(ways).all():
        raise InputError(f"move tables: ways of shape {ways.shape}; finite (N, legs, 2) in deg are needed")
    # rounded where the legs end, so that legs do not add up their roundings
    ends = tenths_of(np.cumsum(ways, axis=1))
    return tables_of(np.diff(ends, axis=1, prepend=0), pause_ms, moving=moving)


def tables_of(legs_tenths: Ints, pause_ms: ArrayLike = 0, *, moving: ArrayLike | None = None) -> MoveTables:
    """As `move_tables`, of ways (N, L, 2) in tenths of a motor deg; `pause_ms` (N, L), `moving` (N,)."""
    n, legs = legs_tenths.shape[:2]
    goes = legs_tenths.any(axis=(1, 2)) if moving is None else np.asarray(moving, dtype=bool)
    steps, cruise, rest = leg_steps(legs_tenths)
    back = np.broadcast_to(APPROACH_STEPS * FINAL_DIRECTION, (n, 2))
    last = back + rest.sum(axis=1)
    all_steps = np.concatenate([steps, -back[:, None], last[:, None]], axis=1)
    pauses = np.zeros((n, legs + 2), dtype=np.int64)
    pauses[:, :legs] = np.broadcast_to(np.asarray(pause_ms, dtype=np.int64), (n, legs))
    creeps = np.zeros((n, 2, 2), dtype=bool)
    return MoveTables(
        np.where(goes[:, None, None], all_steps, 0),
        np.concatenate([cruise, creeps], axis=1) & goes[:, None, None],
        np.where(goes[:, None], pauses, 0),
    )
