"""`fiberloom design throughput`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.design.coverage import DesignOptions
from fiberloom.cli.options import require_instrument
from fiberloom.errors import InputError

if TYPE_CHECKING:
    from fiberloom.design.throughput import CorrectionCosts, FibreOptics
    from fiberloom.instruments import Instrument


@dataclass(frozen=True, kw_only=True)
class ExposureOptions(DesignOptions):
    """Of commands that count exposures."""

    exposure: Annotated[float, typer.Option(help="Length of an exposure, s.")] = 900.0


@dataclass(frozen=True, kw_only=True)
class ThroughputOptions(ExposureOptions):
    """Of `fiberloom design throughput`."""

    core: Annotated[float, typer.Option(help="Diameter of the fibre in the focal plane, um.")]
    scale: Annotated[float, typer.Option(help="Of the focal plane, um per arcsec.")]
    seeing: Annotated[float, typer.Option(help="Full width at half maximum, arcsec.")] = 1.0
    blind: Annotated[
        float | None, typer.Option(help="Error of the blind move, um rms; default: that of [drive].")
    ] = None
    remains: Annotated[float, typer.Option(help="Share of an error that a correction leaves.")] = 0.24
    each: Annotated[float, typer.Option(help="Time of a correction, s; 0 if hidden behind a readout.")] = 9.5
    defocus: Annotated[
        float, typer.Option(help="Of the fibres along the beam, um rms (design budget); with --focal-ratio.")
    ] = 0.0
    focal_ratio: Annotated[float | None, typer.Option(help="Of the beam.")] = None
    overhead: Annotated[float, typer.Option(help="Between exposures, without corrections, s.")] = 60.0


def throughput(options: ThroughputOptions) -> None:
    """What a micrometre costs in light, and how many corrections pay for their time.

    A point source in Moffat seeing (beta 3.5), relative to a centred fibre; speed is that of a survey limited
    by the sky. What is left after corrections is the noise of the instrument's camera.
    """
    require_instrument(options.file)
    if (options.focal_ratio is None) != (options.defocus == 0.0):
        raise InputError("--defocus, --focal-ratio: the light that blur costs needs both")
    from fiberloom.instruments import load_instrument

    rows, told = throughput_tables(options, load_instrument(options.file))
    if options.as_json:
        options.print_json({"corrections": rows, "summary": told})
        return
    options.show(rows)
    options.show(told)


def throughput_tables(
    options: ThroughputOptions, instrument: Instrument
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Rows of the numbers of corrections, and the summary, as they are printed."""
    from fiberloom.design.throughput import CorrectionCosts, FibreOptics

    optics = FibreOptics(options.core, options.scale, options.seeing)
    blind_um = instrument.drive.blind_um if options.blind is None else options.blind
    floor_um = instrument.metrology.noise_rms_um
    moves = CorrectionCosts(blind_um, options.remains, floor_um, options.each)
    requirement_um = instrument.operation.requirement_um
    told = _summary(options, optics, moves, requirement_um)
    return _moves(options, optics, moves, requirement_um), told


def _moves(
    options: ThroughputOptions, optics: FibreOptics, moves: CorrectionCosts, requirement_um: float
) -> list[dict[str, Any]]:
    from fiberloom.design.throughput import speeds

    speed = speeds(optics, moves, options.exposure, options.overhead)
    return [
        {
            "corrections": k,
            "rms_um": round(moves.rms_um(k), 3),
            "light_lost_percent": round(100.0 * optics.mean_loss(moves.rms_um(k)), 3),
            "beyond_requirement_percent": round(100.0 * moves.beyond(k, requirement_um), 3),
            "speed": round(float(speed[k]), 5),
        }
        for k in range(5)
    ]


def _summary(
    options: ThroughputOptions, optics: FibreOptics, moves: CorrectionCosts, requirement_um: float
) -> dict[str, Any]:
    from fiberloom.design.throughput import best_corrections, needed_corrections, speeds

    speed = speeds(optics, moves, options.exposure, options.overhead)
    best = best_corrections(optics, moves, options.exposure, options.overhead)
    needed = needed_corrections(moves, requirement_um)
    number = "not with 8" if needed is None else needed
    cost = None if needed is None else round(100.0 * float(1.0 - speed[needed] / speed[best]), 3)
    told = {} if options.focal_ratio is None else _blurred(optics, options.defocus, options.focal_ratio)
    return told | {
        "centred_share": round(optics.centred, 4),
        "loss_per_um2": f"{optics.k_per_um2:.3e}",
        "best_for_light": best,
        "needed_for_99_percent_within": f"{requirement_um:g} um: {number}",
        "requirement_costs_percent_of_speed": cost,
    }


def _blurred(optics: FibreOptics, defocus_um: float, focal_ratio: float) -> dict[str, Any]:
    lost = optics.mean_defocus_loss(defocus_um, focal_ratio)
    return {"defocus_loses_percent": round(100.0 * lost, 3)}
