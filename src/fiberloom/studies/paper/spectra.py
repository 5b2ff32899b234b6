"""Orderings that must not hang on one assumed spectrum of the gears."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fiberloom.studies.paper.quantity import Kind, Quantity, ordering
from fiberloom.twin.errors.switches import GearSpectrum

SPECTRA: tuple[GearSpectrum, ...] = ("stages", "teeth")
"""Those that an ordering is shown for; the first one is what all other numbers are measured with."""


def ordering_for_all(
    key: str,
    statement: str,
    holds: Mapping[GearSpectrum, Sequence[bool]],
    kind: Kind = Kind.PREDICTED,
    *,
    note: str = "",
) -> Quantity:
    """An ordering of the paper that holds if it `holds` for every seed with every spectrum of the gears.

    `key` and `statement`: short and in words; `kind`: where it comes from; `note`: what it depends on.
    """
    cases = [bool(case) for of_seeds in holds.values() for case in of_seeds]
    told = "; ".join(f"gears '{gears}': {_told(of_seeds)}" for gears, of_seeds in holds.items())
    return ordering(key, statement, cases, kind, note=f"{told}. {note}".rstrip())


def _told(of_seeds: Sequence[bool]) -> str:
    true = sum(map(bool, of_seeds))
    if true in (0, len(of_seeds)):
        return "true" if true else "false"
    return f"true for {true} of {len(of_seeds)} seeds"
