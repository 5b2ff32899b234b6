"""`fiberloom design coverage`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.options import JsonOptions, require_instrument
from fiberloom.errors import InputError
from fiberloom.report.folder import prepare_file

if TYPE_CHECKING:
    from fiberloom.design.coverage import ArrayCoverage, Coverage
    from fiberloom.design.lattice import Lattice, Pattern
    from fiberloom.instruments import Instrument


@dataclass(frozen=True, kw_only=True)
class DesignOptions(JsonOptions):
    """Of a command that looks at a design."""

    file: Annotated[str, typer.Argument(help="Preset name, or a TOML file of your own.")]


@dataclass(frozen=True, kw_only=True)
class CoverageOptions(DesignOptions):
    """Of `fiberloom design coverage`."""

    fibre: Annotated[str | None, typer.Option(help="One fibre; default: every science fibre.")] = None
    arms: Annotated[str | None, typer.Option(help="Other arms, mm: alpha,beta as in 7.4,15.")] = None
    pitch: Annotated[float | None, typer.Option(help="Another pitch, mm.")] = None
    share: Annotated[
        str | None,
        typer.Option(help="Only so many of so many units have the fibre: 3/5, in the best pattern."),
    ] = None
    array: Annotated[
        bool, typer.Option("--array", help="Also the whole array, with its edge and obstacles.")
    ] = False
    broken: Annotated[int, typer.Option(min=0, help="With --array: so many units are broken.")] = 0
    seed: Annotated[int, typer.Option(min=0, help="The one seed of everything random.")] = 0
    out: Annotated[Path | None, typer.Option(help="Map to draw, PNG; with one fibre.")] = None


def coverage(options: CoverageOptions) -> None:
    """How many fibres reach each point of the focal plane, where holes are, and what fills them.

    Least and most are exact, for axes without limits; shares are counted on 100000 points of an endless
    lattice, within the ranges of both axes. With --array every fibre counts where its own unit has it.
    """
    require_instrument(options.file)
    if options.broken and not options.array:
        raise InputError("--broken: goes with --array")
    if options.out is not None:
        prepare_file(options.out)
    from fiberloom.instruments import load_instrument

    instrument = load_instrument(options.file)
    fibres = [options.fibre] if options.fibre else list(instrument.science_fibres)
    if options.out is not None and len(fibres) > 1:
        raise InputError(f"--out: one map is of one fibre; add --fibre, one of {', '.join(fibres)}")
    rows = [coverage_row(options, instrument, fibre) for fibre in fibres]
    if options.as_json:
        options.print_json(rows)
        return
    for row in rows:
        options.show(row)


def coverage_row(options: CoverageOptions, instrument: Instrument, fibre: str) -> dict[str, Any]:
    """As it is printed; draws the map where one is asked for."""
    from fiberloom.design.coverage import coverage as coverage_of
    from fiberloom.design.coverage import fillings

    lattice = _lattice(options, instrument, fibre)
    pattern = _pattern(options, lattice)
    found = coverage_of(lattice, pattern, seed=options.seed)
    array = _array(options, instrument, fibre) if options.array else None
    if options.out is not None:
        from fiberloom.design.figures import draw_coverage

        draw_coverage(options.out, f"{instrument.name}, {fibre}", lattice, pattern, found, array)
    row = _row(fibre, lattice, found, array)
    if pattern.period > 1:
        return row | {"pattern": _told(pattern)}
    fills = [_fill(f) for f in fillings(lattice)]
    return row | {"hole_um": round(found.hole_um, 2), "holes_filled_by": fills or "no holes"}


def _lattice(options: CoverageOptions, instrument: Instrument, fibre: str) -> Lattice:
    from fiberloom.design.lattice import Lattice

    lattice = Lattice.of(instrument, fibre)
    lengths: dict[str, float] = {}
    if options.arms is not None:
        lengths |= dict(zip(("l_alpha_mm", "l_beta_mm"), _arms(options.arms), strict=True))
    if options.pitch is not None:
        lengths["pitch_mm"] = options.pitch
    if lengths and options.array:
        raise InputError("--arms, --pitch: of an endless lattice; for --array change the file")
    return lattice.changed(**lengths)


def _arms(text: str) -> tuple[float, float]:
    try:
        alpha, beta = (float(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"--arms {text}: give two lengths in mm, alpha,beta, as in 7.4,15") from None
    return alpha, beta


def _pattern(options: CoverageOptions, lattice: Lattice) -> Pattern:
    from fiberloom.design.coverage import best_pattern
    from fiberloom.design.lattice import EVERY

    if options.share is None:
        return EVERY
    try:
        carried, period = (int(word) for word in options.share.split("/"))
    except ValueError:
        raise InputError(f"--share {options.share}: so many of so many units, as in 3/5") from None
    return best_pattern(lattice, carried, period, options.seed)


def _array(options: CoverageOptions, instrument: Instrument, fibre: str) -> ArrayCoverage:
    from fiberloom.design.coverage import array_coverage, broken_plane
    from fiberloom.instruments import generate

    plane = generate(instrument, options.seed)
    return array_coverage(broken_plane(plane, options.broken, options.seed), fibre)


def _row(fibre: str, lattice: Lattice, found: Coverage, array: ArrayCoverage | None) -> dict[str, Any]:
    row: dict[str, Any] = {
        "fibre": fibre,
        "reach_mm": round(lattice.reach_mm, 4),
        "folded_mm": round(lattice.hole_mm, 4),
        "mean_exact": round(found.mean_exact, 4),
        "mean_in_ranges": round(found.mean, 4),
        "least": found.least,
        "most": found.most,
    }
    row |= {f"share_{k}_or_more": round(float(found.at_least[k]), 4) for k in range(1, 5)}
    row["error_of_shares"] = round(found.standard_error, 4)
    if array is not None:
        row |= {
            "array_reached": round(array.covered, 4),
            "array_blocked": round(float(array.blocked.mean()), 4),
            "array_without_mm2": round(array.hole_mm2, 1),
        }
    return row


def _told(pattern: Pattern) -> str:
    rows = "r // 2" if pattern.staggered else "r"
    return f"(q + {pattern.slope} {rows}) mod {pattern.period} in {list(pattern.carried)}"


def _fill(filling: Any) -> str:
    return f"{filling.length} {filling.from_mm:g} -> {filling.to_mm:.4f}"
