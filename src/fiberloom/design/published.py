"""What is published of the six instruments' reach and coverage, beside what our tools find by the presets."""

from __future__ import annotations

from dataclasses import dataclass

from fiberloom.design.coverage import Coverage, coverage
from fiberloom.design.lattice import Lattice
from fiberloom.design.merits import neighbours
from fiberloom.instruments import Instrument, load_instrument

POINTS = 20_000
"""Of a lattice; shares are known to 0.004."""
TABLE = "Kronig 2020, Table 1"
SAYRES = "Sayres et al. 2021, AJ 161, 92"
SAYRES_SAYS = "any point typically accessible to three or more robots"
PFS_WEB = "pfs.ipmu.jp"
DESIMODEL = "desimodel: patrol from 0.1 to 6.0 mm"
MAKAREM = "Makarem 2016, 10.1117/12.2231716"
USTC = "USTC thesis, globethesis 2132360302459937: patrol circle of 33 to 35 mm"


@dataclass(frozen=True)
class PublishedFigure:
    """One figure of one preset."""

    preset: str
    figure: str
    """As in `ours`."""
    low: float
    high: float
    """What is published, from and to; the same where it is one number."""
    source: str


PUBLISHED = (
    PublishedFigure("lamost", "reach_mm", 16.5, 17.5, USTC),
    PublishedFigure("lamost", "reach_mm", 16.5, 16.5, TABLE),
    PublishedFigure("megara", "reach_mm", 11.606, 11.606, TABLE),
    PublishedFigure("desi", "reach_mm", 6.0, 6.0, DESIMODEL),
    PublishedFigure("desi", "folded_mm", 0.0, 0.1, DESIMODEL),
    PublishedFigure("sdssv", "reach_mm", 22.4, 22.4, TABLE),
    PublishedFigure("sdssv", "share_3_or_more", 0.5, 1.0, f"{SAYRES}: {SAYRES_SAYS}"),
    PublishedFigure("moons", "reach_mm", 25.0, 25.0, TABLE),
    PublishedFigure("moons", "neighbours", 18.0, 18.0, MAKAREM),
    PublishedFigure("pfs", "reach_mm", 4.75, 4.75, TABLE),
    PublishedFigure("pfs", "share_1_or_more", 1.0, 1.0, f"{PFS_WEB}: 100 % of the field"),
)


@dataclass(frozen=True)
class Beside:
    """A published figure and ours."""

    published: PublishedFigure
    ours: float

    @property
    def agrees(self) -> bool:
        """Ours is within what is published, to 0.2 % of its upper end."""
        margin = 0.002 * self.published.high
        return self.published.low - margin <= self.ours <= self.published.high + margin


def beside(seed: int = 0) -> list[Beside]:
    """All published figures with ours, by the presets as they are; `seed` of the points that are counted."""
    names = dict.fromkeys(one.preset for one in PUBLISHED)
    found = {name: ours(load_instrument(name), seed) for name in names}
    return [Beside(one, found[one.preset][one.figure]) for one in PUBLISHED]


def ours(instrument: Instrument, seed: int = 0) -> dict[str, float]:
    """Reach, hole and coverage of the first science fibre of an `instrument`, axes within their ranges; mm
    and shares from 0 to 1. `seed` of the points."""
    lattice = Lattice.of(instrument, instrument.science_fibres[0])
    counted: Coverage = coverage(lattice, n=POINTS, seed=seed)
    return {
        "reach_mm": lattice.reach_mm,
        "folded_mm": lattice.hole_mm,
        "neighbours": float(neighbours(instrument)),
        "share_1_or_more": float(counted.at_least[1]),
        "share_3_or_more": float(counted.at_least[3]),
    }
