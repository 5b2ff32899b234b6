"""One number of the paper, ours beside it, and what kind of number ours is."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import Self, TypedDict, Unpack

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, computed_field, model_validator

MISS = 0.25
"""A prediction this far from the paper's number, relative, is a miss; a value that was put in or tuned and
is this far off has not come back."""
ROUNDING = 0.02
"""An identity may differ from the paper's number by its rounding."""
HOLDS = "holds"
"""Unit of an ordering: 1 where it holds, 0 where not; of several cases the share in which it holds."""


class Kind(StrEnum):
    """Where our number comes from."""

    PUT_IN = "put in"
    """A parameter taken from the paper: that it comes back tests the measurement only."""
    TUNED = "tuned"
    """A parameter was chosen, or fitted, so that this number agrees."""
    IDENTITY = "identity"
    """Arithmetic or geometry of what was put in: it could not come out otherwise."""
    REQUIREMENT = "requirement"
    """What an instrument asks for; ours has to meet it."""
    BOUND = "bound"
    """The paper prints one side only: at most, at least."""
    PREDICTED = "predicted"
    """It came out. Beside a number or an ordering that the paper prints it is a real prediction."""


class Bound(StrEnum):
    """How the paper's value is to be read."""

    EQUAL = "equal"
    AT_MOST = "at most"
    AT_LEAST = "at least"


class Quantity(BaseModel):
    """A record of results.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    id: str = Field(pattern=r"^(fig\d+|eq\d+|table\d+|section\d+)(\.[A-Za-z0-9_]+)+$")
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
    def is_ordering(self) -> bool:
        """A statement of the paper, true or false, not a number."""
        return self.unit == HOLDS

    @property
    def compared(self) -> bool:
        """The paper prints a number or an ordering, and ours stands beside it."""
        return self.paper is not None and not self.beyond

    @property
    def real_prediction(self) -> bool:
        """It came out of the twin, and the paper prints it."""
        return self.compared and self.kind is Kind.PREDICTED

    @property
    def misses(self) -> bool:
        """Not what the paper prints: a prediction that is wrong, a bound or requirement that is not met, a
        value that was put in and does not come back.
        """
        if self.paper is None:
            return False
        if self.ours is None:
            return True
        if self.bound is Bound.AT_MOST:
            return self.ours > self.paper
        if self.bound is Bound.AT_LEAST:
            return self.ours < self.paper
        return abs(self.ours - self.paper) > self._tolerance * abs(self.paper)

    @property
    def _tolerance(self) -> float:
        if self.is_ordering:
            return 0.0
        return ROUNDING if self.kind is Kind.IDENTITY else MISS

    @model_validator(mode="after")
    def _one_sided_are_no_predictions(self) -> Self:
        if self.real_prediction and self.bound is not Bound.EQUAL:
            raise ValueError(f"{self.id}: a limit is a bound or a requirement, not a prediction")
        if self.kind in (Kind.BOUND, Kind.REQUIREMENT) and self.bound is Bound.EQUAL:
            raise ValueError(f"{self.id}: a {self.kind.value} is at most or at least something")
        return self


class _Remark(TypedDict, total=False):
    """What is said of a quantity."""

    note: str
    beyond: bool


class _Reading(_Remark, total=False):
    """How a quantity is to be read."""

    paper: float | None
    bound: Bound


def quantity(
    key: str,
    name: str,
    values: float | Sequence[float],
    unit: str,
    kind: Kind = Kind.PREDICTED,
    **reading: Unpack[_Reading],
) -> Quantity:
    """A quantity from one value, or from one value per seed; what is not finite is not measured.

    `key` and `name`: short and in words; `values` in `unit` (um, deg, ...); `kind`: where it
    comes from. `reading`: the value of the `paper` in the same unit, its `bound`, a `note`, and whether it is
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


def ordering(
    key: str,
    statement: str,
    holds: bool | Sequence[bool],
    kind: Kind = Kind.PREDICTED,
    **reading: Unpack[_Remark],
) -> Quantity:
    """An ordering that the paper states, as a quantity of its own: does it hold on the twin?

    `key` and `statement`: short and in words; `holds`: for each seed or case; it has to hold in all.
    `kind`: where it comes from; `reading`: a `note`, and whether it is `beyond` the paper.
    """
    share = float(np.mean(np.atleast_1d(np.asarray(holds, dtype=float))))
    return quantity(key, statement, share, HOLDS, kind, paper=1.0, **reading)
