"""Which configurations tell most about the arms: sequential A-optimal design.

For each positioner the information so far is a matrix; a candidate is worth the sum of variances
(centre and lengths in mm^2, zeros times the arm's length) that measuring it takes away.
"""

from __future__ import annotations

import numpy as np

from fiberloom.calibration.focal_plane.fit import (
    N_GEOMETRY,
    FitSettings,
    layout_parameters,
    measurement_covariance,
    model,
)
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats

_FIRST_GUESS = np.array([0.1, 0.1, 0.1, 0.1, 0.01, 0.01])
"""mm and rad by which a layout may be off before anything is measured."""
_NEAR_DEG = 2.0
"""Near enough to the ends of beta to be stretched and folded."""
LEAST_BEND_DEG = 60.0
"""A stretched arm determines the lengths best, but where many are stretched at once there is hardly any
path left: planning 500 from one such configuration to the next took minutes, and seconds without."""
_ARM_MM = 10.0
"""Turns errors of the zeros into lengths."""


class Design:
    """Information of N positioners, and what more would be worth."""

    def __init__(self, plane: FocalPlane, settings: FitSettings | None = None) -> None:
        self._settings = settings or FitSettings(camera_um=plane.instrument.metrology.noise_rms_um)
        self._p = layout_parameters(plane)
        self._phi = plane.metrology_phi_rad
        self.information = np.tile(np.diag(_FIRST_GUESS**-2.0), (plane.n, 1, 1))
        """(N, 6, 6)"""

    def worth(self, theta_deg: Floats) -> Floats:
        """(N, C) mm^2 of variance that each candidate (N, C, 2) would take away."""
        white = self._whitened(theta_deg)
        spread = np.linalg.inv(self.information)
        felt = white @ spread[:, None]  # (N, C, 2, 6)
        inverse = np.linalg.inv(np.eye(2) + felt @ white.swapaxes(-1, -2))
        weighed = felt * np.array([1.0, 1.0, 1.0, 1.0, _ARM_MM**2, _ARM_MM**2])
        gain: Floats = np.einsum("ncij,nckj,ncik->nc", weighed, felt, inverse, optimize=True)
        return gain

    def add(self, theta_deg: Floats, seen: Flags) -> None:
        """Counts what was measured at (N, 2)."""
        white = self._whitened(theta_deg[:, None])[:, 0] * seen[:, None, None]
        self.information += white.swapaxes(-1, -2) @ white

    def sigma(self) -> Floats:
        """(N, 6) expected standard errors, mm and rad."""
        errors: Floats = np.sqrt(np.einsum("nii->ni", np.linalg.inv(self.information)))
        return errors

    def _whitened(self, theta_deg: Floats) -> Floats:
        _, slopes = model(self._p, theta_deg, self._phi)
        noise = measurement_covariance(slopes, self._settings.camera_um, self._settings.angles_deg)
        return np.linalg.solve(np.linalg.cholesky(noise), slopes[..., :N_GEOMETRY])


def candidates(
    plane: FocalPlane,
    rng: np.random.Generator,
    turns: int = 20,
    bends: int = 9,
    least_bend_deg: float = LEAST_BEND_DEG,
) -> Floats:
    """(N, C, 2) deg: angles over the range of targets of the `plane`, both ends among them.

    `turns` values of alpha times `bends` of beta, which is at least `least_bend_deg`. All are shifted
    at random (`rng`), so that no two fields use the map at the same angles.
    """
    (low_a, high_a), (low_b, high_b) = plane.limits_deg
    low_b = min(max(low_b, least_bend_deg), high_b - _NEAR_DEG)
    step_a, step_b = (high_a - low_a) / turns, (high_b - low_b) / (bends - 1)
    alpha = low_a + step_a * (np.arange(turns) + rng.uniform(0.0, 1.0, (plane.n, 1)))
    inner = low_b + step_b * (np.arange(1, bends) - rng.uniform(0.0, 1.0, (plane.n, 1)))
    ends = [low_b + rng.uniform(0, _NEAR_DEG, (plane.n, 1)), high_b - rng.uniform(0, _NEAR_DEG, (plane.n, 1))]
    beta = np.concatenate([ends[0], inner, ends[1]], axis=1)
    grid = np.empty((plane.n, turns, beta.shape[1], 2))
    grid[..., 0], grid[..., 1] = alpha[:, :, None], beta[:, None]
    return grid.reshape(plane.n, -1, 2)
