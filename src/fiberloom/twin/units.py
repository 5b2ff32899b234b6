"""The true units of a twin: plant parameters, gears, and what their firmware was told of them."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fiberloom._core import twin as _core
from fiberloom.bus.parameters import PARAMETERS_DTYPE
from fiberloom.errors import InputError
from fiberloom.instruments.model import METROLOGY
from fiberloom.twin.errors.loads import LOAD_DTYPE, LOADING
from fiberloom.typing import Array, Floats, Ints, Records
from fiberloom.units import GEAR

ORDERS = np.array(_core.HARMONIC_ORDERS)
"""Cycles per output turn of the harmonic series of a gear."""

MARKS = _core.WEAR_COUNT
"""Local marks that a gear can have."""

PLANT_DTYPE = np.dtype([(p[0], np.float64) for p in _core.PLANT_PARAMS])
FIRMWARE_DTYPE = PARAMETERS_DTYPE
GEAR_DTYPE = np.dtype(
    [
        ("delta_rad", np.float64, (len(ORDERS), 2)),  # output angle: cosine, sine
        ("backlash_rad", np.float64, (len(ORDERS), 2)),  # motor angle: cosine, sine
        ("backlash_mean_rad", np.float64),
        ("wear", np.float64, (MARKS, 3)),  # centre, width, height, output rad
    ]
)
assert GEAR_DTYPE.itemsize == 8 * _core.TRANSMISSION_SIZE


def defaults(params: list[tuple[Any, ...]], dtype: np.dtype[np.void]) -> Records:
    """One record with every parameter at its default."""
    return np.array(tuple(p[4] for p in params), dtype=dtype)


def plain(records: Records, kind: type = np.float64) -> Array:
    """The same numbers without names, in their own units (SI): one more axis, contiguous."""
    flat: Array = np.ascontiguousarray(records).view(kind)
    return flat.reshape(*records.shape, -1)


@dataclass(frozen=True, eq=False)
class Units:
    """N units; axis 0 of the second dimension is alpha, 1 is beta. SI and rad, as in the plant."""

    plant: Records
    """(N, 2) PLANT_DTYPE: the truth."""
    gear: Records
    """(N, 2) GEAR_DTYPE: the true transmission, Kronig 2020 Eq. 7, as harmonic series."""
    firmware: Records
    """(N, 2) FIRMWARE_DTYPE: what the firmware believes, truth with identification errors."""
    arms: Floats
    """(N, 5) true arms: columns of FocalPlane.arms."""
    seed: int = 0
    number: Ints = field(default_factory=lambda: np.empty(0, np.int64))
    """(N,) by which wear and faults know a unit: the positioner's; the row where none is given."""
    beta_longer_mm: Floats = field(default_factory=lambda: np.empty(0))
    """(N,) by which every point of the beta arm lies farther out than the layout says."""
    fibre_offset_mm: Mapping[str, Floats] = field(default_factory=dict)
    """By fibre, (N, 2) in the frame of the beta arm: where it is beyond that, less where the layout says."""
    load: Records = field(default_factory=lambda: np.empty(0, LOAD_DTYPE))
    """(N, 2) LOAD_DTYPE: what pulls at the arms; zeros where nothing does."""

    def __post_init__(self) -> None:
        n = len(self.plant)
        nothing = np.zeros((n, 2), LOAD_DTYPE)
        for name, default in (("number", np.arange(n)), ("beta_longer_mm", np.zeros(n)), ("load", nothing)):
            if not len(getattr(self, name)):
                object.__setattr__(self, name, default)
        for name, shape in {
            "plant": (n, 2),
            "gear": (n, 2),
            "firmware": (n, 2),
            "arms": (n, 5),
            "number": (n,),
            "beta_longer_mm": (n,),
            "load": (n, 2),
        }.items():
            if getattr(self, name).shape != shape:
                raise InputError(
                    f"units: {name} has shape {getattr(self, name).shape}, {n} units need {shape}"
                )
        for name, offset_mm in self.fibre_offset_mm.items():
            if offset_mm.shape != (n, 2):
                raise InputError(f"units: offsets of {name} have shape {offset_mm.shape}, not {(n, 2)}")

    @property
    def loaded(self) -> bool:
        """Whether anything pulls at an arm."""
        return bool(plain(self.load)[..., LOADING].any())

    def __len__(self) -> int:
        return len(self.plant)

    def digest(self) -> str:
        """16 hex digits that change with any number of any unit."""
        digest = hashlib.sha256()
        own = (self.plant, self.gear, self.firmware, self.arms, self.beta_longer_mm)
        for values in (*own, *(self.fibre_offset_mm[name] for name in sorted(self.fibre_offset_mm))):
            digest.update(np.ascontiguousarray(values).tobytes())
        if self.loaded:  # without, units are those that they were before there were loads
            digest.update(self.load.tobytes())
        return digest.hexdigest()[:16]

    def transmission(self, index: int, axis: int, output_deg: ArrayLike) -> tuple[Floats, Floats]:
        """True wire angle T-(theta)/n_bar in deg, and backlash B in motor deg. Eq. 6 and 7."""
        theta = np.ascontiguousarray(np.deg2rad(np.atleast_1d(np.asarray(output_deg, float))))
        row = plain(self.gear[index, axis]).ravel()
        gear, backlash = _core.transmission(row, GEAR, theta)
        return np.rad2deg(gear) / GEAR, np.rad2deg(backlash)

    def select(self, index: ArrayLike) -> Units:
        """Some of the units."""
        rows = np.atleast_1d(np.asarray(index))
        return replace(
            self,
            plant=self.plant[rows],
            gear=self.gear[rows],
            firmware=self.firmware[rows],
            arms=self.arms[rows],
            number=self.number[rows],
            beta_longer_mm=self.beta_longer_mm[rows],
            load=self.load[rows],
            fibre_offset_mm={name: mm[rows] for name, mm in self.fibre_offset_mm.items()},
        )

    def points_mm(self, layout_mm: Floats, fibre: str = METROLOGY) -> Floats:
        """True points (N, 2) of a fibre on the beta arms, from where the layout has them."""
        longer = np.column_stack([self.beta_longer_mm, np.zeros(len(self))])
        return layout_mm + longer + self.fibre_offset_mm.get(fibre, 0.0)
