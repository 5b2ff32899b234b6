"""By how much the camera's frame is off, place by place: its fiducials are not where their table says.

The transformation goes through the fiducials as nearly as its Zhao-Burge terms allow, so that what is wrong
with their table shows at the fibres as a field of these very terms, the same in every image. What the lens
bends beyond them (in the cold, for one) is as fixed: hundreds of stars tell terms that so few fiducials
cannot. Shift, rotation and scale of it are the guider's, which puts the stars there: they are left out.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import zhao_burge
from fiberloom.typing import Floats
from fiberloom.units import MM_PER_UM

TERMS = tuple(t for t in range(zhao_burge.N_WIDE_TERMS) if t not in zhao_burge.SIMILARITY_TERMS)
OF_CAMERA = zhao_burge.N_TERMS - len(zhao_burge.SIMILARITY_TERMS)
"""The first terms, those of a camera; files from before the others have no more."""
FRAME_UM, FAR_UM = 1.5, 0.5
"""Rms that a term of the camera's frame is expected to have: 61 fiducials of 8 um make 1 um of each; and a
term of what the lens has beyond them."""
_MOST_UM = 1000.0
"""Of a term: beyond it no image would have been matched."""
_MOST_RADIUS_MM = 1e4


@dataclass(frozen=True, eq=False)
class FrameOffset:
    """True place less the place that the camera tells, sum_k c_k V_k(x / R).

    Raises
    ------
    InputError
        Numbers that cannot be one.
    """

    radius_mm: float
    """R: it scales the terms."""
    size_um: Floats
    """(53,) c: rms over the disc of radius R of each of the `TERMS`."""
    covariance_um2: Floats
    """(53, 53) of it."""

    def __post_init__(self) -> None:
        n = len(TERMS)
        if not 0.0 < self.radius_mm <= _MOST_RADIUS_MM:
            raise InputError(f"camera frame: a radius of {self.radius_mm:g} mm")
        if self.size_um.shape != (n,) or not (np.abs(self.size_um) <= _MOST_UM).all():
            raise InputError(f"camera frame: not {n} sizes within {_MOST_UM:g} um")
        wide = self.covariance_um2
        if wide.shape != (n, n) or not np.isfinite(wide).all() or not np.allclose(wide, wide.T):
            raise InputError("camera frame: its covariance is none")
        if not (np.linalg.eigvalsh(wide) > 0.0).all():
            raise InputError("camera frame: its covariance is none")

    def at_mm(self, xy_mm: Floats) -> Floats:
        """(N, 2) mm: what is to be added to the places (N, 2) that the camera tells."""
        added: Floats = np.einsum("k,knc->nc", MM_PER_UM * self.size_um, self.basis(xy_mm, self.radius_mm))
        return added

    @staticmethod
    def basis(xy_mm: Floats, radius_mm: float) -> Floats:
        """(53, N, 2) the terms at places (N, 2), of no unit: um per um."""
        return zhao_burge.basis(xy_mm / radius_mm, TERMS)

    @property
    def rms_um(self) -> float:
        """Over the disc."""
        return float(np.sqrt((self.size_um**2).sum()))

    def to_meta(self) -> dict[str, Any]:
        """By name, with a sum over the numbers."""
        numbers = {
            "terms": list(TERMS),
            "radius_mm": self.radius_mm,
            "size_um": self.size_um.tolist(),
            "covariance_um2": self.covariance_um2.tolist(),
        }
        return numbers | {"sum": _sum(numbers)}

    def to_text(self) -> str:
        """For the head of a file: JSON. As YAML its 3000 numbers take longer to read than all else of it."""
        return json.dumps(self.to_meta())

    @classmethod
    def of_text(cls, text: str) -> FrameOffset:
        """Of the head of a file; InputError for one that holds nonsense."""
        try:
            meta = json.loads(text)
        except ValueError as error:
            raise InputError(f"camera frame: {error}") from None
        return cls.of_meta(meta)

    @classmethod
    def of_meta(cls, meta: Any) -> FrameOffset:
        """Of what `to_meta` gives; InputError for nonsense."""
        if not isinstance(meta, Mapping):
            raise InputError("camera frame: no table of its numbers")
        terms = meta.get("terms")
        if terms not in (list(TERMS), list(TERMS[:OF_CAMERA])):
            raise InputError(f"camera frame: its terms are not {', '.join(map(str, TERMS))}")
        if meta.get("sum") != _sum({name: value for name, value in meta.items() if name != "sum"}):
            raise InputError("camera frame: its numbers are not as they were written")
        try:
            size, wide = (np.array(meta[name], dtype=np.float64) for name in ("size_um", "covariance_um2"))
            if len(terms) == OF_CAMERA:
                size, wide = _widened(size, wide)
            return cls(float(meta["radius_mm"]), size, wide)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"camera frame: {error}") from None

    @classmethod
    def mean(cls, nights: list[FrameOffset]) -> FrameOffset:
        """Of several nights, by inverse covariance; InputError where their radius differs."""
        if any(night.radius_mm != nights[0].radius_mm for night in nights):
            raise InputError("camera frame: the nights are of different layouts")
        weights = [np.linalg.inv(night.covariance_um2) for night in nights]
        wide: Floats = np.linalg.inv(np.sum(weights, axis=0))
        pulled = sum(w @ night.size_um for w, night in zip(weights, nights, strict=True))
        return cls(nights[0].radius_mm, wide @ pulled, wide)


def _widened(size_um: Floats, covariance_um2: Floats) -> tuple[Floats, Floats]:
    """With the terms beyond a camera's, of which nothing is known."""
    more = len(TERMS) - OF_CAMERA
    if size_um.shape != (OF_CAMERA,) or covariance_um2.shape != (OF_CAMERA, OF_CAMERA):
        raise ValueError(f"not {OF_CAMERA} sizes")
    wide = np.zeros((len(TERMS), len(TERMS)))
    wide[:OF_CAMERA, :OF_CAMERA] = covariance_um2
    wide[OF_CAMERA:, OF_CAMERA:] = FAR_UM**2 * np.eye(more)
    return np.concatenate([size_um, np.zeros(more)]), wide


def _sum(numbers: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(numbers, sort_keys=True, default=str).encode()).hexdigest()[:16]


def radius_of(plane: FocalPlane) -> float:
    """mm: the whole disc in which fibres of a layout can be, of whole numbers so that files agree."""
    reach_mm = np.hypot(*plane.centres_mm.T) + plane.body_reach_mm
    return float(np.ceil(reach_mm.max()))
