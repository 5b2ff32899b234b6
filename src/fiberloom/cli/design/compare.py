"""`fiberloom design compare` and `fiberloom design sweep`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.design.coverage import DesignOptions
from fiberloom.cli.options import require_instrument
from fiberloom.cli.terminal import waiting
from fiberloom.errors import InputError
from fiberloom.report.folder import prepare_file

if TYPE_CHECKING:
    from fiberloom.design.merits import MeritSettings
    from fiberloom.design.sweep import VariedDesign

TOLD = ("fibres_used", "unreached_percent", "hole_um", "neighbours", "move_s", "blind_um", "corrected_um")
"""Figures of a row of a sweep, beside the objectives; JSON has all."""


@dataclass(frozen=True, kw_only=True)
class MeritOptions(DesignOptions):
    """Of a command that takes figures of merit."""

    per_fibre: Annotated[float, typer.Option(help="Targets per positioner, for the shares.")] = 1.0
    fields: Annotated[int, typer.Option(min=2, help="Random fields of targets.")] = 4
    corrections: Annotated[int, typer.Option(min=0, max=20, help="Of the error budget.")] = 2
    seed: Annotated[int, typer.Option(min=0, help="The one seed of everything random.")] = 0

    def settings(self) -> MeritSettings:
        """At what figures are taken; InputError for a density that is none."""
        from fiberloom.design.merits import MeritSettings

        if not self.per_fibre > 0.0:
            raise InputError(f"--per-fibre {self.per_fibre:g}: targets per positioner, above 0")
        return MeritSettings(
            per_fibre=self.per_fibre, fields=self.fields, corrections=self.corrections, seed=self.seed
        )


@dataclass(frozen=True, kw_only=True)
class CompareOptions(MeritOptions):
    """Of `fiberloom design compare`."""

    other: Annotated[str, typer.Argument(help="Another preset or TOML file.")]


def compare(options: CompareOptions) -> None:
    """Figures of merit of two designs side by side, and which is better in each."""
    require_instrument(options.file)
    require_instrument(options.other)
    from fiberloom.design.merits import SENSES, merits
    from fiberloom.instruments import load_instrument

    settings = options.settings()
    names = [options.file, options.other]
    with waiting() as shown:
        shown.say("figures of both")
        first, second = (merits(load_instrument(name), settings) for name in names)
    labels = [Path(name).stem for name in names]
    if labels[0] == labels[1]:
        labels = names
    rows = [
        {
            "figure": name,
            labels[0]: _rounded(first[name]),
            labels[1]: _rounded(second[name]),
            "better": _better(sense, first[name], second[name], labels),
        }
        for name, sense in SENSES.items()
    ]
    options.show(rows)


def _rounded(value: float | None) -> float | str:
    return "not known" if value is None else float(f"{value:.5g}")


def _better(sense: str, first: float | None, second: float | None, labels: list[str]) -> str:
    if not sense or first is None or second is None or first == second:
        return ""
    return labels[int((second > first) == (sense == "most"))]


@dataclass(frozen=True, kw_only=True)
class SweepDesignOptions(MeritOptions):
    """Of `fiberloom design sweep`."""

    vary: Annotated[
        str,
        typer.Option(
            help="What: arms.alpha=5:9:0.5,pitch=20;22.4; arms.beta, gear, buffer, requirement, or a key of "
            "the file with dots."
        ),
    ]
    objectives: Annotated[
        str | None,
        typer.Option(
            help="Figures of merit of the Pareto front, with commas, the first two are drawn; default: "
            "fibres_used, and blind_um or, of motors that the twin does not know, move_s."
        ),
    ] = None
    workers: Annotated[int, typer.Option(min=1, max=256, help="Processes on this machine.")] = 1
    scheduler: Annotated[str | None, typer.Option(help="Address of a Dask cluster, in place of them.")] = None
    out: Annotated[Path | None, typer.Option(help="The front as a diagram, PNG.")] = None


def sweep(options: SweepDesignOptions) -> int:
    """Every combination of the numbers that are varied, and the Pareto front: those that none is better than.

    A design that cannot be is a row with the reason. Exit code 1 where no design can be.
    """
    require_instrument(options.file)
    if options.out is not None:
        prepare_file(options.out)
    from fiberloom.design.merits import motors_known, pareto
    from fiberloom.design.sweep import ranges_of
    from fiberloom.design.sweep import sweep as sweep_of
    from fiberloom.instruments import load_instrument

    instrument = load_instrument(options.file)
    usual = f"fibres_used,{'blind_um' if motors_known(instrument) else 'move_s'}"
    objectives = (options.objectives or usual).split(",")
    pareto([], objectives)  # refuses unknown ones before the work
    ranges = ranges_of(options.vary)
    with waiting() as shown:
        shown.say("figures of every design")
        found = sweep_of(instrument, ranges, options.settings(), options.workers, options.scheduler)
    front = pareto([one.figures for one in found], objectives)
    if options.as_json:
        told = [_json(one, on_front) for one, on_front in zip(found, front, strict=True)]
        options.print_json(told)
    else:
        options.show([_row(one, o, objectives) for one, o in zip(found, front, strict=True)])
    if options.out is not None:  # last: where the disk is full, the work of hours has been shown
        from fiberloom.design.figures import draw_front

        draw_front(options.out, instrument.name, found, front, objectives)
    return int(all(one.refused for one in found))


def _json(one: VariedDesign, on_front: bool) -> dict[str, Any]:
    return {"changes": one.changes, "figures": one.figures, "refused": one.refused, "front": on_front}


def _row(one: VariedDesign, on_front: bool, objectives: list[str]) -> dict[str, Any]:
    names = dict.fromkeys([*objectives, *TOLD])
    figures = {name: _rounded(one.figures[name]) if one.figures else "" for name in names}
    return {**one.changes, **figures, "front": one.refused or ("yes" if on_front else "")}
