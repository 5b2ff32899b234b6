"""Offsets of science fibres that shine: lit from behind, and seen in one image with the metrology fibres.

Both fibres of an arm are less than a millimetre apart. Air, lens and fiducials shift them alike, and their
difference, turned into the frame of the arm, is that of the layout and the offset. No star is needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fiberloom.calibration.fibres.offsets import MOST_MM, FibreOffsets
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import MM_PER_UM, rad_to_deg

_FEWEST = 3
"""Images that show a fibre."""
_FAR = 6.0
"""Times the usual scatter, beyond which a spot is another light."""
_LEAST_UM = 0.1
"""Of a standard error, per coordinate."""


def arms_deg(plane: FocalPlane, theta_deg: Floats) -> Floats:
    """Directions (N, ...) of the beta arms of a `plane` at angles (N, ..., 2), in the focal plane, deg."""
    zero = rad_to_deg(plane.alpha_off_rad + plane.beta_off_rad)
    turned: Floats = theta_deg.sum(axis=-1) + zero.reshape(-1, *([1] * (theta_deg.ndim - 2)))
    return turned


def offsets_of_backlit(plane: FocalPlane, theta_deg: Floats, apart_mm: Mapping[str, Floats]) -> FibreOffsets:
    """Offsets of all fibres that were lit.

    Parameters
    ----------
    plane : FocalPlane
        The layout, N positioners, with the zeros of its arms as calibrated.
    theta_deg : (N, S, 2) float
        Angles of the configurations by the maps, deg.
    apart_mm : mapping of str to (N, S, 2) float
        By fibre: from the metrology to the science fibre in one image, mm; NaN where one was not seen.

    Returns
    -------
    FibreOffsets
        Of each fibre that a positioner carries; a reason where it was seen too seldom.
    """
    turn = np.exp(-1j * np.deg2rad(arms_deg(plane, theta_deg)))
    parts: list[_Columns] = []
    for fibre, apart in sorted(apart_mm.items()):
        z = apart @ np.array([1.0, 1.0j]) * turn
        lever = plane.points[fibre] - plane.points[METROLOGY]
        off = np.stack([z.real, z.imag], axis=-1) - lever[:, None]
        parts.append(_of_fibre(plane, fibre, off, lever))
    names = [
        np.full(len(part.positioner_id), fibre) for fibre, part in zip(sorted(apart_mm), parts, strict=True)
    ]
    return FibreOffsets(
        positioner_id=np.concatenate([part.positioner_id for part in parts]),
        fibre=np.concatenate(names),
        offset_mm=np.concatenate([part.offset_mm for part in parts]),
        covariance_mm2=np.concatenate([part.covariance_mm2 for part in parts]),
        lever_mm=np.concatenate([part.lever_mm for part in parts]),
        n_fields=np.concatenate([part.n_images for part in parts]),
        reason=np.array([reason for part in parts for reason in part.reason], dtype=np.str_),
    )


@dataclass(frozen=True, eq=False)
class _Columns:
    """Of one fibre, a row for each positioner that carries it: as in FibreOffsets."""

    positioner_id: Ints
    offset_mm: Floats
    covariance_mm2: Floats
    lever_mm: Floats
    n_images: Ints
    reason: list[str]


def _of_fibre(plane: FocalPlane, fibre: str, off_mm: Floats, lever_mm: Floats) -> _Columns:
    """Of (N, S, 2) by which a fibre was seen beside where the layout has it, mm, in the frame of its arm."""
    rows = np.flatnonzero(plane.carries(fibre))
    off = off_mm[rows]
    used: Flags = np.asarray(np.isfinite(off[..., 0]))
    shown: Flags = np.asarray(used.any(axis=1), dtype=np.bool_)
    middle = np.nanmedian(np.where(shown[:, None, None], off, 0.0), axis=1)
    far = np.where(used, np.hypot(*np.moveaxis(off - middle[:, None], -1, 0)), np.inf)
    usual = float(np.median(far[used])) if used.any() else 0.0
    used = used & (far <= _FAR * usual)
    count = used.sum(axis=1)
    mean = np.where(used[..., None], off, 0.0).sum(axis=1) / np.maximum(count, 1)[:, None]
    left = np.where(used[..., None], off - mean[:, None], 0.0)
    # per coordinate, the same for all: so few images of one fibre do not tell its own
    freedom = 2 * int(np.maximum(count - 1, 0).sum())
    variance = float((left**2).sum()) / max(freedom, 1)
    each = np.maximum(variance / np.maximum(count, 1), (_LEAST_UM * MM_PER_UM) ** 2)
    reason = [_why(int(n), one) for n, one in zip(count, mean, strict=True)]
    bad = np.array([bool(r) for r in reason], dtype=bool)
    covariance = each[:, None, None] * np.eye(2)
    covariance[bad] = np.nan
    mean = np.where(bad[:, None], 0.0, mean)
    return _Columns(plane.positioner_id[rows], mean, covariance, lever_mm[rows], count, reason)


def _why(count: int, offset_mm: Floats) -> str:
    if count < _FEWEST:
        return f"seen in {count} images, {_FEWEST} needed"
    return "" if np.abs(offset_mm).max() <= MOST_MM else "its light is farther off than any fibre was glued"
