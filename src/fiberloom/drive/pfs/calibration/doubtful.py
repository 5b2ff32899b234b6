"""Cobras that by their own calibration cannot be counted on to arrive: to be left out, or mended.

A move that misses by a share s of its way leaves s / sqrt(1 + s^2) of the distance at best (rms; the aim of
`LearningLaw.aimed_deg`). From the reach R to a distance e that takes at least

    2 ln(R / e) / ln(1 + 1 / s^2)

moves. A motor that needs more than an instrument makes cannot be counted on, and one of which the calibration
says that it has failed cannot either. What a field brings, or the twin knows, is not asked.
"""

import numpy as np

from fiberloom.drive.pfs.calibration.maps import ODD_STEPS
from fiberloom.drive.pfs.calibration.measure import CobraCalibration
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM

NAMES = ("theta", "phi")


def least_moves(share: Floats, reach_mm: Floats, within_um: float) -> Floats:
    """(M,) moves, dimensionless, that motors need at least; 0 where the scatter is not known (NaN).

    `share` (M,): rms by which moves miss, of their way; `reach_mm` (M,): the distance at first; `within_um`
    of its target a fibre has arrived.
    """
    known = np.where(np.isfinite(share) & (share > 0.0), share, 1e-9)
    moves: Floats = 2.0 * np.log(reach_mm * UM_PER_MM / within_um) / np.log1p(1.0 / known**2)
    return moves


def doubtful(found: CobraCalibration, reach_mm: Floats, within_um: float, moves: int) -> dict[int, str]:
    """Rows of the n cobras that cannot be counted on to arrive in so many `moves`, and why.

    `found` by the calibration; `reach_mm` (n,) of the arms; `within_um` of its target a fibre has arrived.
    """
    scatter = found.motors.scatter
    needed = least_moves(scatter, np.repeat(reach_mm, 2), within_um)
    why: dict[int, str] = {}
    for motor, reason in enumerate(found.motors.reason):
        row, axis = divmod(motor, 2)
        if ODD_STEPS in reason:
            why.setdefault(row, f"{NAMES[axis]}: {reason}")
        elif needed[motor] > moves:
            text = f"moves miss by {scatter[motor]:.2f} of their way: {np.ceil(needed[motor]):.0f} moves"
            why.setdefault(row, f"{NAMES[axis]}: {text} are needed, {moves} are made")
    return why
