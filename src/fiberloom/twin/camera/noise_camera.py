"""A camera without an image: true positions with noise."""

from __future__ import annotations

import numpy as np

from fiberloom.instruments.model import METROLOGY
from fiberloom.metrology import Measurement
from fiberloom.twin.errors.frame import WrongFrame
from fiberloom.twin.twin import Twin
from fiberloom.typing import Floats


class NoiseCamera:
    """Sees the metrology fibres with Gaussian noise; `rms_um` is the two-dimensional rms.

    Kronig 2020, Fig. 18: 0.669 um over the full workspace, 0.101 um close up. Dark fibres are not
    seen. Implements `fiberloom.metrology.Camera`.
    """

    def __init__(self, twin: Twin, rms_um: float, seed: int = 0, frame: WrongFrame | None = None) -> None:
        """`twin`: whose fibres; `frame`: what wrong fiducials make of positions; none: they are right."""
        self._twin, self._frame = twin, frame
        self._sigma_mm = rms_um * 1e-3 / np.sqrt(2.0)
        self._rng = np.random.default_rng([seed, 0xCA3E])

    def measure(self, expected_mm: Floats | None = None) -> Measurement:
        """Takes an image now; it knows without a match which spot belongs to which positioner."""
        true_mm = self._twin.fibre_xy(METROLOGY)
        at_mm = true_mm if self._frame is None else self._frame.seen_mm(true_mm)
        noisy_mm = at_mm + self._rng.normal(0.0, self._sigma_mm, true_mm.shape)
        seen = ~(self._twin.dark | np.isnan(true_mm[:, 0]))
        x, y = np.where(seen[:, None], noisy_mm, np.nan).T
        return Measurement(x, y, seen, self._twin.time_s)
