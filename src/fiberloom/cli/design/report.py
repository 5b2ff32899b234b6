"""`fiberloom design report`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.design.budget import BeamOptions
from fiberloom.cli.design.check import CheckOptions
from fiberloom.cli.options import require_instrument
from fiberloom.cli.terminal import Waiting, waiting
from fiberloom.errors import InputError
from fiberloom.report.folder import prepare_file

if TYPE_CHECKING:
    from fiberloom.cli.design.budget import BudgetOptions
    from fiberloom.design.page import DesignSection
    from fiberloom.instruments import Instrument

PAIRS = 4
"""Of random fields that are planned."""
RINGS = 6
"""Of the patch on which targets are observed."""


@dataclass(frozen=True, kw_only=True)
class ReportOptions(BeamOptions, CheckOptions):
    """Of `fiberloom design report`."""

    out: Annotated[Path, typer.Option(help="Page to write, HTML, with its pictures inside.")] = Path(
        "design.html"
    )
    core: Annotated[
        float | None, typer.Option(help="Diameter of the fibre in the focal plane, um; with --scale.")
    ] = None
    scale: Annotated[float | None, typer.Option(help="Of the focal plane, um per arcsec; with --core.")] = (
        None
    )
    fields: Annotated[int, typer.Option(min=2, help="Random fields of targets, for the shares.")] = 4
    units: Annotated[int, typer.Option(min=7, help="Of the twin, for the error budget.")] = 61


def report(options: ReportOptions) -> int:
    """All of a design on one page: check, coverage, efficiency, gear, spring, budget, power, throughput.

    What is not known of the motors is left out, with the reason. Exit code 1 where the check finds something
    wrong.
    """
    require_instrument(options.file)
    if (options.core is None) != (options.scale is None):
        raise InputError("--core, --scale: the light that is lost needs both")
    prepare_file(options.out)
    import tempfile

    from fiberloom.design.check import check
    from fiberloom.design.page import design_html
    from fiberloom.instruments import load_instrument
    from fiberloom.wholefile import whole

    instrument = load_instrument(options.file)
    with tempfile.TemporaryDirectory() as folder, waiting() as shown:
        shown.say("check")
        found = check(instrument, options.seed, options.within)
        sections = list(_sections(options, instrument, [str(one) for one in found], Path(folder), shown))
        page = design_html(instrument.name, _head(options, instrument), sections)
        with whole(options.out) as part:
            part.write_text(page, encoding="utf-8")
    wrong = sum(one.wrong for one in found)
    options.show({"page": str(options.out), "sections": len(sections), "wrong": wrong})
    return int(wrong > 0)


def _head(options: ReportOptions, instrument: Instrument) -> dict[str, Any]:
    from fiberloom.instruments import generate
    from fiberloom.report.outputs import marks

    return {"description": instrument.description, **marks(generate(instrument, options.seed), options.seed)}


def _sections(
    options: ReportOptions, instrument: Instrument, found: list[str], folder: Path, shown: Waiting
) -> Iterator[DesignSection]:
    from fiberloom.design.page import DesignSection

    wrong = sum(line.startswith("wrong") for line in found)
    notes = len(found) - wrong
    title = f"Check: {wrong or 'nothing'} wrong, {notes or 'no'} {'note' if notes == 1 else 'notes'}"
    yield DesignSection(title, found)
    for title, make in (
        ("Coverage", _coverage),
        ("Efficiency", _efficiency),
        ("Gear", _gear),
        ("Spring", _spring),
        ("Error budget", _budget),
        ("Power", _power),
        ("Throughput", _throughput),
    ):
        shown.say(title.lower())
        yield from _made(title, make, options, instrument, folder)


_Make = Callable[["ReportOptions", "Instrument", Path], "DesignSection | None"]


def _made(
    title: str, make: _Make, options: ReportOptions, instrument: Instrument, folder: Path
) -> Iterator[DesignSection]:
    """One section; what a tool refuses is said in its place."""
    from fiberloom.design.page import DesignSection

    try:
        section = make(options, instrument, folder)
    except InputError as error:
        section = DesignSection(title, [f"not looked at: {error}"])
    if section is not None:
        yield section


def _coverage(options: ReportOptions, instrument: Instrument, folder: Path) -> DesignSection:
    from fiberloom.cli.design.coverage import CoverageOptions, coverage_row
    from fiberloom.design.page import DesignSection

    picture = folder / "coverage.png"
    fibres = instrument.science_fibres
    outs = [picture, *[None] * (len(fibres) - 1)]
    rows = [
        coverage_row(
            CoverageOptions(file=options.file, fibre=fibre, seed=options.seed, out=out), instrument, fibre
        )
        for fibre, out in zip(fibres, outs, strict=True)
    ]
    fills = [row.pop("holes_filled_by", "no holes") for row in rows]
    says = [
        f"{fibre}: holes are filled by {' or '.join(fill)}."
        for fibre, fill in zip(fibres, fills, strict=True)
        if not isinstance(fill, str)
    ]
    reached, mean = rows[0]["share_1_or_more"], rows[0]["mean_in_ranges"]
    hole = f", holes of {rows[0]['hole_um']:g} um" if rows[0]["hole_um"] else ""
    title = f"Coverage: {fibres[0]} reaches {reached:.2%} of the plane{hole}, {mean:.2f} fibres at a point"
    return DesignSection(title, says, [rows], picture)


def _efficiency(options: ReportOptions, instrument: Instrument, folder: Path) -> DesignSection:
    from fiberloom.cli.design.efficiency import efficiency_row
    from fiberloom.design.efficiency import EfficiencySettings, efficiency, endless, inner_part
    from fiberloom.design.figures import draw_efficiency
    from fiberloom.design.page import DesignSection

    fibre = instrument.science_fibres[0]
    where = inner_part(endless(instrument, RINGS), fibre)
    settings = EfficiencySettings(fields=options.fields, seed=options.seed)
    found = efficiency(where, fibre, [0.5, 1.0, 2.0, 4.0], settings)
    picture = folder / "efficiency.png"
    draw_efficiency(picture, f"{instrument.name}, {fibre}", found)
    last = found[-1]
    title = (
        f"Efficiency: {last.used:.1%} ± {last.used_error:.1%} of the fibres are used at {last.per_fibre:.2f} "
        f"targets per fibre"
    )
    caption = f"Means of {options.fields} random fields, with their standard errors."
    return DesignSection(title, (), [[efficiency_row(one) for one in found]], picture, [caption])


def _gear(options: ReportOptions, instrument: Instrument, folder: Path) -> DesignSection:
    from fiberloom.cli.design.gear import gear_row, reconfiguration_row
    from fiberloom.design.figures import draw_gear
    from fiberloom.design.gear import gear_verdict, gear_window, reconfiguration
    from fiberloom.design.page import DesignSection

    found = [gear_window(instrument, axis, within_s=options.within) for axis in (0, 1)]
    picture = folder / "gear.png"
    draw_gear(picture, instrument.name, found)
    title = f"Gear: {gear_verdict(found)}"
    says = [f"{one.axis}: {one.advice()}" for one in found if not one.fits]
    tables, captions = [[gear_row(one) for one in found]], ["Both axes against their windows."]
    try:
        planned = reconfiguration(instrument, options.units, PAIRS, options.seed)
        tables.append([reconfiguration_row(planned)])
        captions.append("From one random field to another, as the planner makes it, with its standard error.")
    except InputError as error:
        says.append(f"reconfiguration not looked at: {error}")
    return DesignSection(title, says, tables, picture, captions)


def _spring(options: ReportOptions, instrument: Instrument, folder: Path) -> DesignSection:
    from fiberloom.cli.design.gear import spring_row
    from fiberloom.design.figures import draw_spring
    from fiberloom.design.page import DesignSection
    from fiberloom.design.spring import spring_window

    found = [spring_window(instrument, axis, seed=options.seed) for axis in (0, 1)]
    picture = folder / "spring.png"
    draw_spring(picture, instrument.name, found)
    told = [f"{one.axis} {'fits' if one.advice() == 'fits' else 'is outside its window'}" for one in found]
    caption = f"Medians of {len(found[0].closes)} units; the share within, with its standard error."
    rows = [spring_row(one) for one in found]
    return DesignSection(f"Spring: {', '.join(told)}", (), [rows], picture, [caption])


def _budget(options: ReportOptions, instrument: Instrument, folder: Path) -> DesignSection:
    from fiberloom.cli.design.budget import BudgetOptions, budget_report
    from fiberloom.design.page import DesignSection

    asked = BudgetOptions(
        file=options.file, units=options.units, fields=3, seed=options.seed, focal_ratio=options.focal_ratio
    )
    with waiting(quiet=True) as shown:
        found, beyond = budget_report(asked, instrument, shown)
    found |= _outside(asked, instrument)
    blind, last = found["moves"][0], found["moves"][-1]
    title = (
        f"Error budget: {blind['rms_um']:.2f} um rms blind, {last['rms_um']:.2f} after "
        f"{last['corrections']} corrections, {beyond:.1%} beyond {instrument.operation.requirement_um:g} um"
    )
    captions = [BUDGET_TABLES[name] for name in found]
    return DesignSection(title, (), list(found.values()), captions=captions)


BUDGET_TABLES = {
    "terms": "Terms, um rms: by formula, and alone on the twin.",
    "moves": "All together: by formula, and on the twin with the standard error over its units.",
    "halved": "What to improve first: each cause halved, and per cent of the error by per cent of the cause.",
    "attitudes": "Gravity at attitudes of the telescope (--errors all), um rms: blind, and after a turn of "
    "the rotator by 30 deg from image to exposure.",
    "nights": "Growth in nights that are warmer than the calibration (--errors all), um.",
    "tilts": "Tilted axes and fibres: by formula, and by arms turned in three dimensions.",
}
"""Captions."""
TURN_DEG = 30.0
"""Of the rotator, from image to exposure, for the table of attitudes."""


def _outside(asked: BudgetOptions, instrument: Instrument) -> dict[str, Any]:
    """Attitudes and nights, with the errors that move arms and plate, whatever the budget itself has."""
    from dataclasses import replace

    from fiberloom.cli.design.budget import rounded, settings_of
    from fiberloom.design.budget.conditions import attitudes, nights
    from fiberloom.instruments import generate
    from fiberloom.twin import draw_units

    settings = settings_of(replace(asked, errors="all", turn=TURN_DEG), instrument)
    plane = generate(instrument, asked.seed, n_positioners=asked.units)
    units = draw_units(plane, asked.seed, errors=settings.errors.at_calibration())
    return {
        "attitudes": rounded(attitudes(plane, units, settings, asked.fields)),
        "nights": rounded(nights(plane, units, settings, asked.fields)),
    }


def _power(options: ReportOptions, instrument: Instrument, folder: Path) -> DesignSection:
    from fiberloom.cli.design.power import array_row, axis_row
    from fiberloom.design.page import DesignSection
    from fiberloom.design.power import array_power

    found = array_power(instrument, seed=options.seed)
    axes = [axis_row(one) for one in (found.alpha, found.beta)]
    title = (
        f"Power: {found.peak_W:.3g} W and {found.peak_A:.2g} A with {found.n} at once, {found.move_J:.3g} J "
        "for a reconfiguration"
    )
    captions = ["One positioner, over its whole ranges.", "The array; the heat of a positioner is assumed."]
    return DesignSection(title, (), [axes, [array_row(found)]], captions=captions)


def _throughput(options: ReportOptions, instrument: Instrument, folder: Path) -> DesignSection | None:
    from fiberloom.cli.design.throughput import ThroughputOptions, throughput_tables
    from fiberloom.design.page import DesignSection

    if options.core is None or options.scale is None:
        return None
    asked = ThroughputOptions(file=options.file, core=options.core, scale=options.scale)
    rows, told = throughput_tables(asked, instrument)
    title = (
        f"Throughput: {told['best_for_light']} corrections pay for their time, "
        f"the requirement of {told['needed_for_99_percent_within']}"
    )
    return DesignSection(title, (), [rows, [told]], captions=["Point source in Moffat seeing of 1 arcsec."])
