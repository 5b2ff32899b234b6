"""Gains of the control law for a motor of known inertia. Kronig 2020, Eq. 21 to 23."""

from __future__ import annotations

from collections.abc import Mapping

from fiberloom.units import RAD_PER_DEG

COLLISION_DEG = 120.0
"""Motor degrees of tracking error that are a collision, with the integral against it. Eq. 23."""


def control_gains(known: Mapping[str, float]) -> dict[str, float]:
    """Gains of Eq. 21 to 23 for a motor of `known["inertia"]` (kg m^2), by the firmware's names.

    k_p / J = (192 rad/s)^2 crosses the gap with an error below 20 motor degrees (Fig. 16), damped
    by the drag at 0.6 of critical; the threshold makes 120 motor degrees a collision (Eq. 23).
    """
    inertia = float(known["inertia"])
    k_p = 3.7e4 * inertia
    integral_limit = 4.3e3 * inertia
    return {
        "k_p": k_p,
        "k_i": 22.0 * k_p,
        "integral_limit": integral_limit,
        "collision_torque": k_p * COLLISION_DEG * RAD_PER_DEG + integral_limit,
        "settle_gain": 1.0,
        # 65 uNm for alpha: after the drag is learnt legal moves need less than 40 beyond the model, but one
        # zigzag in 20 000 needed more than 50
        "contact_torque": 1.86e4 * inertia,
        # 2.4 uNm for alpha: legal moves rise by 1.9 at most (docs/firmware.md)
        "touch_torque": 690.0 * inertia,
    }
