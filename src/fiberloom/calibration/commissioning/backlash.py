"""The backlash as the firmware knows it: its mean over the output turn and a few waves."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.typing import Floats

GEAR_TEETH = 36
"""Tooth pairings of the last stage per output turn (Kronig 2020, Fig. 10)."""
BACKLASH_WAVES: dict[str, int] = {
    "backlash_1": 1,
    "backlash_2": 2,
    "backlash_3": 3,
    "backlash_teeth": GEAR_TEETH,
}
"""Parameters of the firmware that hold an amplitude, and how often a turn it comes."""


def tells_waves(theta_deg: Floats) -> bool:
    """Whether points of a map at `theta_deg` (K,) are near enough to tell the waves of `BACKLASH_WAVES`.

    Closer than half a tooth pairing (5 deg); with fewer points what is between them is not measured.
    """
    widest_deg = float(np.diff(np.sort(theta_deg)).max(initial=0.0))
    return len(theta_deg) > 2 * len(BACKLASH_WAVES) and widest_deg < 180.0 / GEAR_TEETH


def wave_parameters(mean_deg: ArrayLike, coefficients_deg: Floats) -> dict[str, Floats]:
    """The firmware's parameters (motor deg, phases rad) of backlashes (...) given by their waves.

    `mean_deg` (...), and `coefficients_deg` (..., waves, 2) of cos m theta and sin m theta as in
    BACKLASH_WAVES. A mean below zero, which noise makes of a gear without backlash, is 0.
    """
    out = {"backlash": np.maximum(mean_deg, 0.0)}
    cosine, sine = np.moveaxis(coefficients_deg, -1, 0)
    for k, name in enumerate(BACKLASH_WAVES):
        out[name] = np.hypot(cosine[..., k], sine[..., k])
        out[f"{name}_phase"] = np.arctan2(cosine[..., k], sine[..., k])
    return out


def fitted_waves(theta_deg: Floats, backlash_deg: Floats) -> dict[str, float]:
    """The firmware's parameters (motor deg, phases rad) of a backlash measured over theta, by least squares.

    `theta_deg` (K,) and `backlash_deg` (K,) motor degrees: K well above the nine numbers sought, over most of
    a turn, closer than half a tooth pairing.
    """
    theta = np.deg2rad(theta_deg)
    columns = [np.ones_like(theta)]
    for m in BACKLASH_WAVES.values():
        columns += [np.cos(m * theta), np.sin(m * theta)]
    # half a turn (beta) leaves slow waves free to be large where nothing was measured: 1e-4 of the
    # points' weight holds them
    held = 0.01 * np.sqrt(len(theta)) * np.diag([0.0] + [1.0] * (len(columns) - 1))
    matrix = np.vstack([np.stack(columns, axis=1), held])
    found = np.linalg.lstsq(matrix, np.append(backlash_deg, np.zeros(len(held))), rcond=None)[0]
    known = wave_parameters(found[0], found[1:].reshape(-1, 2))
    return {name: float(value) for name, value in known.items()}
