"""The file of a survey: its list on the sky, the fields with their exposures, least numbers per sector."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fiberloom.errors import InputError
from fiberloom.files import parse_toml, read_text
from fiberloom.instruments.load import all_problems
from fiberloom.instruments.model import Instrument
from fiberloom.sky.chain import Chain
from fiberloom.sky.sky_field import SkyField
from fiberloom.sky.sky_targets import GUIDE
from fiberloom.tables import TableFile, read_table
from fiberloom.targets.read import read_sky
from fiberloom.targets.sky_list import SkyList
from fiberloom.targets.target_list import TargetList
from fiberloom.typing import Array, Flags, Ints

MOST_EXPOSURES = 200
_FAR_DEG = 0.5
"""Beyond the fit of the optics, by what refraction and motion may bring a target in."""
OWN = ("role", "visits")
"""Columns of the list beside those of every list on the sky."""


class SurveyPointing(BaseModel):
    """A field, and how often it is exposed."""

    model_config = ConfigDict(extra="forbid")

    field: Path
    """Its TOML file, from where the file of the survey is."""
    exposures: Annotated[int, Field(ge=1, le=MOST_EXPOSURES)] = 1


class SurveyFile(BaseModel):
    """A TOML file."""

    model_config = ConfigDict(extra="forbid")

    targets: Path
    """List on the sky, from where the file is."""
    pointings: Annotated[list[SurveyPointing], Field(min_length=1)]
    sectors: Annotated[int, Field(ge=1, le=360)] = 1
    minimum: dict[str, Annotated[int, Field(ge=0)]] = {}
    """By role: least number of fibres in every sector of every exposure."""

    @classmethod
    def read(cls, path: Path) -> SurveyFile:
        """The file, with its paths from where it is. Raises InputError: key, value, rule of what is wrong."""
        try:
            found = cls.model_validate(parse_toml(read_text(path), str(path)))
        except ValidationError as error:
            raise InputError(f"{path}: {all_problems(error)}") from None
        if "science" in found.minimum:
            raise InputError(f"{path}: minimum.science: science targets have priorities, no minimum")
        if sum(one.exposures for one in found.pointings) > MOST_EXPOSURES:
            raise InputError(f"{path}: pointings: more than {MOST_EXPOSURES} exposures in all")
        pointings = [one.model_copy(update={"field": path.parent / one.field}) for one in found.pointings]
        return found.model_copy(update={"targets": path.parent / found.targets, "pointings": pointings})

    def fields(self) -> Iterator[tuple[Path, SkyField]]:
        """The field of each exposure, at its own time, and the file that it comes from."""
        for one in self.pointings:
            field = SkyField.read(one.field)
            if one.exposures > 1 and not field.cadence_s:
                raise InputError(f"{one.field}: exposure_s: must be above 0 where a field is exposed again")
            for number in range(one.exposures):
                later = field.begin.later(number * field.cadence_s)
                told = {"time": later.iso, "time_scale": "utc"}
                yield one.field, field.model_copy(update=told) if number else field


@dataclass(frozen=True, eq=False)
class SurveyTargets:
    """The list of a survey."""

    sky: SkyList
    role: Array
    """(n,) science where the list says none; guide stars are in all exposures that they are in."""
    visits: Ints
    """(n,) 1 where the list says none."""

    @classmethod
    def read(cls, path: Path) -> SurveyTargets:
        """The list of a file with `ra`, `dec`, and `role` and `visits` where it has them."""
        found, own = read_sky(path)
        if own is not None:
            raise InputError(f"{path}: a confSummary is of one exposure; give a table with ra and dec")
        table = read_table(path)
        n = len(found)
        role, visits = np.full(n, "science"), np.ones(n, dtype=np.int64)
        if "role" in table:
            role = np.array([text or "science" for text in table.strings("role").tolist()])
        role = np.where(found.is_guide, GUIDE, role)
        if "visits" in table:
            visits = _visits(table)
        return cls(found, role, visits)

    def seen(self, chain: Chain, field: SkyField) -> tuple[TargetList, Ints]:
        """Those that are in a field and high enough, in mm with the guide stars, and the rows of targets."""
        rows = np.flatnonzero(self._near(chain))
        for fibre in chain.instrument.science_fibres:
            seen = chain.place(self.sky.targets.select(rows), fibre)
            rows = rows[~seen.outside & ~seen.low & np.isfinite(seen.xy_mm).all(axis=1)]
        places = [self.sky.rows[k] for k in rows.tolist()]
        some = replace(self.sky, targets=self.sky.targets.select(rows), rows=places)
        targets = rows[~some.is_guide]
        return some.placed(chain, field), targets

    def guides(self, seen: TargetList) -> Ints:
        """Rows of the guide stars of an exposure, whose targets are `seen`."""
        mine = None if seen.on_sky is None else seen.on_sky.guides
        names = np.array([]) if mine is None else mine.target_id
        return np.flatnonzero(np.isin(self.sky.targets.target_id, names))

    def _near(self, chain: Chain) -> Flags:
        """(n,) within the field, and a bit."""
        _, limit_deg = chain.optics(chain.guide_A)
        p, t = chain.pointing, self.sky.targets
        ra, dec, dec0 = np.radians(t.ra_deg - p.ra_deg), np.radians(t.dec_deg), np.radians(p.dec_deg)
        cosine = np.sin(dec) * np.sin(dec0) + np.cos(dec) * np.cos(dec0) * np.cos(ra)
        near: Flags = cosine > np.cos(np.radians(limit_deg + _FAR_DEG))
        return near


def _visits(table: TableFile) -> Ints:
    cells = [text or "1" for text in table.strings("visits").tolist()]
    visits = TableFile(table.path, {"visits": cells}, table.places).integers("visits")
    for row in np.flatnonzero(visits < 1)[:1].tolist():
        raise table.error(row, "visits", f"= {visits[row]}: must be 1 or more")
    return visits


def exposures_of(
    survey: SurveyFile, targets: SurveyTargets, instrument: Instrument
) -> list[tuple[SkyField, TargetList, Ints]]:
    """For each exposure its field, the targets in it, and their rows in the list.

    `survey`: the file; `targets`: its list; `instrument`: whose optics lead from the sky to the focal plane.
    Raises InputError for a field without a target, or too low.
    """
    made: list[tuple[SkyField, TargetList, Ints]] = []
    for path, field in survey.fields():
        chain = field.chain(instrument, path)
        seen, rows = targets.seen(chain, field)
        if not len(rows):
            raise InputError(
                f"{path}: no target of {survey.targets} is in the field and high enough at "
                f"{chain.pointing.time.iso} UTC (altitude {chain.altitude_deg:.1f} deg)"
            )
        made.append((field, seen, rows))
    return made


def list_of(path: Path, rows: Ints, more: dict[str, list[Any]]) -> tuple[list[str], list[list[str]]]:
    """Some rows of a list as they stand in its file, with columns put in the place of its own, or added.

    `path`: of the list; `rows`: from 0; `more`: by name, a cell for each of the rows.
    """
    table = read_table(path)
    kept = [name for name in table.columns if name.lower() not in {*more, *_REPLACED}]
    cells = {name: table.strings(name) for name in kept}
    lines = [[*(str(cells[name][k]) for name in kept)] for k in rows.tolist()]
    added = [[str(values[i]) for values in more.values()] for i in range(len(rows))]
    return [*kept, *more], [a + b for a, b in zip(lines, added, strict=True)]


_REPLACED = ("positionerid", "fiber", "fibertype")
"""Other names of what an assignment puts in."""
