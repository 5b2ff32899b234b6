"""Motor maps: how far a step of a stick-slip motor goes, by place, direction and pulse."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fiberloom.errors import InputError
from fiberloom.typing import Floats, Ints

FORWARD, REVERSE = 0, 1
"""Away from the counter-clockwise stop, and back."""

PULSE_CURVE_US = (88.0, 72.0)
"""p1 of theta and phi in us: a step of pulse t goes as sqrt(t^2 + p1^2) - p1 (cobraCharmer, speedModel)."""


def pulse_factor(pulse_us: Floats, usual_us: Floats, curve_us: Floats) -> Floats:
    """How much farther a step goes by a pulse than by the usual one; all in us, shapes that broadcast."""
    farther: Floats = (np.hypot(pulse_us, curve_us) - curve_us) / (np.hypot(usual_us, curve_us) - curve_us)
    return farther


def direction_of(way: Floats) -> Ints:
    """FORWARD or REVERSE of a signed `way`, in deg or steps, of any shape."""
    return np.where(way < 0.0, REVERSE, FORWARD)


@dataclass(frozen=True)
class MotorMaps:
    """Maps of M motors with B bins of equal width, counted from the counter-clockwise stop at 0 deg."""

    step_deg: Floats
    """(M, 2, B) deg per step forward and reverse, above 0."""
    bin_deg: float
    """Width of a bin."""
    pulse_us: Floats
    """(M, 2) length of the pulse for which the map holds."""

    def __post_init__(self) -> None:
        motors = len(self.step_deg)
        if self.step_deg.ndim != 3 or self.step_deg.shape[1] != 2 or self.pulse_us.shape != (motors, 2):
            raise InputError(
                f"motor maps: steps {self.step_deg.shape} and pulses {self.pulse_us.shape}; "
                "(M, 2, bins) and (M, 2) are needed"
            )
        bad = np.argwhere(~(np.isfinite(self.step_deg) & (self.step_deg > 0.0)))
        if len(bad):
            motor, direction, bin_ = bad[0]
            raise InputError(
                f"motor maps: motor {motor}, {('forward', 'reverse')[direction]}, bin {bin_}: "
                f"{self.step_deg[motor, direction, bin_]} deg per step; it must be above 0"
            )

    @property
    def motors(self) -> int:
        """M."""
        return len(self.step_deg)

    @cached_property
    def _steps_to_edge(self) -> Floats:
        """(M, 2, B + 1) steps from the stop to each edge."""
        sums = np.cumsum(self.bin_deg / self.step_deg, axis=2)
        return np.concatenate([np.zeros((*sums.shape[:2], 1)), sums], axis=2)

    def steps(self, start_deg: Floats, way_deg: Floats) -> Floats:
        """(M,) steps, signed and not rounded, of signed ways (M,) from angles (M,) in deg."""
        direction = direction_of(way_deg)
        taken: Floats = self._counted(start_deg + way_deg, direction) - self._counted(start_deg, direction)
        return taken

    def way_deg(self, start_deg: Floats, steps: Floats) -> Floats:
        """(M,) signed ways in deg of signed steps (M,) from angles (M,) in deg."""
        direction = direction_of(steps)
        rows = np.arange(self.motors)
        wanted = self._counted(start_deg, direction) + steps
        edges = self._steps_to_edge[rows, direction]
        bins = np.clip((edges <= wanted[:, None]).sum(axis=1) - 1, 0, self.step_deg.shape[2] - 1)
        rest = wanted - edges[rows, bins]
        end: Floats = bins * self.bin_deg + rest * self.step_deg[rows, direction, bins]
        return end - start_deg

    def step_at(self, angle_deg: Floats, direction: Ints) -> Floats:
        """(M,) deg per step at angles (M,) in directions (M,)."""
        return self.step_deg[np.arange(self.motors), direction, self._bins(angle_deg)]

    def _counted(self, angle_deg: Floats, direction: Ints) -> Floats:
        """(M,) steps from the stop; beyond the map as in its outermost bins."""
        rows, bins = np.arange(self.motors), self._bins(angle_deg)
        rest: Floats = (angle_deg - bins * self.bin_deg) / self.step_deg[rows, direction, bins]
        return self._steps_to_edge[rows, direction, bins] + rest

    def _bins(self, angle_deg: Floats) -> Ints:
        last = self.step_deg.shape[2] - 1
        return np.clip(np.floor(angle_deg / self.bin_deg).astype(np.int64), 0, last)
