"""The fastest plan that a supply can feed: all together at a lower speed, or in waves at full speed."""

from __future__ import annotations

import math
from collections.abc import Callable

from fiberloom.errors import InputError
from fiberloom.instruments import Instrument
from fiberloom.planning.supply.currents import currents, peak_current_A
from fiberloom.planning.trajectories import Plan

LEAST_SHARE = 0.1
"""Of the speed; slower ones are not tried."""
TRIES = 6
"""Plans at a lower speed; each is as much work as the first."""
NEAR = 0.97
"""A speed is not refined once it is within so much of one that would be too much."""

AtShare = Callable[[float], Plan]
"""Plans at this share of the speed that is allowed."""
InWaves = Callable[[int, float], Plan]
"""Plans with so many moving at once, at this share of the speed."""


def plan_within_supply(instrument: Instrument, make: AtShare, in_waves: InWaves | None = None) -> Plan:
    """The fastest plan that keeps `care.supply_A`; nothing is slowed where it is enough.

    Parameters
    ----------
    instrument : Instrument
        Whose `[care]` says what the supply gives and what motors take.
    make : callable
        Makes a plan at a share of the speed, 0 to 1; called with 1 first.
    in_waves : callable, optional
        Makes one with at most so many positioners moving at once. Asked where all together cannot be slow
        enough, or where waves promise to be quicker.

    Returns
    -------
    Plan
        Of those that keep the limit the one that refuses fewest, then the shortest.

    Raises
    ------
    InputError
        None does: with the current that the move takes, and when.
    """
    first, supply_A = make(1.0), instrument.care.supply_A
    if supply_A is None or peak_current_A(instrument, first)[0] <= supply_A:
        return first
    slower = _slower(instrument, supply_A, make, first)
    found = [] if slower is None else [slower]
    if in_waves is not None:
        most, share = _wave(instrument, supply_A)
        n_moving = sum(robot.moves for robot in first.robots)
        promised_s = math.ceil(n_moving / most) * first.duration_s / max(share, 1e-9)
        if share >= LEAST_SHARE and (slower is None or promised_s < slower.duration_s):
            found += [made for made in [in_waves(most, share)] if _fits(instrument, made, supply_A)]
    if not found:
        current_A, when_s = peak_current_A(instrument, first)
        raise InputError(
            f"the motors of this move need {current_A:.3g} A after {when_s:.1f} s, and more than the supply "
            f"gives even at {LEAST_SHARE:g} of their speed; care.supply_A is {supply_A:g}: "
            "move fewer positioners at once"
        )
    return min(found, key=lambda made: (len(made.refused), made.duration_s))


def _fits(instrument: Instrument, made: Plan, supply_A: float) -> bool:
    return peak_current_A(instrument, made)[0] <= supply_A


def _wave(instrument: Instrument, supply_A: float) -> tuple[int, float]:
    """How many positioners may move at once, and at which share of the speed: the full one, but for one."""
    care = instrument.care
    most = int(supply_A / sum(care.motor_most_A))
    if most >= 1:
        return most, 1.0
    return 1, (supply_A - sum(care.motor_friction_A)) / sum(care.motor_speed_A)


def _slower(instrument: Instrument, supply_A: float, make: AtShare, first: Plan) -> Plan | None:
    """All together, at the highest speed that is found to do."""
    best: Plan | None = None
    low, high, too_fast = 0.0, 1.0, 0
    share = currents(instrument, first).share_within(supply_A)
    for _ in range(TRIES):
        if share < LEAST_SHARE or share <= low:
            break
        made = make(share)
        promised = share * currents(instrument, made).share_within(supply_A)
        if _fits(instrument, made, supply_A):
            best, low = made, share
            if low >= NEAR * high or promised * NEAR <= low:
                break
            share = min(promised, NEAR * high)
        else:
            # another speed is another plan: what was promised for this one may not be enough
            high, too_fast = share, too_fast + 1
            share = max(min(promised, (1.0 - 0.05 * too_fast) * high), 0.5 * (low + high) if low else 0.0)
    return best
