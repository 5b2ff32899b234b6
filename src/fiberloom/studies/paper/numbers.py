"""Numbers as people read them."""

from __future__ import annotations

import math

from fiberloom.studies.paper.quantity import Bound, Quantity

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
    """The paper's value, with the sign of a bound."""
    if q.paper is None:
        return "–"
    return f"{_WORDS[q.bound] if q.paper else ''}{number(q.paper)}"


def ours(q: Quantity) -> str:
    """Ours with its spread, to the same place."""
    if q.spread is None or q.spread == 0.0:
        return number(q.ours)
    return f"{number(q.ours)} ± {number(q.spread, 2)}"


def ratio(q: Quantity) -> str:
    """Ours over the paper's."""
    return "–" if q.ratio is None else f"{q.ratio:.2f}"


def verdict(q: Quantity) -> str:
    """`miss` for a prediction that misses, else the kind."""
    return f"{q.kind.value}, misses" if q.misses else q.kind.value
