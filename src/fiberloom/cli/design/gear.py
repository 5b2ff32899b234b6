"""`fiberloom design gear` and `fiberloom design spring`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.design.coverage import DesignOptions
from fiberloom.cli.options import require_instrument
from fiberloom.errors import InputError
from fiberloom.report.folder import prepare_file

if TYPE_CHECKING:
    from fiberloom.design.gear import GearWindow, Reconfiguration
    from fiberloom.design.spring import SpringWindow

OutOption = Annotated[Path | None, typer.Option(help="Diagram to draw, PNG.")]


@dataclass(frozen=True, kw_only=True)
class GearOptions(DesignOptions):
    """Of `fiberloom design gear`."""

    motor_error: Annotated[float, typer.Option(help="Of the controlled motor, deg.")] = 5.0
    motor_rpm: Annotated[
        float | None, typer.Option(help="What the motor can do, rpm; default: what it is asked for.")
    ] = None
    within: Annotated[float | None, typer.Option(help="Time for the whole range of an axis, s.")] = None
    planned: Annotated[
        int, typer.Option(min=0, help="Plan random fields of so many positioners: time of a reconfiguration.")
    ] = 0
    fields: Annotated[int, typer.Option(min=2, help="Pairs of random fields, with --planned.")] = 8
    seed: Annotated[int, typer.Option(min=0, help="The one seed of everything random.")] = 0
    out: OutOption = None


def gear(options: GearOptions) -> int:
    """The window of the reduction ratio: accurate enough for the requirement, fast enough for a time.

    Play and steps at the longest lever are told beside it. Exit code 1 where a ratio is outside its
    window.
    """
    require_instrument(options.file)
    if options.out is not None:
        prepare_file(options.out)
    from fiberloom.design.gear import gear_window
    from fiberloom.instruments import load_instrument

    instrument = load_instrument(options.file)
    found = [
        gear_window(instrument, axis, options.motor_error, options.motor_rpm, options.within)
        for axis in (0, 1)
    ]
    if options.out is not None:
        from fiberloom.design.figures import draw_gear

        draw_gear(options.out, instrument.name, found)
    rows, times = [gear_row(one) for one in found], []
    if options.planned:
        from fiberloom.design.gear import reconfiguration

        times = [
            reconfiguration_row(reconfiguration(instrument, options.planned, options.fields, options.seed))
        ]
    if options.as_json:
        options.print_json({"axes": rows, "reconfiguration": times[0]} if times else rows)
    else:
        options.show(rows)
        for row in times:
            options.show(row)
        for one in found:
            if not one.fits:
                typer.echo(f"{one.axis}: {one.advice()}")
    return int(not all(one.fits for one in found))


def gear_row(one: GearWindow) -> dict[str, Any]:
    """As it is printed."""
    return {
        "axis": one.axis,
        "lever_mm": round(one.lever_mm, 3),
        "output_deg": round(one.output_deg, 4),
        "least_ratio": one.least,
        "ratio": one.ratio,
        "most_ratio": round(one.most, 1) if math.isfinite(one.most) else "any",
        "fits": "no gear" if not one.geared else "yes" if one.fits else "no",
        "motor_deg_um": round(one.motor_deg_um, 3),
        "step_um": round(one.step_um, 3),
        "play_um": round(one.play_um, 1),
        "motor_rpm": round(one.motor_rpm),
        "range_s": round(one.range_s, 2),
    }


def reconfiguration_row(one: Reconfiguration) -> dict[str, Any]:
    """As it is printed."""
    return {
        "positioners": one.positioners,
        "fields": one.fields,
        "reconfiguration_s": round(one.motion_s, 2),
        "error_s": round(one.motion_error_s, 2),
        "over_longest_way": round(one.over_least, 3),
        "refused_in_a_field": round(one.refused, 2),
    }


@dataclass(frozen=True, kw_only=True)
class SpringOptions(DesignOptions):
    """Of `fiberloom design spring`."""

    load: Annotated[
        str | None,
        typer.Option(help="Largest outside torque on alpha,beta, mNm; default 1.45,0.12 (assumed arms)."),
    ] = None
    factor: Annotated[float, typer.Option(help="Margin asked for, for scatter and cold grease.")] = 2.0
    seed: Annotated[int, typer.Option(min=0, help="The one seed of everything random.")] = 0
    out: OutOption = None


def spring(options: SpringOptions) -> int:
    """The window of the spring against backlash, over 500 units: what closes the play, what holds still.

    Torques are at the output; margins are of the median and of the worst unit. Exit code 1 where the
    median unit of an axis is outside its window.
    """
    require_instrument(options.file)
    if options.out is not None:
        prepare_file(options.out)
    loads = _loads(options.load)
    from fiberloom.design.spring import spring_window
    from fiberloom.instruments import load_instrument

    instrument = load_instrument(options.file)
    found = [spring_window(instrument, axis, loads[axis], options.factor, options.seed) for axis in (0, 1)]
    if options.out is not None:
        from fiberloom.design.figures import draw_spring

        draw_spring(options.out, instrument.name, found)
    rows = [spring_row(one) for one in found]
    if options.as_json:
        options.print_json(rows)
    else:
        for row in rows:
            options.show(row)
    return int(any(one.advice() != "fits" for one in found))


def _loads(text: str | None) -> tuple[float | None, float | None]:
    if text is None:
        return None, None
    try:
        alpha, beta = (float(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"--load {text}: give two torques in mNm, alpha,beta, as in 1.45,0.12") from None
    return alpha, beta


def spring_row(one: SpringWindow) -> dict[str, Any]:
    """As it is printed."""
    import numpy as np

    row: dict[str, Any] = {
        "axis": one.axis,
        "weakest_mNm": round(float(np.median(one.weakest_mNm)), 3),
        "strongest_mNm": round(float(np.median(one.strongest_mNm)), 3),
        "friction_mNm": round(float(np.median(one.friction_mNm)), 3),
        "load_mNm": one.load_mNm,
        "window_mNm": f"{one.low_mNm:.2f} to {one.high_mNm:.2f}",
    }
    for name in ("closes", "holds", "turns"):
        margin = getattr(one, name)
        row[f"{name}_by"] = f"{np.median(margin):.2f}, worst {margin.min():.2f}"
    return row | {
        "share_within": round(one.good_share, 3),
        "error_within": round(one.good_error, 3),
        "advice": one.advice(),
    }
