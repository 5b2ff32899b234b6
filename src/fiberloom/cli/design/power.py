"""`fiberloom design power`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.design.coverage import DesignOptions
from fiberloom.cli.options import require_instrument
from fiberloom.errors import InputError

if TYPE_CHECKING:
    from fiberloom.design.power import ArrayPower, Limited, MovePower


@dataclass(frozen=True, kw_only=True)
class PowerOptions(DesignOptions):
    """Of `fiberloom design power`."""

    positioners: Annotated[int | None, typer.Option(min=1, help="That move at once; default: all.")] = None
    ways: Annotated[
        str | None, typer.Option(help="Of alpha,beta, deg, as in 120,60; default: the whole ranges.")
    ] = None
    every: Annotated[float, typer.Option(help="From one reconfiguration to the next, s.")] = 900.0
    rest: Annotated[float, typer.Option(help="Of the electronics of one positioner, W.")] = 0.0
    limit: Annotated[float | None, typer.Option(help="Power of the supply for the motors, W.")] = None
    seed: Annotated[int, typer.Option(min=0, help="The one seed of everything random.")] = 0


def power(options: PowerOptions) -> int:
    """Current, power and heat of an array that moves; with --limit the time that the limit costs.

    In closed loop, by the motors of the twin; electronics at rest are not published: --rest. The lines of
    [care] are what plans then keep. Exit code 1 where the limit is below what the speeds ask for.
    """
    require_instrument(options.file)
    ways = _ways(options.ways)
    from fiberloom.design.power import PowerSettings, array_power, care_lines, limited
    from fiberloom.instruments import load_instrument

    instrument = load_instrument(options.file)
    asked = PowerSettings(options.positioners, ways, options.every, options.rest)
    found = array_power(instrument, asked, options.seed)
    report: dict[str, Any] = {"axes": [axis_row(one) for one in (found.alpha, found.beta)]}
    report["array"] = array_row(found)
    slower = False
    if options.limit is not None:
        within = limited(instrument, options.limit, asked, options.seed)
        report["limit"] = _limit(within)
        slower = within.speed_share < 1.0
        report["care"] = care_lines(instrument, options.limit, options.seed)
    _show(options, report)
    return int(slower)


def _show(options: PowerOptions, report: dict[str, Any]) -> None:
    if options.as_json:
        options.print_json(report)
        return
    for name in ("axes", "array", "limit"):
        if name in report:
            options.show(report[name])
    for line in report.get("care", ()):
        typer.echo(line)


def _ways(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        alpha, beta = (float(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"--ways {text}: give two angles in deg, alpha,beta, as in 120,60") from None
    return alpha, beta


def axis_row(one: MovePower) -> dict[str, Any]:
    """As it is printed."""
    return {
        "axis": one.axis,
        "way_deg": one.way_deg,
        "time_s": round(one.time_s, 2),
        "torque_uNm": round(one.torque_uNm, 1),
        "copper_J": round(one.copper_J, 4),
        "supply_J": round(one.supply_J, 4),
        "peak_W": round(one.peak_W, 5),
        "mean_mA": round(1e3 * one.mean_A, 3),
        "peak_mA": round(1e3 * one.peak_A, 3),
    }


def array_row(found: ArrayPower) -> dict[str, Any]:
    """As it is printed."""
    return {
        "positioners": found.n,
        "time_s": round(found.time_s, 2),
        "peak_W": round(found.peak_W, 2),
        "peak_A": round(found.peak_A, 3),
        "heat_of_a_reconfiguration_J": round(found.move_J, 1),
        "one_is_warmer_by_it_K": round(found.warmer_by_move_K, 3),
        "one_is_warmer_in_the_long_run_K": round(found.warmer_K, 3),
    }


def _limit(within: Limited) -> dict[str, Any]:
    slower = f"{within.slower_s:.2f} at {within.speed_share:.0%} of the speed"
    return {
        "limit_W": within.limit_W,
        "all_together_slower_s": slower if within.speed_share else "never",
        "in_waves_s": f"{within.waves_s:.2f} in {within.waves}",
        "least_time_s": round(within.time_s, 2),
    }
