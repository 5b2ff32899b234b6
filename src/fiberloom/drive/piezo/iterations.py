"""One iteration: what is sent to all cobras at once; and the rule of the instrument's own software."""

from dataclasses import dataclass

import numpy as np

from fiberloom.drive.piezo.maps import MotorMaps, direction_of
from fiberloom.typing import Flags, Floats, Ints

MOST_STEPS = 2000
"""Of a motor in one move."""
MOST_PULSE_US = 140.0
SCALED_BEYOND_STEPS = 10
"""Moves of more steps tell how far off a pulse is (cobraCoach)."""
SCALED_BY = 0.25
SCALE_RANGE = (0.3, 2.0)


@dataclass(frozen=True)
class MotorSteps:
    """One RUN for M motors."""

    steps: Ints
    """(M,) signed."""
    pulse_us: Floats
    """(M,) whole us."""


class SpeedScalingLaw:
    """The published rule of PFS (cobraCoach): steps by the maps, pulses scaled by the last move.

    After a move of more than 10 steps the pulse of that motor and direction is scaled by
    1 + (expected / moved - 1) / 4, kept within 0.3 to 2.0 of the usual one.
    """

    def __init__(self, maps: MotorMaps) -> None:
        self.maps = maps
        self.scale = np.ones((maps.motors, 2))
        self._last: tuple[Floats, Ints, Floats] | None = None

    def command(self, seen_deg: Floats, goal_deg: Floats, sigma_deg: Floats, active: Flags) -> MotorSteps:
        """What to send.

        `seen_deg` and `goal_deg` (M,): angles seen and wanted; `sigma_deg` (M,): not used; `active` (M,):
        motors that shall move; the others get no steps.
        """
        self._learn(seen_deg)
        way = np.where(active, goal_deg - seen_deg, 0.0)
        wanted = np.clip(self.maps.steps(seen_deg, way), -MOST_STEPS, MOST_STEPS)
        steps = np.rint(wanted).astype(np.int64)
        rows, direction = np.arange(self.maps.motors), direction_of(way)
        pulse = self.maps.pulse_us[rows, direction] * self.scale[rows, direction]
        self._last = seen_deg.copy(), steps, self.maps.way_deg(seen_deg, steps.astype(np.float64))
        return MotorSteps(steps, np.minimum(np.rint(pulse), MOST_PULSE_US))

    def _learn(self, seen_deg: Floats) -> None:
        if self._last is None:
            return
        before, steps, expected = self._last
        moved = seen_deg - before
        told = np.flatnonzero((np.abs(steps) > SCALED_BEYOND_STEPS) & (moved * expected > 0.0))
        ratio = expected[told] / moved[told]
        at = told, direction_of(expected)[told]
        self.scale[at] = np.clip(self.scale[at] * (1.0 + SCALED_BY * (ratio - 1.0)), *SCALE_RANGE)
