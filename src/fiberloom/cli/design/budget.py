"""`fiberloom design budget`: asks for the budget, and shows its tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.design.coverage import DesignOptions
from fiberloom.cli.options import require_instrument
from fiberloom.cli.terminal import Waiting, waiting
from fiberloom.errors import InputError

if TYPE_CHECKING:
    from fiberloom.design.budget.conditions import Attitude, Night
    from fiberloom.design.budget.monte_carlo import Alone, Simulated
    from fiberloom.design.budget.terms import Budget, BudgetSettings
    from fiberloom.design.budget.tilt import Tilts
    from fiberloom.instruments import FocalPlane, Instrument


@dataclass(frozen=True, kw_only=True)
class BeamOptions:
    """Of a command that looks at tilts."""

    focal_ratio: Annotated[
        float | None, typer.Option(help="Of the beam: what tilted axes and fibres do to focus and light.")
    ] = None


@dataclass(frozen=True, kw_only=True)
class BudgetOptions(BeamOptions, DesignOptions):
    """Of `fiberloom design budget`."""

    corrections: Annotated[int, typer.Option(min=0, max=20, help="After the blind move.")] = 2
    knots: Annotated[int, typer.Option(help="Of a map, for each axis and direction.")] = 200
    errors: Annotated[
        str, typer.Option(help="What tables have wrong, as `observe --errors`: none, all, fibre=2, ...")
    ] = "none"
    zenith: Annotated[float, typer.Option(help="Zenith distance, deg; with gravity among the errors.")] = 0.0
    turn: Annotated[float, typer.Option(help="By which the rotator turns from image to exposure, deg.")] = 0.0
    axis_tilt: Annotated[str, typer.Option(help="Of the axes alpha,beta, deg rms; with --focal-ratio.")] = (
        "0.1,0.1"
    )
    fibre_tilt: Annotated[
        float | None, typer.Option(help="Of a fibre, deg rms; default: [acceptance] tilt_deg / 1.73, or 0.")
    ] = None
    collimator: Annotated[
        float | None, typer.Option(help="Focal ratio that the spectrograph takes; default: the beam's.")
    ] = None
    curvature: Annotated[
        float | None, typer.Option(help="Radius of the focal surface, mm; default: flat.")
    ] = None
    units: Annotated[int, typer.Option(min=7, help="Of the twin, drawn.")] = 120
    fields: Annotated[int, typer.Option(min=1, help="Random configurations of all of them.")] = 6
    observe: Annotated[
        int, typer.Option(min=0, help="So many positioners of the full twin, firmware and all; 0: none.")
    ] = 0
    seed: Annotated[int, typer.Option(min=0, help="The one seed of everything random.")] = 0


def budget(options: BudgetOptions) -> int:
    """Error budget of the blind move and after corrections: by formula, and on the twin beside it.

    Terms come from the instrument's file and from the units that the twin draws by it; nothing is fitted.
    Below: what halving each cause would win. Exit code 1 where more than 1 % of the fibres are beyond the
    requirement after the corrections.
    """
    require_instrument(options.file)
    if options.focal_ratio is None and (options.collimator or options.curvature or options.fibre_tilt):
        raise InputError("--collimator, --curvature, --fibre-tilt: go with --focal-ratio, that of the beam")
    from fiberloom.instruments import load_instrument

    instrument = load_instrument(options.file)
    tilts_of(options, instrument)  # ones that cannot be are refused before the work
    with waiting() as shown:
        report, beyond = budget_report(options, instrument, shown)
    if options.as_json:
        options.print_json(report)
    else:
        for part in filter(None, report.values()):
            options.show(part)
    return int(beyond > 0.01)


def budget_report(options: BudgetOptions, instrument: Any, shown: Waiting) -> tuple[dict[str, Any], float]:
    """The tables by name, and the share of the fibres beyond the requirement at the end."""
    from fiberloom.design.budget.conditions import attitudes, nights
    from fiberloom.design.budget.improve import improvements
    from fiberloom.design.budget.monte_carlo import alone_um, simulate
    from fiberloom.design.budget.terms import budget as budget_of
    from fiberloom.design.budget.terms import require_maps
    from fiberloom.instruments import generate
    from fiberloom.twin import draw_units

    require_maps(instrument)
    settings = settings_of(options, instrument)
    plane = generate(instrument, options.seed, n_positioners=options.units)
    shown.say("drawing units")
    bench = draw_units(plane, options.seed, errors=settings.errors.at_calibration())
    found = budget_of(plane, bench, settings)
    shown.say("one term after the other on the twin")
    alone = alone_um(plane, options.seed, settings, options.fields)
    shown.say("all terms on the twin")
    night = draw_units(plane, options.seed, errors=settings.errors)
    seen = simulate(plane, night, settings, options.fields, on_bench=bench)
    full = _full(options, plane, settings, shown)
    shown.say("attitudes, nights, tilts")
    requirement_um = instrument.operation.requirement_um
    report = {
        "terms": _terms(found, alone),
        "moves": _moves(found, seen, full, requirement_um),
        "halved": _halved(improvements(plane, bench, settings)),
        "attitudes": rounded(attitudes(plane, bench, settings, options.fields)),
        "nights": rounded(nights(plane, bench, settings, options.fields)),
        "tilts": _tilts(options, plane),
    }
    return report, found.beyond(settings.corrections, requirement_um)


def settings_of(options: BudgetOptions, instrument: Any) -> BudgetSettings:
    """Of the `options`, with the sizes of errors that the `instrument` says."""
    from fiberloom.design.budget.terms import BudgetSettings
    from fiberloom.twin.errors.sizes import TwinErrors

    errors = TwinErrors.of(instrument, options.errors)
    return BudgetSettings(options.corrections, options.knots, options.zenith, options.turn, errors)


def _full(options: BudgetOptions, plane: FocalPlane, settings: BudgetSettings, shown: Waiting) -> list[float]:
    """True errors of each move on the full twin; empty: not asked for."""
    if not options.observe:
        return []
    import tempfile

    from fiberloom.field import Field
    from fiberloom.instruments import generate
    from fiberloom.targets.generate import random_targets

    shown.say("the full twin: maps, targets, moves, images")
    some = generate(plane.instrument, options.seed, n_positioners=options.observe)
    targets = random_targets(some, 4 * options.observe, options.seed)
    field = Field.twin(some, options.seed, camera="noise", errors=options.errors)
    with tempfile.TemporaryDirectory() as folder:
        seen = field.run.observe(targets, settings.corrections, out=folder)
    return [float(move["true_rms_um"]) for move in seen.summary()["moves"]]


def _terms(found: Budget, alone: dict[str, Alone]) -> list[dict[str, Any]]:
    return [
        {
            "term": one.name,
            "blind_um": round(one.blind_um, 3),
            "blind_um_twin": _told(alone, one.name, "blind_um"),
            "corrected_um": round(one.corrected_um, 3),
            "corrected_um_twin": _told(alone, one.name, "corrected_um"),
        }
        for one in found.terms
    ]


def _told(alone: dict[str, Alone], name: str, which: str) -> float | str:
    """Empty: the twin does not have the term there, or not alone."""
    um = getattr(alone[name], which) if name in alone else None
    return "" if um is None else round(um, 3)


def _moves(found: Budget, seen: Simulated, full: list[float], requirement_um: float) -> list[dict[str, Any]]:
    from fiberloom.design.budget.tilt import RAYLEIGH_95

    rows = []
    for k, um in enumerate(found.total_um):
        row = {
            "corrections": k,
            "rms_um": round(um, 3),
            "p95_um": round(RAYLEIGH_95 * um, 3),
            "rms_um_twin": round(float(seen.rms_um[k]), 3),
            "rms_error_um_twin": round(float(seen.rms_error_um[k]), 3),
            "p95_um_twin": round(float(seen.p95_um[k]), 3),
            "beyond_requirement_percent": round(100.0 * found.beyond(k, requirement_um), 3),
        }
        rows.append(row | (_beside_full(um, full[k]) if full else {}))
    return rows


def _beside_full(um: float, full_um: float) -> dict[str, float]:
    return {
        "rms_um_full_twin": round(full_um, 3),
        "formula_beside_it_percent": round(100.0 * (um / full_um - 1.0), 1),
    }


def _halved(found: list[Any]) -> list[dict[str, Any]]:
    return [
        {
            "halved": one.change,
            "blind_um": round(one.blind_um, 3),
            "won_blind_um": round(one.blind_won_um, 3),
            "blind_slope": round(one.blind_slope, 3),
            "corrected_um": round(one.corrected_um, 3),
            "won_corrected_um": round(one.corrected_won_um, 3),
            "corrected_slope": round(one.corrected_slope, 3),
        }
        for one in found
    ]


def rounded(found: Sequence[Attitude | Night]) -> list[dict[str, float]]:
    """Rows of attitudes or nights, as they are printed."""
    return [{name: round(value, 3) for name, value in vars(one).items()} for one in found]


def _tilts(options: BudgetOptions, plane: FocalPlane) -> list[dict[str, Any]]:
    """By formula and by turning arms and fibres; empty: no beam is told."""
    from fiberloom.design.budget.tilt import simulated_tilts, tilted

    asked = tilts_of(options, plane.instrument)
    if asked is None:
        return []
    ways = {
        "formula": tilted(plane, asked),
        "twin": simulated_tilts(plane, asked, options.seed, options.fields),
    }
    return [
        {"figure": name, **{way: round(getattr(found, name), 4) for way, found in ways.items()}}
        for name in vars(ways["formula"])
    ]


def tilts_of(options: BudgetOptions, instrument: Instrument) -> Tilts | None:
    """Of the `options`, and what the `instrument` accepts on a bench; None: no beam is told."""
    from fiberloom.design.budget.tilt import Tilts

    alpha_deg, beta_deg = _two_tilts(options.axis_tilt)
    if options.focal_ratio is None:
        return None
    return Tilts(
        focal_ratio=options.focal_ratio,
        alpha_deg=alpha_deg,
        beta_deg=beta_deg,
        fibre_deg=_fibre_tilt(options, instrument),
        collimator_ratio=options.collimator,
        curvature_mm=math.inf if options.curvature is None else options.curvature,
    )


def _fibre_tilt(options: BudgetOptions, instrument: Instrument) -> float:
    """As asked for; else what leaves 95 % of the fibres within what a bench accepts."""
    from fiberloom.design.budget.tilt import RAYLEIGH_95

    if options.fibre_tilt is not None:
        return options.fibre_tilt
    accepted_deg = None if instrument.acceptance is None else instrument.acceptance.tilt_deg
    return 0.0 if accepted_deg is None else accepted_deg / RAYLEIGH_95


def _two_tilts(text: str) -> tuple[float, float]:
    try:
        alpha, beta = (float(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"--axis-tilt {text}: give two angles in deg, alpha,beta, as in 0.1,0.1") from None
    return alpha, beta
