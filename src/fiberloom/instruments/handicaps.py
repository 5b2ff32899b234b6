"""Units that are worse than their model: not known exactly, cold, worn."""

from dataclasses import dataclass, fields

import numpy as np

from fiberloom.errors import InputError
from fiberloom.typing import Array, Floats, Ints


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

    def select(self, rows: Ints) -> "Handicaps":
        """Of some positioners, by row."""
        return Handicaps(**{name: values[rows] for name, values in self.arrays.items()})

    @property
    def arrays(self) -> dict[str, Array]:
        """All of them by name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}
