"""What the limits of an instrument's `[care]` mean: temperature, speed, groups. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiberloom.bus.outcome import Results
from fiberloom.instruments.model import Care, ColdRule, Instrument
from fiberloom.planning.planner import SPEED_SHARE

DEG_S_PER_RPM = 6.0
"""Of the motor."""


def temperature_C(care: Care, raw: Results) -> float | None:
    """Median of what the positioners report (command 132), deg C; None where none does.

    The median: a sensor that is broken does not make it cold.
    """
    counts = [answer.values[0] for answer in raw.values() if answer.ok]
    if not counts or care.temperature_C_per_count is None:
        return None
    return care.temperature_zero_C + care.temperature_C_per_count * float(np.median(counts))


def cold_rule(care: Care, at_C: float | None) -> ColdRule | None:
    """The rule for a temperature in deg C; None: it is warm. At an unknown one the coldest rule holds."""
    fitting = [rule for rule in care.cold if at_C is None or at_C <= rule.below_C]
    return min(fitting, key=lambda rule: rule.below_C, default=None)


def motor_speed_rpm(instrument: Instrument, axis: int, rule: ColdRule | None) -> float:
    """Speed of plans and go-to moves of an axis (0 alpha, 1 beta) at the motor; no rule: when it is warm."""
    of = instrument.axes[axis]
    warm = SPEED_SHARE * of.speed_deg_s * of.gear / DEG_S_PER_RPM
    return min(warm, rule.speed_rpm) if rule else warm


def holding_percent(rule: ColdRule | None) -> tuple[int, int]:
    """Holding current of alpha and beta, percent of the full field."""
    alpha, beta = rule.holding_percent if rule else (0.0, 0.0)
    return round(alpha), round(beta)


def groups_within_supply(instrument: Instrument, ids: Sequence[int]) -> list[list[int]]:
    """Positioners in groups whose motors may all turn at full speed at once, in the given order.

    For motions without a plan: datum searches, go-to moves, calibrations.
    """
    care = instrument.care
    if care.supply_A is None:
        return [list(ids)] if ids else []
    most = max(1, int(care.supply_A / sum(care.motor_most_A)))
    return [list(ids[k : k + most]) for k in range(0, len(ids), most)]
