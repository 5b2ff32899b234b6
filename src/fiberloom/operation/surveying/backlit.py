"""Science fibres lit from behind, looked at in one image with the metrology fibres of a survey."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from fiberloom.calibration.fibres.backlit import arms_deg
from fiberloom.errors import InputError
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.metrology import Measurement
from fiberloom.operation.motion import FieldMotion
from fiberloom.typing import Floats

_NEAR_MM = 0.2
"""A light so near to where the layout has the fibre is it. Fibres of one arm are farther apart."""


class Backlit:
    """Looks at science fibres, configuration by configuration."""

    def __init__(
        self, plane: FocalPlane, camera: Any, lamp: Callable[[str], None], fibres: tuple[str, ...]
    ) -> None:
        """`plane`: layout of N positioners; `camera`: of the survey; `lamp`: lights a fibre by its name, ""
        none; `fibres`: names. InputError where the camera takes no images."""
        if fibres and not hasattr(camera, "light"):
            raise InputError("this camera takes no images: it cannot see fibres that are lit from behind")
        self._plane, self._camera, self._lamp = plane, camera, lamp
        self._apart: dict[str, list[Floats]] = {fibre: [] for fibre in fibres}

    async def look(self, motion: FieldMotion, theta_deg: Floats) -> None:
        """An image of each fibre; `motion`: of the field, at rest at angles `theta_deg` (N, 2)."""
        for fibre, rows in self._apart.items():
            await asyncio.to_thread(self._light, fibre)
            try:
                seen = await motion.eye.patiently(motion.state.metrology_mm(motion.state.here_deg))
            finally:
                await asyncio.to_thread(self._light, "")
            rows.append(self._apart_mm(fibre, seen, theta_deg))

    def apart_mm(self) -> Mapping[str, Floats]:
        """By fibre (N, S, 2) mm: from the metrology to the science fibre; NaN where one was not seen."""
        return {fibre: np.stack(rows, axis=1) for fibre, rows in self._apart.items()}

    def _light(self, fibre: str) -> None:
        self._lamp(fibre)
        self._camera.light(fibre)

    def _apart_mm(self, fibre: str, seen: Measurement, theta_deg: Floats) -> Floats:
        plane = self._plane
        lever = (plane.points[fibre] - plane.points[METROLOGY]) @ np.array([1.0, 1.0j])
        there = lever * np.exp(1j * np.deg2rad(arms_deg(plane, theta_deg)))
        expected_mm = seen.xy_mm + np.column_stack([there.real, there.imag])
        apart = np.full((len(plane), 2), np.nan)
        known = np.flatnonzero(np.isfinite(expected_mm).all(axis=1))
        if seen.loose_mm is None or not len(seen.loose_mm) or not len(known):
            return apart
        off_mm, spot = cKDTree(seen.loose_mm).query(expected_mm[known], distance_upper_bound=_NEAR_MM)
        near = np.isfinite(off_mm)
        # a light that two arms may claim is neither's
        alone = near & (np.bincount(spot[near], minlength=len(seen.loose_mm) + 1)[spot] == 1)
        rows = known[alone]
        apart[rows] = seen.loose_mm[spot[alone]] - seen.xy_mm[rows]
        return apart
