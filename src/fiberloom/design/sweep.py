"""Many designs at once: every combination of the numbers that are varied, on all cores by Dask."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from fiberloom.design.merits import MeritSettings, merits, varied
from fiberloom.errors import InputError
from fiberloom.instruments import Instrument

MOST_DESIGNS = 2000
SCHEDULER = "processes"
"""Of Dask, on this machine."""
CONNECT_S = 10.0
"""To find the scheduler of a cluster."""


@dataclass(frozen=True)
class VariedDesign:
    """One combination."""

    changes: Mapping[str, float]
    """What is varied: key and value."""
    figures: Mapping[str, float | None]
    """By the names of `merits.SENSES`; empty: it cannot be."""
    refused: str = ""
    """Why it cannot be."""


def ranges_of(text: str) -> dict[str, list[float]]:
    """Keys and values of `arms.alpha=5:9:0.5,pitch=20;22.4`: from, to and step, or single values.

    Lengths in mm, other values in the unit of their key.

    Raises
    ------
    InputError
        Words that are no such ranges.
    """
    found: dict[str, list[float]] = {}
    for word in text.split(","):
        key, sign, values = (part.strip() for part in word.partition("="))
        if not sign or not key or not values:
            raise InputError(f"--vary {word}: {_GRAMMAR}")
        if key in found:
            raise InputError(f"--vary {word}: {key} is varied twice; give all its values at once")
        found[key] = _values(word, values)
    return found


_GRAMMAR = "give key=from:to:step or key=a;b;c, as in arms.alpha=5:9:0.5"


def _values(word: str, text: str) -> list[float]:
    single = ":" not in text
    try:
        numbers = [float(value) for value in text.split(";" if single else ":")]
    except ValueError:
        raise InputError(f"--vary {word}: {_GRAMMAR}") from None
    if not np.isfinite(numbers).all():
        raise InputError(f"--vary {word}: numbers must be finite")
    if single:
        return numbers
    if len(numbers) != 3:
        raise InputError(f"--vary {word}: {_GRAMMAR}")
    low, high, step = numbers
    if high < low:
        raise InputError(f"--vary {word}: holds nothing, {low:g} is above {high:g}; give the lower one first")
    if not step > 0.0:
        raise InputError(f"--vary {word}: a step of {step:g} leads nowhere; give one above 0")
    if (high - low) / step >= MOST_DESIGNS:
        n = (high - low) / step
        raise InputError(f"--vary {word}: {n:.3g} values, {MOST_DESIGNS} at most; give a wider step")
    return [float(round(low + k * step, 9)) for k in range(math.floor((high - low) / step + 1e-9) + 1)]


def sweep(
    instrument: Instrument,
    ranges: Mapping[str, Sequence[float]],
    settings: MeritSettings,
    workers: int = 1,
    scheduler: str | None = None,
) -> list[VariedDesign]:
    """All combinations of the `ranges` of an `instrument`, in their order; mm, or the unit of a key.

    `settings`: at what figures are taken; `workers`: processes on this machine; `scheduler`: address of a
    Dask cluster in place of them.

    Raises
    ------
    InputError
        More than 2000 designs, a key that there is not, or no cluster at the address.
    """
    combinations = [dict(zip(ranges, values, strict=True)) for values in product(*ranges.values())]
    if len(combinations) > MOST_DESIGNS:
        raise InputError(f"--vary: {len(combinations)} designs, {MOST_DESIGNS} at most; take wider steps")
    for key in ranges:
        _refuse_unknown(instrument, key, ranges[key][0])
    return _computed(instrument, combinations, settings, workers, scheduler)


def _refuse_unknown(instrument: Instrument, key: str, value: float) -> None:
    """A key that there is not is told at once; an instrument that cannot be is a row of the table."""
    try:
        varied(instrument, {key: value})
    except InputError as error:
        if str(error).startswith("--vary"):
            raise


def _computed(
    instrument: Instrument,
    combinations: list[dict[str, float]],
    settings: MeritSettings,
    workers: int,
    scheduler: str | None,
) -> list[VariedDesign]:
    if workers <= 1 and scheduler is None:
        return [_design(instrument, changes, settings) for changes in combinations]
    from dask import base, delayed  # type: ignore[attr-defined]  # it does not say what it exports

    compute: Any = base.compute
    jobs = [delayed(_design)(instrument, changes, settings) for changes in combinations]
    if scheduler is not None:
        with _cluster(scheduler):
            return list(compute(*jobs))
    return list(compute(*jobs, scheduler=SCHEDULER, num_workers=workers, chunksize=1))


def _cluster(address: str) -> Any:
    from distributed import Client

    try:
        return Client(address, timeout=CONNECT_S)  # type: ignore[no-untyped-call]  # Dask has no types here
    except (OSError, ValueError) as error:
        raise InputError(
            f"--scheduler {address}: {error}; start one with 'dask scheduler', or leave the option out"
        ) from None


def _design(instrument: Instrument, changes: dict[str, float], settings: MeritSettings) -> VariedDesign:
    try:
        return VariedDesign(changes, merits(varied(instrument, changes), settings))
    except InputError as error:
        return VariedDesign(changes, {}, str(error))
