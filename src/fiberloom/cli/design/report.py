"""`fiberloom design report`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.design.check import CheckOptions
from fiberloom.cli.options import require_instrument
from fiberloom.cli.terminal import Waiting, waiting
from fiberloom.errors import InputError
from fiberloom.report.folder import prepare_file

if TYPE_CHECKING:
    from fiberloom.design.page import DesignSection
    from fiberloom.instruments import Instrument

RINGS = 6
"""Of the patch on which targets are observed."""


@dataclass(frozen=True, kw_only=True)
class ReportOptions(CheckOptions):
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

    yield DesignSection("Check", found or ["Nothing is wrong."])
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
    return DesignSection("Coverage", (), [rows], picture)


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
    return DesignSection("Efficiency", (), [[efficiency_row(one) for one in found]], picture)


def _gear(options: ReportOptions, instrument: Instrument, folder: Path) -> DesignSection:
    from fiberloom.cli.design.gear import gear_row
    from fiberloom.design.figures import draw_gear
    from fiberloom.design.gear import gear_window
    from fiberloom.design.page import DesignSection

    found = [gear_window(instrument, axis, within_s=options.within) for axis in (0, 1)]
    picture = folder / "gear.png"
    draw_gear(picture, instrument.name, found)
    return DesignSection("Gear", (), [[gear_row(one) for one in found]], picture)


def _spring(options: ReportOptions, instrument: Instrument, folder: Path) -> DesignSection:
    from fiberloom.cli.design.gear import spring_row
    from fiberloom.design.figures import draw_spring
    from fiberloom.design.page import DesignSection
    from fiberloom.design.spring import spring_window

    found = [spring_window(instrument, axis, seed=options.seed) for axis in (0, 1)]
    picture = folder / "spring.png"
    draw_spring(picture, instrument.name, found)
    return DesignSection("Spring", (), [[spring_row(one) for one in found]], picture)


def _budget(options: ReportOptions, instrument: Instrument, folder: Path) -> DesignSection:
    from fiberloom.cli.design.budget import BudgetOptions, budget_report
    from fiberloom.design.page import DesignSection

    asked = BudgetOptions(file=options.file, units=options.units, fields=3, seed=options.seed)
    with waiting(quiet=True) as shown:
        found, _ = budget_report(asked, instrument, shown)
    return DesignSection("Error budget", (), list(found.values()))


def _power(options: ReportOptions, instrument: Instrument, folder: Path) -> DesignSection:
    from fiberloom.cli.design.power import array_row, axis_row
    from fiberloom.design.page import DesignSection
    from fiberloom.design.power import array_power

    found = array_power(instrument, seed=options.seed)
    axes = [axis_row(one) for one in (found.alpha, found.beta)]
    return DesignSection("Power", (), [axes, [array_row(found)]])


def _throughput(options: ReportOptions, instrument: Instrument, folder: Path) -> DesignSection | None:
    from fiberloom.cli.design.throughput import ThroughputOptions, throughput_tables
    from fiberloom.design.page import DesignSection

    if options.core is None or options.scale is None:
        return None
    asked = ThroughputOptions(file=options.file, core=options.core, scale=options.scale)
    rows, told = throughput_tables(asked, instrument)
    return DesignSection("Throughput", (), [rows, [told]])
