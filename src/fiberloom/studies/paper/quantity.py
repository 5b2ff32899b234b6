"""One number of the paper, ours beside it, and what kind of number ours is."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import TypedDict, Unpack

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, computed_field

MISS = 0.25
"""A prediction this far from the paper's value, relative, is a miss: shown as one, with a reason."""


class Kind(StrEnum):
    """Where our number comes from."""

    PUT_IN = "put in"
    """A parameter taken from the paper: that it comes back tests the measurement only."""
    TUNED = "tuned"
    """A parameter was chosen so that this number agrees."""
    PREDICTED = "predicted"
    """It came out."""


class Bound(StrEnum):
    """How the paper's value is to be read."""

    EQUAL = "equal"
    AT_MOST = "at most"
    AT_LEAST = "at least"


class Quantity(BaseModel):
    """A record of results.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    id: str = Field(pattern=r"^(fig\d+|eq\d+|table\d+)(\.[A-Za-z0-9_]+)+$")
    figure: int | str
    name: str
    """In words, for people."""
    paper: float | None
    """The paper's value; None where it prints none."""
    ours: float | None
    """None where it could not be measured."""
    spread: float | None = None
    """Standard deviation over seeds (each draws its own units); None for one seed."""
    unit: str
    kind: Kind
    note: str = ""
    """What the number depends on; of a miss, why."""
    bound: Bound = Bound.EQUAL
    beyond: bool = False
    """Not in the paper: what fiberloom does beside it."""

    @computed_field  # type: ignore[prop-decorator]  # mypy has none on a property; pydantic wants it
    @property
    def ratio(self) -> float | None:
        """Ratio of ours to the paper's; None where the paper has no value, or zero."""
        return self.ours / self.paper if self.paper and self.ours is not None else None

    @property
    def misses(self) -> bool:
        """A prediction more than 25 % off, or on the wrong side of a bound."""
        if self.kind is not Kind.PREDICTED or self.paper is None:
            return False
        if self.ours is None:
            return True
        if self.bound is Bound.AT_MOST:
            return self.ours > self.paper
        if self.bound is Bound.AT_LEAST:
            return self.ours < self.paper
        return abs(self.ours - self.paper) > MISS * abs(self.paper)


class _Reading(TypedDict, total=False):
    """How a quantity is to be read."""

    paper: float | None
    bound: Bound
    note: str
    beyond: bool


def quantity(
    key: str,
    name: str,
    values: float | Sequence[float],
    unit: str,
    kind: Kind = Kind.PREDICTED,
    **reading: Unpack[_Reading],
) -> Quantity:
    """A quantity from one value, or from one value per seed; what is not finite is not measured.

    `key` and `name`: short and in words; `values` in `unit` (um, deg, ...); `kind`: put in, tuned or
    predicted. `reading`: the value of the `paper` in the same unit, its `bound`, a `note`, and whether it is
    `beyond` the paper.
    """
    found = np.atleast_1d(np.asarray(values, dtype=float))
    sound = bool(np.isfinite(found).all())
    first = key.partition(".")[0]
    return Quantity(
        id=key,
        figure=int(first[3:]) if first.startswith("fig") else first,
        name=name,
        paper=reading.get("paper"),
        ours=float(found.mean()) if sound else None,
        spread=float(found.std(ddof=1)) if sound and len(found) > 1 else None,
        unit=unit,
        kind=kind,
        note=reading.get("note", ""),
        bound=reading.get("bound", Bound.EQUAL),
        beyond=reading.get("beyond", False),
    )
