"""`fiberloom sky drift`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.sky.place import SkyOptions
from fiberloom.errors import InputError
from fiberloom.report.folder import prepare_file

if TYPE_CHECKING:
    from fiberloom.sky.chain import Chain
    from fiberloom.sky.sky_targets import SkyTargets

STANDARD_S = (900.0, 1800.0, 3600.0)


@dataclass(frozen=True, kw_only=True)
class DriftOptions(SkyOptions):
    """Of `fiberloom sky drift`."""

    targets: Annotated[
        Path | None,
        typer.Argument(help="List with ra and dec, or a confSummary; default: places all over the field."),
    ] = None
    limit: Annotated[float, typer.Option(help="What may be left after guiding, um.")] = 5.0
    out: Annotated[Path | None, typer.Option(help="CSV to write: the drift of each target.")] = None


def drift(options: DriftOptions) -> None:
    """How far targets move over their fibres during an exposure, before and after guiding, and how long
    an exposure may be.

    Fibres are placed for the middle; pointing and rotator are ideal. Exposures of the field file, and of
    15, 30 and 60 minutes.
    """
    if options.out is not None:
        if options.targets is None:
            raise InputError("--out: goes with a list of targets")
        prepare_file(options.out)
    chain, targets, exposure_s = _read(options)
    rows, lines = [], ["target_id,fibre,exposure_s,drift_um,drift_guided_um"]
    for fibre, some in _by_fibre(chain, targets):
        rows += _table(chain, fibre, some, exposure_s, options.limit)
        lines += _each(chain, fibre, some, exposure_s)
    if options.out is not None:
        from fiberloom.wholefile import write_whole

        write_whole(options.out, "\n".join(lines) + "\n")
    options.show(rows)


def _read(options: DriftOptions) -> tuple[Chain, SkyTargets, float]:
    """The chain at the middle of the exposure, the targets, and the exposure in s."""
    from fiberloom.sky.drift import field_grid

    if options.targets is not None:
        found, field, chain = options.read(options.targets)
        found.placed(chain)  # refuses what is outside
        return chain, found.targets, field.exposure_s
    options.check()
    field = options.read_field()
    chain = field.chain(options.model(), options.field)
    return chain, field_grid(chain), field.exposure_s


def _by_fibre(chain: Chain, targets: SkyTargets) -> Iterator[tuple[str, SkyTargets]]:
    """Targets that a fibre may take."""
    for fibre in chain.instrument.science_fibres:
        rows = (targets.fibre == "") | (targets.fibre == fibre)
        if rows.any():
            yield fibre, targets.select(rows)


def _table(
    chain: Chain, fibre: str, some: SkyTargets, exposure_s: float, limit_um: float
) -> list[dict[str, Any]]:
    from fiberloom.sky.drift import drift as drift_of
    from fiberloom.sky.drift import longest_s

    longest = longest_s(chain, some, limit_um, fibre)
    rows = []
    for seconds in sorted({*STANDARD_S, *((exposure_s,) if exposure_s else ())}):
        try:
            plain, guided = drift_of(chain, some, seconds, fibre).largest_um
        except InputError:  # the field is not above the horizon all the time
            continue
        rows.append(
            {
                "fibre": fibre,
                "airmass": chain.airmass,
                "exposure_min": seconds / 60.0,
                "largest_um": plain,
                "largest_guided_um": guided,
                "limit_um": limit_um,
                "longest_min": longest / 60.0,
            }
        )
    return rows


def _each(chain: Chain, fibre: str, some: SkyTargets, exposure_s: float) -> Iterator[str]:
    """Lines of the file: every target for the exposure of the field."""
    from fiberloom.sky.drift import drift as drift_of

    found = drift_of(chain, some, exposure_s, fibre)
    for name, plain, guided in zip(some.target_id, found.plain_um, found.guided_um, strict=True):
        yield f"{name},{fibre},{exposure_s:g},{plain:.3f},{guided:.3f}"
