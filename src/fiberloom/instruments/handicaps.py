"""Units that are worse than their model: not known exactly, cold, worn."""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.errors import InputError
from fiberloom.typing import Array, Floats, Ints

if TYPE_CHECKING:
    from fiberloom.instruments.focal_plane import FocalPlane


@dataclass(frozen=True, eq=False)
class Handicaps:
    """What planner and verifier have to know of N single positioners beyond their geometry.

    Raises
    ------
    InputError
        Room or doubt below 0, or a share that is not above 0 and at most 1.

    Examples
    --------
    >>> from fiberloom.instruments.handicaps import Handicaps
    >>> Handicaps.none(2).speed_share
    array([1., 1.])
    """

    wider_mm: Floats
    """(N,) room beyond the collision buffer, for one whose place or arm is not known exactly."""
    doubt_deg: Floats
    """(N, 2) by so much alpha and beta of one that is offline may be off."""
    speed_share: Floats
    """(N,) of the speed of all, for one that is cold or worn."""
    acceleration_share: Floats
    """(N,) of the acceleration of all."""

    def __post_init__(self) -> None:
        for name in ("wider_mm", "doubt_deg"):
            values = getattr(self, name)
            if not (np.isfinite(values) & (values >= 0.0)).all():
                raise InputError(f"handicaps: {name} must be finite and not below 0")
        for name in ("speed_share", "acceleration_share"):
            values = getattr(self, name)
            if not ((values > 0.0) & (values <= 1.0)).all():
                raise InputError(f"handicaps: {name} must be above 0 and at most 1")

    @classmethod
    def none(cls, n: int) -> "Handicaps":
        """Of n positioners that have none."""
        return cls(np.zeros(n), np.zeros((n, 2)), np.ones(n), np.ones(n))

    @classmethod
    def of(cls, plane: "FocalPlane") -> "Handicaps":
        """Of the positioners of a plane."""
        return cls.none(plane.n) if plane.handicaps is None else plane.handicaps

    def select(self, rows: Ints) -> "Handicaps":
        """Of some positioners, by row."""
        return Handicaps(**{name: values[rows] for name, values in self.arrays.items()})

    @property
    def arrays(self) -> dict[str, Array]:
        """All of them by name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


def handicapped(
    plane: "FocalPlane",
    positioner_id: Iterable[int],
    *,
    wider_mm: ArrayLike | None = None,
    doubt_deg: ArrayLike | None = None,
    speed_share: ArrayLike | None = None,
    acceleration_share: ArrayLike | None = None,
) -> "FocalPlane":
    """The same plane, with what is known of single positioners. What is left out stays as it is.

    Parameters
    ----------
    plane : FocalPlane
        N positioners.
    positioner_id : iterable of int
        The numbers of k of them.
    wider_mm : array_like, optional
        Room beyond the collision buffer, mm: one number or (k,).
    doubt_deg : array_like, optional
        By so much alpha and beta may be off, deg: (2,) or (k, 2). It counts for those that are offline: all
        places where they may be are kept free.
    speed_share, acceleration_share : array_like, optional
        Of the speed and the acceleration of all, above 0 and at most 1: one number or (k,).

    Returns
    -------
    FocalPlane

    Raises
    ------
    InputError
        A number that is not in this focal plane, or a value out of its range.

    Examples
    --------
    >>> import fiberloom as fl
    >>> from fiberloom.instruments.handicaps import handicapped
    >>> plane = fl.FocalPlane.of("sdssv", n=7)
    >>> cold = handicapped(plane, plane.positioner_id[:2], speed_share=0.5)
    >>> cold.handicaps.speed_share
    array([0.5, 0.5, 1. , 1. , 1. , 1. , 1. ])
    """
    rows = plane.index_of(np.fromiter(positioner_id, dtype=np.int64))
    new = {name: values.copy() for name, values in Handicaps.of(plane).arrays.items()}
    given = (wider_mm, doubt_deg, speed_share, acceleration_share)
    for values, value in zip(new.values(), given, strict=True):
        if value is not None:
            values[rows] = value
    return replace(plane, handicaps=Handicaps(**new))
