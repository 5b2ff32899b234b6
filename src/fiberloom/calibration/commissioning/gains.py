"""Gains of the control laws for a motor of known inertia and drag. Kronig 2020, Eq. 21 to 23."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fiberloom.units import RAD_PER_DEG, TICK_S

COLLISION_DEG = 120.0
"""Motor degrees of tracking error that are a collision, with the integral against it. Eq. 23."""

FEEDBACK_RAD_S = 600.0
"""Both poles of the state feedback."""
OBSERVER_RAD_S = 1400.0
"""All three poles of its observer."""


def control_gains(known: Mapping[str, float]) -> dict[str, float]:
    """Gains of both laws, by the firmware's names.

    `known`: "inertia" (kg m^2) and "drag" (Nm s/rad) of the motor, as commissioned.
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
        # 0.8 uNm for alpha: 7 sigma of what its load scatters by at 2000 rpm (docs/firmware.md)
        "touch_torque": 230.0 * inertia,
        **state_gains(inertia, float(known["drag"])),
    }


def state_gains(inertia: float, drag: float) -> dict[str, float]:
    """Gains of the state feedback (law 1) by pole placement on the sampled motor.

    `inertia` (kg m^2, > 0) and `drag` (Nm s/rad, > 0): as commissioned. The motor, J e'' = -T - c e' under a
    torque that is held for a tick, gets both poles at FEEDBACK_RAD_S; the observer all three at its own.
    """
    decay = np.exp(-drag * TICK_S / inertia)
    reach = inertia / drag * (1.0 - decay)  # way of a rate of 1 rad/s in a tick
    # e, e' after a tick: A (e, e') - b T
    push = (1.0 - decay) / drag
    shift = (TICK_S - reach) / drag
    pole = np.exp(-FEEDBACK_RAD_S * TICK_S)
    # trace and determinant of A - b (k_e, k_v) are 2 pole and pole^2
    at_trace = 1.0 + decay - 2.0 * pole
    at_determinant = pole**2 - decay
    # shift k_e + push k_v = at_trace;  (push reach - shift decay) k_e - push k_v = at_determinant
    k_e = (at_trace + at_determinant) / (shift + push * reach - shift * decay)
    return {
        "state_k_e": float(k_e),
        "state_k_v": float((at_trace - shift * k_e) / push),
        "observer_pole": float(np.exp(-OBSERVER_RAD_S * TICK_S)),
    }
