"""Weights on the arms of a twin: implements `fiberloom.calibration.bench.bench.Bench`."""

from __future__ import annotations

import numpy as np

from fiberloom.twin.twin import Twin

NM_PER_MNM = 1e-3


class TwinWeights:
    """Hangs torques on arms. Each arm's weight is off by its own share, drawn once.

    tolerance: relative standard deviation of that; 0.3 % is a good weight on a good lever (assumed).
    """

    def __init__(self, twin: Twin, tolerance: float = 0.003, seed: int = 0) -> None:
        self.tolerance = tolerance
        self._twin = twin
        rng = np.random.default_rng([seed, 0x7EA6])
        self._share = 1.0 + tolerance * rng.standard_normal((len(twin.plane), 2))

    def apply_torque(self, positioner_id: int, axis: int, torque_mNm: float) -> None:
        """Holds until the next call."""
        row = int(self._twin.plane.index_of(positioner_id))
        true_Nm = torque_mNm * NM_PER_MNM * float(self._share[row, axis])
        self._twin.set_external_torque(row, axis, true_Nm)
