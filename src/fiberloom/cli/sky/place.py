"""`fiberloom sky place` and `fiberloom sky where`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fiberloom.cli.options import JsonOptions, require_file, require_instrument
from fiberloom.errors import InputError
from fiberloom.report.folder import prepare_file

if TYPE_CHECKING:
    import numpy as np

    from fiberloom.instruments import Instrument
    from fiberloom.sky.chain import Chain
    from fiberloom.sky.sky_field import SkyField
    from fiberloom.tables import TableFile
    from fiberloom.targets.sky_list import SkyList
    from fiberloom.typing import Floats

FieldOption = Annotated[
    Path | None,
    typer.Option(help="TOML file of the field on the sky: centre, position angle, time, site, weather."),
]
ListArgument = Annotated[
    Path, typer.Argument(help="CSV, ECSV or FITS with ra and dec, or a confSummary file.")
]
DIGITS = 9


@dataclass(frozen=True, kw_only=True)
class SkyOptions(JsonOptions):
    """Of commands between the sky and the focal plane."""

    field: FieldOption = None
    instrument: Annotated[str, typer.Option(help="Preset name, or a TOML file of your own.")] = "sdssv"

    def check(self) -> None:
        """Raises InputError for what can be found wrong without a slow import."""
        require_file(self.field)
        require_instrument(self.instrument)

    def model(self) -> Instrument:
        """The instrument."""
        from fiberloom.instruments import load_instrument

        return load_instrument(self.instrument)

    def read_field(self, own: SkyField | None = None) -> SkyField:
        """The field of the file that was named, or else `own`, that of a list."""
        from fiberloom.sky.sky_field import SkyField

        if self.field is not None:
            return SkyField.read(self.field)
        if own is None:
            raise InputError(
                "--field: name the TOML file of the field (ra_deg, dec_deg, time, time_scale, ...)"
            )
        return own

    def read(self, path: Path) -> tuple[SkyList, SkyField, Chain]:
        """A list, its field, and the way from one to the other."""
        from fiberloom.targets.read import read_sky

        self.check()
        found, own = read_sky(path)
        field = self.read_field(own)
        return found, field, field.chain(self.model(), self.field or path)


@dataclass(frozen=True, kw_only=True)
class PlaceOptions(SkyOptions):
    """Of `fiberloom sky place`."""

    targets: ListArgument
    out: Annotated[Path, typer.Option(help="Places to write.")] = Path("places.csv")


def place(options: PlaceOptions) -> None:
    """Where targets on the sky are in the focal plane; for each fibre that may take one.

    Of a confSummary the rows that are assigned, valid and on target.
    """
    found, field, chain = options.read(options.targets)
    rows = list(_rows(found, chain))
    prepare_file(options.out)
    _write(options.out, ["target_id,positioner_id,fibre,x_mm,y_mm", *rows])
    options.show(
        {
            "targets": len(found),
            "places": len(rows),
            "placed_for_utc": chain.pointing.time.iso,
            "exposure_s": field.exposure_s,
            "site": chain.site.name,
            "altitude_deg": chain.altitude_deg,
            "azimuth_deg": chain.azimuth_deg,
            "airmass": chain.airmass,
            "file": str(options.out),
        }
    )


def _rows(found: SkyList, chain: Chain) -> Iterator[str]:
    """Of the file: targets in the order of the list; one that any fibre may take has a row for each."""
    import numpy as np

    from fiberloom.sky.sky_targets import GUIDE

    fibres = chain.instrument.science_fibres
    guide, placed = found.is_guide, found.placed(chain)
    guides = found.targets.select(guide)
    for name, (x, y) in zip(guides.target_id, chain.place(guides).xy_mm, strict=True):
        yield f"{name},,{GUIDE},{x:.{DIGITS}f},{y:.{DIGITS}f}"
    found = found.select(~guide)
    t = found.targets
    apart = len({chain.wavelength_of(fibre) for fibre in fibres}) > 1
    for k in range(len(found)):
        asked = str(t.fibre[k])
        several = apart and not asked and bool(np.isnan(t.wavelength_A[k]))
        for fibre in fibres if several else (asked,):
            x, y = placed.place_mm(fibre or fibres[0])[k]
            number = "" if t.positioner_id[k] < 0 else str(t.positioner_id[k])
            yield f"{t.target_id[k]},{number},{fibre},{x:.{DIGITS}f},{y:.{DIGITS}f}"


def _write(path: Path, lines: list[str]) -> None:
    from fiberloom.wholefile import write_whole

    write_whole(path, "\n".join(lines) + "\n")


@dataclass(frozen=True, kw_only=True)
class WhereOptions(SkyOptions):
    """Of `fiberloom sky where`."""

    places: Annotated[Path, typer.Argument(help="CSV, ECSV or FITS with x_mm, y_mm; fibre or wavelength.")]
    fibre: Annotated[str | None, typer.Option(help="Of places that name none.")] = None
    out: Annotated[Path, typer.Option(help="Directions to write.")] = Path("directions.csv")


CARRIED = ("target_id", "positioner_id", "fibre")


def where(options: WhereOptions) -> None:
    """Where places of the focal plane look: ICRS RA and Dec at the time of the field."""
    from fiberloom.tables import read_table

    options.check()
    table = read_table(options.places)
    table.require("x_mm", "y_mm")
    chain = options.read_field().chain(options.model(), options.field)
    import numpy as np

    xy_mm = np.column_stack([table.numbers("x_mm"), table.numbers("y_mm")])
    radec = chain.sky(xy_mm, _wavelengths(table, chain, options.fibre))
    for row in np.flatnonzero(~np.isfinite(radec).all(axis=1)).tolist():
        raise table.error(row, "x_mm", "is outside of the image that the optics make")
    carried = [name for name in CARRIED if name in table]
    cells = [table.strings(name) for name in carried]
    rows = [
        ",".join([*(str(column[k]) for column in cells), *_numbers(xy_mm[k], radec[k])])
        for k in range(len(table))
    ]
    prepare_file(options.out)
    _write(options.out, [",".join([*carried, "x_mm", "y_mm", "ra_deg", "dec_deg"]), *rows])
    options.show({"places": len(rows), "utc": chain.pointing.time.iso, "file": str(options.out)})


def _numbers(xy_mm: Floats, radec: Floats) -> list[str]:
    return [f"{value:.{DIGITS}f}" for value in (*xy_mm, *radec)]


def _wavelengths(
    table: TableFile, chain: Chain, fibre: str | None
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """(n,) A: of the column, or of the fibre of each place, or of `fibre`."""
    import numpy as np

    if "wavelength" in table:
        return table.numbers("wavelength")
    only = chain.instrument.science_fibres[0] if len(set(chain.known_A.values())) == 1 else ""
    named = table.strings("fibre") if "fibre" in table else np.full(len(table), "")
    out = np.empty(len(table))
    for row, name in enumerate(named.tolist()):
        known = name or fibre or only
        if not known:
            raise table.error(row, "fibre", f"is not given; --fibre: one of {', '.join(chain.known_A)}")
        out[row] = chain.wavelength_of(known)
    return out
