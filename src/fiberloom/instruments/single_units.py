"""What is known of single positioners of a focal plane, beyond their geometry."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.instruments.focal_plane import FocalPlane
from fiberloom.instruments.handicaps import Handicaps


def handicaps_of(plane: FocalPlane) -> Handicaps:
    """Of the N positioners of a plane; none where it tells of none."""
    return plane.handicaps or Handicaps.none(plane.n)


def handicapped(
    plane: FocalPlane,
    positioner_id: Iterable[int],
    *,
    wider_mm: ArrayLike | None = None,
    doubt_deg: ArrayLike | None = None,
    speed_share: ArrayLike | None = None,
    acceleration_share: ArrayLike | None = None,
) -> FocalPlane:
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
    >>> from fiberloom.instruments.single_units import handicapped
    >>> plane = fl.FocalPlane.of("sdssv", n=7)
    >>> cold = handicapped(plane, plane.positioner_id[:2], speed_share=0.5)
    >>> cold.handicaps.speed_share
    array([0.5, 0.5, 1. , 1. , 1. , 1. , 1. ])
    """
    rows = plane.index_of(np.fromiter(positioner_id, dtype=np.int64))
    new = {name: values.copy() for name, values in handicaps_of(plane).arrays.items()}
    given = (wider_mm, doubt_deg, speed_share, acceleration_share)
    for values, value in zip(new.values(), given, strict=True):
        if value is not None:
            values[rows] = value
    return replace(plane, handicaps=Handicaps(**new))
