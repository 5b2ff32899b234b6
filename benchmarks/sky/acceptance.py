"""What the chain from RA and Dec to mm and back shows: figures, limits, and lines for bad input.

`python -m benchmarks.sky.acceptance [--confsummary FILE]`; the file is sought beside the checkout otherwise
(`../shared/data/sdssv/confSummary-test.par.gz`).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments import load_instrument
from fiberloom.sky import Chain, Pointing, Site, SkyTargets, SkyTime
from fiberloom.sky.drift import field_grid
from fiberloom.sky.sky_field import SkyField
from fiberloom.targets.read import read_sky
from fiberloom.targets.yanny import read_yanny

ROOT = Path(__file__).resolve().parents[2]
FILE = Path("shared/data/sdssv/confSummary-test.par.gz")
TELESCOPES = [
    *(("sdssv", "apo"), ("sdssv", "lco"), ("desi", "kpno"), ("pfs", "subaru"), ("lamost", "xinglong")),
    *(("megara", "gtc"), ("moons", "paranal")),
]
TIME = SkyTime.of("2025-03-20T09:30:00", "utc")
Row = tuple[str, float, str, float]
"""What, value, unit, the limit."""


def confsummary(path: Path) -> Iterator[Row]:
    """Of a file of SDSS-V: places from RA and Dec alone against those in the file."""
    found, field = read_sky(path)
    assert field is not None
    place_mm = found.placed(field.chain(load_instrument("sdssv"))).xy_mm
    rows = {(row["positionerId"], row["fiberType"]): row for row in read_yanny(path).rows["FIBERMAP"]}
    t = found.targets
    mine = [rows[str(k), str(fibre)] for k, fibre in zip(t.positioner_id, t.fibre, strict=True)]
    wok_mm = np.array([(float(row["xwok"]), float(row["ywok"])) for row in mine])
    error_um = 1e3 * np.hypot(*(place_mm - wok_mm).T)
    yield f"confSummary, {len(error_um)} fibres, rms", float(np.sqrt((error_um**2).mean())), "um", 0.002
    yield "confSummary, largest", float(error_um.max()), "um", 0.005


def overhead(name: str, site: str) -> Chain:
    """A field two hours east of the meridian, 20 deg from the zenith or a bit more."""
    model = load_instrument(name)
    place = Site.of(model, site)
    lst_deg = (280.46 + 360.9856473 * (TIME.day + TIME.part - 2451545.0) + place.longitude_deg) % 360.0
    return Chain(model, Pointing((lst_deg + 30.0) % 360.0, place.latitude_deg - 10.0, TIME, 33.0), place)


def round_trips() -> Iterator[Row]:
    """mm to sky to mm all over the field."""
    for name, site in TELESCOPES:
        chain = overhead(name, site)
        for fibre in chain.instrument.science_fibres[:1]:
            wavelength = chain.wavelength_of(fibre)
            seen_mm = chain.place(field_grid(chain, (0.0, 0.5, 0.98)), fibre).xy_mm
            sky = chain.sky(seen_mm, wavelength)
            again_mm = chain.place(SkyTargets.at(*sky.T), fibre).xy_mm
            worst_nm = 1e6 * float(np.abs(again_mm - seen_mm).max())
            yield f"round trip, {name} {site}, airmass {chain.airmass:.2f}", worst_nm, "nm", 1.0


def across(ra_deg: float, dec_deg: float) -> float:
    """Largest round trip in nm of a field at this place, on a telescope below its zenith."""
    model = load_instrument("sdssv")
    place = Site.of(model).elsewhere((ra_deg - 329.0) % 360.0, max(-80.0, min(80.0, dec_deg)), 2000.0)
    chain = Chain(model, Pointing(ra_deg, dec_deg, TIME), place)
    seen_mm = chain.place(field_grid(chain, (0.0, 0.5, 0.98)), "BOSS").xy_mm
    sky = chain.sky(seen_mm, chain.wavelength_of("BOSS"))
    again_mm = chain.place(SkyTargets.at(*sky.T), "BOSS").xy_mm
    return 1e6 * float(np.abs(again_mm - seen_mm).max())


def borders() -> Iterator[Row]:
    """Fields across RA 0 and the pole."""
    yield "round trip, a field across RA 0", across(0.0, 20.0), "nm", 1.0
    yield "round trip, a field on the pole", across(0.0, 89.9), "nm", 1.0


GOOD = {
    "ra_deg": 213.7,
    "dec_deg": 53.08,
    "time": "2024-04-26T06:00:00",
    "time_scale": "utc",
    "site": "apo",
}
BAD = {
    "time without scale": {"time_scale": None},
    "a site nobody knows": {"site": "mauna"},
    "a field below the horizon": {"dec_deg": -80.0},
}


def star_below() -> str:
    """What is said of a star below the horizon, in a list of two."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stars.csv"
        path.write_text("target_id,ra,dec\na,213.7,53.0\nb,213.7,-80.0\n")
        field = SkyField.parse(GOOD, "field.toml")
        try:
            read_sky(path)[0].placed(field.chain(load_instrument("sdssv")))
        except InputError as error:
            return str(error).replace(folder, "")
    return "NOT REFUSED"


def refusals() -> Iterator[tuple[str, str]]:
    """What is said of bad input."""
    yield "a star below the horizon", star_below()
    for what, change in BAD.items():
        told = {key: value for key, value in (GOOD | change).items() if value is not None}
        try:
            SkyField.parse(told, "field.toml").chain(load_instrument("sdssv"), "field.toml")
            yield what, "NOT REFUSED"
        except InputError as error:
            yield what, str(error)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--confsummary", type=Path)
    found = parser.parse_args().confsummary
    places = [parent / FILE for parent in (ROOT.parent, ROOT.parent.parent)]
    found = found or next((path for path in places if path.exists()), None)
    rows = [*([] if found is None else confsummary(found)), *round_trips(), *borders()]
    if found is None:
        print(f"no ../{FILE} beside the checkout: --confsummary names it")
    for what, value, unit, limit in rows:
        print(f"{what:55s} {value:10.5f} {unit} (at most {limit:g})")
    told = list(refusals())
    for what, line in told:
        print(f"{what}: {line}")
    good = all(value <= limit for _, value, _, limit in rows)
    return 0 if good and not any(line == "NOT REFUSED" for _, line in told) else 1


if __name__ == "__main__":
    sys.exit(main())
