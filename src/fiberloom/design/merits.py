"""Figures of merit of one design, and designs with other numbers: to compare and to sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

from fiberloom.design.budget.places import random_goals_deg
from fiberloom.design.budget.terms import BudgetSettings, budget
from fiberloom.design.coverage import coverage
from fiberloom.design.efficiency import EfficiencySettings, efficiency, endless, inner_part
from fiberloom.design.gear import gear_window, move_s, twin_knows
from fiberloom.design.lattice import Lattice
from fiberloom.design.power import array_power
from fiberloom.errors import InputError
from fiberloom.instruments import Instrument, generate
from fiberloom.twin import draw_units

Sense = Literal["most", "least", ""]

SENSES: Mapping[str, Sense] = {
    "positioners": "most",
    "reach_mm": "",
    "folded_mm": "",
    "mean_fibres": "",
    "unreached_percent": "least",
    "hole_um": "least",
    "neighbours": "least",
    "fibres_used": "most",
    "targets_observed": "most",
    "least_ratio": "",
    "play_um": "least",
    "range_s": "least",
    "move_s": "least",
    "blind_um": "least",
    "corrected_um": "least",
    "move_J": "least",
    "peak_W": "least",
}
"""Names of the figures, and which is better; "": neither."""

ALIASES: Mapping[str, str] = {
    "arms.alpha": "positioner.l_alpha_mm",
    "pitch": "layout.pitch_mm",
    "buffer": "bodies.collision_buffer_mm",
    "requirement": "operation.requirement_um",
}
"""Short names of what is varied, beside `arms.beta`, `gear` and dotted keys of the file."""
UNITS = 61


@dataclass(frozen=True)
class MeritSettings:
    """What figures are taken at."""

    per_fibre: float = 1.0
    """Targets per positioner, for the shares."""
    fields: int = 4
    rings: int = 6
    corrections: int = 2
    seed: int = 0


def merits(instrument: Instrument, settings: MeritSettings) -> dict[str, float | None]:
    """The figures of an `instrument`, by the names of `SENSES` with their units: mm, um, s, J, W.

    None: of motors that the twin does not know.

    `settings`: density, fields, corrections, seed.
    """
    fibre = instrument.science_fibres[0]
    lattice = Lattice.of(instrument, fibre)
    found: dict[str, float | None] = dict.fromkeys(SENSES)
    found |= _geometry(instrument, lattice, settings.seed)
    found |= _shares(instrument, lattice, fibre, settings)
    found |= _motion(instrument, settings.seed)
    if motors_known(instrument):
        found |= _known_motors(instrument, settings)
    return found


def motors_known(instrument: Instrument) -> bool:
    """Are errors, power and springs of its motors known?"""
    return instrument.drive.by_maps and all(map(twin_knows, instrument.axes))


def _geometry(instrument: Instrument, lattice: Lattice, seed: int) -> dict[str, float | None]:
    reached = coverage(lattice, n=20_000, seed=seed)
    return {
        "positioners": float(instrument.layout.n_positioners),
        "reach_mm": lattice.reach_mm,
        "folded_mm": lattice.hole_mm,
        "mean_fibres": reached.mean,
        "unreached_percent": 100.0 * (1.0 - float(reached.at_least[1])),
        "hole_um": reached.hole_um,
        "neighbours": float(neighbours(instrument)),
    }


def neighbours(instrument: Instrument) -> int:
    """Units of an `instrument` whose bodies can meet those of one: centres within two reaches."""
    reach_mm = instrument.positioner.l_alpha_mm + instrument.bodies.reach_mm("beta")
    lattice = Lattice(reach_mm, reach_mm, instrument.layout.pitch_mm)
    far_mm = np.linalg.norm(lattice.centres_mm(*lattice.steps()), axis=1)
    return int(((far_mm > 0.0) & (far_mm < 2.0 * reach_mm)).sum())


def _shares(
    instrument: Instrument, lattice: Lattice, fibre: str, settings: MeritSettings
) -> dict[str, float | None]:
    where = inner_part(endless(instrument, settings.rings), fibre)
    density = settings.per_fibre * lattice.mean
    asked = EfficiencySettings(("assigned",), fields=settings.fields, seed=settings.seed)
    (one,) = efficiency(where, fibre, [density], asked)
    return {"fibres_used": one.used, "targets_observed": one.observed}


def _motion(instrument: Instrument, seed: int) -> dict[str, float | None]:
    """Times: of a whole range, and of the way that the slowest of an array has between two fields."""
    windows = [gear_window(instrument, axis) for axis in (0, 1)]
    plane = generate(instrument, seed, n_positioners=min(UNITS, instrument.layout.n_positioners))
    rng = np.random.default_rng([seed, 0x3E7])
    slowest = []
    for _ in range(8):
        ways = np.abs(random_goals_deg(plane, rng) - random_goals_deg(plane, rng)).max(axis=0)
        slowest.append(
            max(
                move_s(float(way), axis.speed_deg_s, axis.acceleration_deg_s2)
                for way, axis in zip(ways, instrument.axes, strict=True)
            )
        )
    return {
        "least_ratio": float(max(one.least for one in windows)),
        "play_um": max(one.play_um for one in windows),
        "range_s": max(one.range_s for one in windows),
        "move_s": float(np.mean(slowest)),
    }


def _known_motors(instrument: Instrument, settings: MeritSettings) -> dict[str, float | None]:
    plane = generate(instrument, settings.seed, n_positioners=min(UNITS, instrument.layout.n_positioners))
    units = draw_units(plane, settings.seed)
    errors = budget(plane, units, BudgetSettings(corrections=settings.corrections))
    power = array_power(instrument, seed=settings.seed)
    return {
        "blind_um": errors.total_um[0],
        "corrected_um": errors.total_um[-1],
        "move_J": power.move_J,
        "peak_W": power.peak_W,
    }


# other numbers


def varied(instrument: Instrument, changes: Mapping[str, float]) -> Instrument:
    """The same with other numbers: `arms.alpha`, `arms.beta`, `pitch`, `gear`, `buffer`, `requirement`, or a
    key of the file with dots, such as `alpha.speed_deg_s`. Lengths in mm, other values in the unit of their
    key.

    Raises
    ------
    InputError
        A key that there is not, or an instrument that cannot be.
    """
    data = instrument.model_dump(exclude_none=True)
    for key, value in changes.items():
        _change(data, key, value)
    try:
        return Instrument.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise InputError(
            f"{where or instrument.name}: {first['msg'].removeprefix('Value error, ')}"
        ) from None


def _change(data: dict[str, Any], key: str, value: float) -> None:
    if key == "arms.beta":
        _stretch(data, value)
    elif key == "gear":
        data["alpha"]["gear"] = data["beta"]["gear"] = value
    else:
        _put(data, ALIASES.get(key, key), value)
    if key == "arms.alpha":
        data["scatter"]["l_alpha_mm"].pop("mean", None)
        for end in ("min", "max"):
            data["scatter"]["l_alpha_mm"].pop(end, None)


def _stretch(data: dict[str, Any], length_mm: float) -> None:
    """Beta arms of another length: fibres and capsule grow in proportion."""
    points = data["positioner"]["points"].values()
    longest = max(p["x_mm"] for p in points)
    share = length_mm / longest
    for point in points:
        point["x_mm"] *= share
    data["bodies"]["beta_segment_mm"] = [x * share for x in data["bodies"]["beta_segment_mm"]]


def _put(data: dict[str, Any], key: str, value: float) -> None:
    *tables, last = key.split(".")
    table: Any = data
    for name in tables:
        table = table.get(name) if isinstance(table, dict) else None
    if not isinstance(table, dict) or not isinstance(table.get(last), int | float):
        known = ", ".join(["arms.alpha", "arms.beta", "pitch", "gear", "buffer", "requirement"])
        raise InputError(f"--vary {key}: no such number in the file; known are {known} and keys with dots")
    table[last] = int(value) if isinstance(table[last], int) and float(value).is_integer() else value


# the front


def pareto(rows: Sequence[Mapping[str, float | None]], objectives: Sequence[str]) -> list[bool]:
    """Which of the `rows` no other is better than: at least as good in all `objectives`, better in one.

    Raises
    ------
    InputError
        An objective that is no figure of merit, or of which neither more nor less is better.
    """
    for name in objectives:
        if not SENSES.get(name):
            known = ", ".join(k for k, sense in SENSES.items() if sense)
            raise InputError(f"--objectives {name}: known are {known}")
    costs = [_cost(row, objectives) for row in rows]
    return [cost is not None and not any(_beats(other, cost) for other in costs) for cost in costs]


def _cost(row: Mapping[str, float | None], objectives: Sequence[str]) -> list[float] | None:
    """Less is better in each; None where one is not known."""
    found = []
    for name in objectives:
        value = row.get(name)
        if value is None:
            return None
        found.append(value if SENSES[name] == "least" else -value)
    return found


def _beats(one: list[float] | None, other: list[float]) -> bool:
    return one is not None and one != other and all(a <= b for a, b in zip(one, other, strict=True))
