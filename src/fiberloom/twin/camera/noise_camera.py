"""A camera without an image: true positions with noise."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import METROLOGY
from fiberloom.metrology import Measurement
from fiberloom.twin.camera.air import air_shift_mm
from fiberloom.twin.errors.frame import WrongFrame
from fiberloom.twin.errors.sizes import AIR_LENGTH_MM, NO_ERRORS, TwinErrors
from fiberloom.typing import Flags, Floats


class Fibres(Protocol):
    """What a camera needs of a twin, whatever its motors."""

    plane: FocalPlane
    dark: Flags
    """(N,)."""

    @property
    def time_s(self) -> float:
        """Virtual time."""
        ...

    def fibre_xy(self, fibre: str = METROLOGY) -> Floats:
        """True position (N, 2) in mm of a fibre."""
        ...


class NoiseCamera:
    """Sees the metrology fibres with Gaussian noise; `rms_um` is the two-dimensional rms.

    Kronig 2020, Fig. 18: 0.669 um over the full workspace, 0.101 um close up. Dark fibres are not
    seen. Implements `fiberloom.metrology.Camera`.
    """

    def __init__(self, twin: Fibres, rms_um: float, seed: int = 0, errors: TwinErrors = NO_ERRORS) -> None:
        """`twin`: whose fibres; `errors`, um rms: of the fiducials' table and the air."""
        self._twin, self._plane, self._air_um = twin, twin.plane, errors.air_um
        self._fiducials_mm = errors.fiducials_mm(twin.plane, seed)
        self._frame = WrongFrame(self._plane, self._fiducials_mm)
        self._sigma_mm = rms_um * 1e-3 / np.sqrt(2.0)
        self._rng = np.random.default_rng([seed, 0xCA3E])

    def measure(self, expected_mm: Floats | None = None) -> Measurement:
        """Takes an image now; it knows without a match which spot belongs to which positioner."""
        true_mm = self._twin.fibre_xy(METROLOGY)
        at_mm = self._through_the_air(true_mm)
        noisy_mm = at_mm + self._rng.normal(0.0, self._sigma_mm, true_mm.shape)
        seen = ~(self._twin.dark | np.isnan(true_mm[:, 0]))
        x, y = np.where(seen[:, None], noisy_mm, np.nan).T
        return Measurement(x, y, seen, self._twin.time_s)

    def know_fiducials(self, fiducials_mm: Floats) -> None:
        """From now on its host takes fiducials to be at (F, 2) mm: as a calibration has found them."""
        known = np.column_stack([fiducials_mm, self._plane.fiducials[:, 2:]])
        self._plane = replace(self._plane, fiducials=known)
        self._frame = WrongFrame(self._plane, self._fiducials_mm)

    def _through_the_air(self, true_mm: Floats) -> Floats:
        """(N, 2) mm as a host has them that fits its frame on fiducials in the same air."""
        if self._air_um == 0.0:
            return self._frame.seen_mm(true_mm)
        at_mm = np.vstack([true_mm, self._fiducials_mm])
        at_mm = at_mm + air_shift_mm(at_mm, self._air_um, AIR_LENGTH_MM, self._rng)
        fibres_mm, fiducials_mm = np.split(at_mm, [len(true_mm)])
        return WrongFrame(self._plane, fiducials_mm).seen_mm(fibres_mm)
