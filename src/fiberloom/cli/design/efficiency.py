"""`fiberloom design efficiency`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from fiberloom.cli.design.coverage import DesignOptions
from fiberloom.cli.options import require_file, require_instrument
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError
from fiberloom.report.folder import prepare_file

if TYPE_CHECKING:
    from fiberloom.design.efficiency import Efficiency, ObservedPart, Rule
    from fiberloom.instruments import Instrument


@dataclass(frozen=True, kw_only=True)
class EfficiencyOptions(DesignOptions):
    """Of `fiberloom design efficiency`."""

    density: Annotated[
        str, typer.Option(help="Targets in the annulus that one unit reaches, several with commas.")
    ] = "0.5,1,2,4"
    rules: Annotated[
        str,
        typer.Option(
            help="random, free, tips, arms, assigned: who gets what, and what counts as a collision."
        ),
    ] = "free,tips,arms,assigned"
    fibre: Annotated[str | None, typer.Option(help="That targets ask for; default: the first one.")] = None
    exposures: Annotated[int, typer.Option(min=1, help="Of one field; observed targets are left out.")] = 1
    fields: Annotated[int, typer.Option(min=2, help="Drawn for each density.")] = 10
    clustered: Annotated[bool, typer.Option("--clustered", help="Targets in clusters of 8.")] = False
    broken: Annotated[float, typer.Option(help="Share of the units that are broken, 0 to 1.")] = 0.0
    exclusion: Annotated[
        float | None, typer.Option(help="Between two fibres, mm, for tips; default: two collision buffers.")
    ] = None
    array: Annotated[
        bool, typer.Option("--array", help="The whole array, in place of an endless lattice.")
    ] = False
    rings: Annotated[int, typer.Option(min=2, max=30, help="Of the patch of the endless lattice.")] = 8
    targets: Annotated[Path | None, typer.Option(help="A list in mm, on the whole array.")] = None
    seed: Annotated[int, typer.Option(min=0, help="The one seed of everything random.")] = 0
    out: Annotated[Path | None, typer.Option(help="Diagram to draw, PNG.")] = None


def efficiency(options: EfficiencyOptions) -> None:
    """Share of the fibres that are used and of the targets that are observed, against their density.

    By the project's own assignment and bodies. random: one unit after the other takes any target, collisions
    do not count; free: most targets, collisions do not count; tips: no two fibres nearer
    than the exclusion; arms: no two bodies overlap at rest; assigned: as `fiberloom assign`.
    """
    require_instrument(options.file)
    require_file(options.targets)
    densities = _densities(options.density)
    if options.targets is not None and (options.clustered or options.broken):
        raise InputError("--targets: a list of its own goes with neither --clustered nor --broken")
    if options.out is not None:
        prepare_file(options.out)
    from fiberloom.instruments import load_instrument

    instrument = load_instrument(options.file)
    fibre = options.fibre or instrument.science_fibres[0]
    with waiting() as shown:
        shown.say("observing fields")
        found = _found(options, instrument, fibre, densities, shown.count)
    if options.out is not None:
        from fiberloom.design.figures import draw_efficiency

        draw_efficiency(options.out, f"{instrument.name}, {fibre}", found)
    options.show([efficiency_row(one) for one in found])


def _densities(text: str) -> list[float]:
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(f"--density {text}: targets per annulus, as in 0.5,1,2,4") from None


def _found(
    options: EfficiencyOptions, instrument: Instrument, fibre: str, densities: list[float], progress: Any
) -> list[Efficiency]:
    from fiberloom.design.efficiency import EfficiencySettings, of_list
    from fiberloom.design.efficiency import efficiency as efficiency_of

    settings = EfficiencySettings(
        rules=_rules(options.rules),
        exposures=options.exposures,
        fields=options.fields,
        clustered=options.clustered,
        broken=options.broken,
        exclusion_mm=options.exclusion,
        seed=options.seed,
    )
    where = _where(options, instrument, fibre)
    if options.targets is not None:
        from fiberloom.targets import read_targets

        return of_list(where, fibre, read_targets(options.targets), settings)
    return efficiency_of(where, fibre, densities, settings, progress)


def _rules(text: str) -> list[Rule]:
    from fiberloom.design.efficiency import RULES

    rules = text.split(",")
    for rule in rules:
        if rule not in RULES:
            raise InputError(f"--rules {rule}: known are {', '.join(RULES)}")
    return cast("list[Rule]", rules)


def _where(options: EfficiencyOptions, instrument: Instrument, fibre: str) -> ObservedPart:
    from fiberloom.design.efficiency import endless, inner_part, whole_array
    from fiberloom.instruments import generate

    if options.array or options.targets is not None:
        return whole_array(generate(instrument, options.seed), fibre)
    return inner_part(endless(instrument, options.rings), fibre)


def efficiency_row(one: Efficiency) -> dict[str, Any]:
    """As it is printed."""
    return {
        "density": round(one.density, 3),
        "targets_per_fibre": round(one.per_fibre, 3),
        "rule": one.rule,
        "exposures": one.exposures,
        "fibres_used": _share(one.used),
        "error_used": _share(one.used_error),
        "targets_observed": _share(one.observed),
        "error_observed": _share(one.observed_error),
    }


def _share(share: float) -> float | None:
    """Four digits; None for a number that one field does not have."""
    return None if math.isnan(share) else round(share, 4)
