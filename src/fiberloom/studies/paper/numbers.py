"""Numbers as people read them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from fiberloom.studies.paper.quantity import Bound, Kind, Quantity

_WRONG = {
    Kind.PUT_IN: "does not come back",
    Kind.TUNED: "does not come back",
    Kind.IDENTITY: "does not hold",
    Kind.REQUIREMENT: "not met",
    Kind.BOUND: "not met",
    Kind.PREDICTED: "misses",
}
_WORDS = {Bound.EQUAL: "", Bound.AT_MOST: "≤ ", Bound.AT_LEAST: "≥ "}


def number(value: float | None, digits: int = 3) -> str:
    """A value of any unit as text (relative precision of three digits), no exponent where possible; a
    dash for none.
    """
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0 or (value == int(value) and abs(value) < 1e5):
        return f"{value:.0f}"
    places = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    return f"{value:.{places}f}" if places < 8 else f"{value:.{digits - 1}e}"


def paper(q: Quantity) -> str:
    """The paper's value, with the sign of a bound; of an ordering, that it is stated."""
    if q.paper is None:
        return "–"
    if q.is_ordering:
        return "true"
    return f"{_WORDS[q.bound] if q.paper else ''}{number(q.paper)}"


def ours(q: Quantity) -> str:
    """Ours with its spread, to the same place; of an ordering, whether it holds."""
    if q.is_ordering and q.ours is not None:
        return {0.0: "false", 1.0: "true"}.get(q.ours, f"{100 * q.ours:.0f} % of cases")
    if q.spread is None or q.spread == 0.0:
        return number(q.ours)
    return f"{number(q.ours)} ± {number(q.spread, 2)}"


def ratio(q: Quantity) -> str:
    """Ours over the paper's."""
    return "–" if q.ratio is None or q.is_ordering else f"{q.ratio:.2f}"


def unit(q: Quantity) -> str:
    """The unit; an ordering has none."""
    return "" if q.is_ordering else q.unit


def verdict(q: Quantity) -> str:
    """The kind, and of what is not as in the paper, in which way."""
    return f"{q.kind.value}, {_WRONG[q.kind]}" if q.misses else q.kind.value


def headline(quantities: Sequence[Quantity]) -> str:
    """How many real predictions there are, and how many hit; of numbers and orderings together."""
    real = [q for q in quantities if q.real_prediction]
    orderings = sum(q.is_ordering for q in real)
    return (
        f"{len(real)} real predictions ({len(real) - orderings} numbers, {orderings} orderings), "
        f"{sum(not q.misses for q in real)} hit"
    )


def others(quantities: Sequence[Quantity]) -> str:
    """The same of each other kind, which tests the measurement and not the model."""
    parts = []
    for kind in Kind:
        some = [q for q in quantities if q.compared and q.kind is kind]
        if some and kind is not Kind.PREDICTED:
            missed = sum(q.misses for q in some)
            wrong = f", {missed} of them {_WRONG[kind]}" if missed else ""
            parts.append(f"{len(some)} {kind.value}{wrong}")
    return "; ".join(parts)
