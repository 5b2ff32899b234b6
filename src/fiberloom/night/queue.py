"""The queue of a night: a TOML file of fields, with what bounds each of them.

It may be edited while the night goes on: it is read again before each step.
"""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from fiberloom.errors import InputError
from fiberloom.files import parse_toml, read_text
from fiberloom.instruments.load import all_problems
from fiberloom.night.airmass import airmass


def _utc(when: datetime) -> datetime:
    """TOML may leave the zone out; a night has UTC only."""
    return when.replace(tzinfo=UTC) if when.tzinfo is None else when.astimezone(UTC)


Moment = Annotated[datetime, AfterValidator(_utc)]
Seconds = Annotated[float, Field(gt=0.0, le=86400.0)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class QueueSite(_Table):
    """Where the telescope is; needed where a field has an airmass."""

    longitude_deg: Annotated[float, Field(ge=-360, le=360)]
    """East of Greenwich."""
    latitude_deg: Annotated[float, Field(ge=-90, le=90)]


class QueueArray(_Table):
    """Which positioners; what is typed with the command comes first."""

    instrument: str = "sdssv"
    layout: Path | None = None
    positioners: Annotated[int, Field(ge=1, lt=2**31)] | None = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    bus: str | None = None
    """None: the twin inside of this process."""
    camera: str | None = None
    """None: that of the twin, `noise`."""
    calibration: Path | None = None
    faults: str = ""
    """Of the twin."""
    errors: str = ""
    """Of the twin."""
    power_W: Annotated[float, Field(gt=0.0, le=1e6)] | None = None
    """Of the supply for all motors: plans keep it. None: as the instrument's `[care]` says."""


class FieldEntry(_Table):
    """One field, and what bounds it."""

    id: Annotated[str, Field(min_length=1, max_length=80)]
    targets: Path
    """List in mm, or on the sky with `field`; from the folder of the queue."""
    field: Path | None = None
    """Field file of a list with ra and dec."""
    priority: Annotated[float, Field(ge=-1e6, le=1e6)] = 0.0
    """Higher first."""
    not_before: Moment | None = None
    not_after: Moment | None = None
    """By when its last exposure must be over."""
    ra_deg: Annotated[float, Field(ge=-360, le=360)] | None = None
    dec_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    airmass_max: Annotated[float, Field(ge=1.0, le=10.0)] | None = None
    exposure_s: Seconds = 900.0
    exposures: Annotated[int, Field(ge=1, le=200)] = 1
    """In each place."""
    dithers_um: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    """Places, in focal-plane um from the targets; the fibres move between them."""
    repeats: Annotated[int, Field(ge=1, le=100)] = 1
    """How often all of that is done."""
    corrections: Annotated[int, Field(ge=0, le=20)] | None = None
    """None: by the instrument's stop rule."""
    notes: str = ""
    skip: Annotated[str, Field(max_length=200)] = ""
    """Why it is left out; empty: it is not."""

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if not 1 <= len(self.dithers_um) <= 100 or any(
            abs(v) > 1e4 for pair in self.dithers_um for v in pair
        ):
            raise ValueError("dithers_um: 1 to 100 pairs, each number within 10000 um")
        if self.airmass_max is not None and self.field is None and None in (self.ra_deg, self.dec_deg):
            raise ValueError("airmass_max: needs ra_deg and dec_deg, or a field file")
        if self.not_before and self.not_after and self.not_before >= self.not_after:
            raise ValueError("not_before: must be earlier than not_after")
        return self

    @property
    def parts(self) -> list[tuple[int, int]]:
        """Every (repeat, dither), in the order in which they are done."""
        return [(r, d) for r in range(self.repeats) for d in range(len(self.dithers_um))]

    @property
    def shutter_s(self) -> float:
        """Shutter time in one place, s."""
        return self.exposures * self.exposure_s

    @property
    def as_json(self) -> str:
        """For the record."""
        return json.dumps(self.model_dump(mode="json", exclude_defaults=True))


class Queue(_Table):
    """A night's fields, and the night itself."""

    name: Annotated[str, Field(max_length=80)] = "night"
    begin: Moment | None = None
    """When the clock of a twin begins; None: now. An array outside has the clock of the world."""
    dawn: Moment
    """By when the shutter is closed, and the array parks."""
    overhead_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 90.0
    """Of a configuration, as it is counted when a field is chosen."""
    attempts: Annotated[int, Field(ge=1, le=20)] = 2
    """How often a place of a field is tried that fails."""
    stage_timeout_s: Seconds = 900.0
    """Of positioning; an exposure has its own duration and a minute."""
    require: Annotated[float, Field(ge=0.0, le=1.0)] = 0.9
    """Share of the assigned fibres within the requirement, below which a place is made again, or not done."""
    site: QueueSite | None = None
    array: QueueArray = QueueArray()
    fields: tuple[FieldEntry, ...] = Field(alias="field", min_length=1)

    @model_validator(mode="after")
    def _whole(self) -> Self:
        names = [entry.id for entry in self.fields]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"field id '{twice[0]}': is there twice")
        if self.site is None and any(entry.airmass_max is not None for entry in self.fields):
            raise ValueError("airmass_max: needs a [site] with longitude_deg and latitude_deg")
        if self.begin is not None and self.begin >= self.dawn:
            raise ValueError("begin: must be earlier than dawn")
        return self

    def fewest_moves(self, corrections_max: int) -> int:
        """Of a field, the blind one too; where a field does not say it, `corrections_max` more than that.

        Fields that are left out count only where all are.
        """
        observed = [entry for entry in self.fields if not entry.skip] or self.fields
        told = (corrections_max if f.corrections is None else f.corrections for f in observed)
        return 1 + min(told)

    def entry(self, name: str) -> FieldEntry | None:
        """A field by its id; None: it is not in the queue any more."""
        return next((entry for entry in self.fields if entry.id == name), None)

    def last_begin(self, entry: FieldEntry) -> datetime:
        """When a place of a field must be begun at the latest: its exposures are over in time then."""
        end = min(self.dawn, entry.not_after or self.dawn)
        return end - timedelta(seconds=self.overhead_s + entry.shutter_s)

    def airmass_of(self, entry: FieldEntry, when: datetime) -> float | None:
        """Of the centre of a field, a ratio; None where none is asked for."""
        if entry.airmass_max is None or self.site is None:
            return None
        assert entry.ra_deg is not None
        assert entry.dec_deg is not None
        return airmass(entry.ra_deg, entry.dec_deg, self.site.longitude_deg, self.site.latitude_deg, when)

    def is_up(self, entry: FieldEntry, when: datetime) -> bool:
        """Within its airmass from `when` to the end of the exposures of one place."""
        end = when + timedelta(seconds=self.overhead_s + entry.shutter_s)
        seen = [self.airmass_of(entry, moment) for moment in (when, end)]
        return all(x is None or x <= (entry.airmass_max or x) for x in seen)


def read_queue(path: Path) -> Queue:
    """The queue of a TOML file; its paths are from its own folder.

    InputError names the file, and each key that is wrong with value and rule.
    """
    told = parse_toml(read_text(path), str(path))
    try:
        queue = Queue.model_validate(told)
    except ValidationError as error:
        raise InputError(f"{path}: {all_problems(error)}") from None
    return _placed(queue, path.resolve().parent)


def _placed(queue: Queue, folder: Path) -> Queue:
    entries = tuple(
        entry.model_copy(update=_from(folder, entry, "targets", "field")) for entry in queue.fields
    )
    for entry in entries:
        for file in (entry.targets, entry.field):
            if file is not None and not file.is_file():
                raise InputError(f"{file}: no such file; field '{entry.id}' of the queue names it")
    entries = tuple(map(_centred, entries))
    array = queue.array.model_copy(update=_from(folder, queue.array, "layout", "calibration"))
    return queue.model_copy(update={"fields": entries, "array": array})


def _centred(entry: FieldEntry) -> FieldEntry:
    """With the centre of its field file, where an airmass is asked for and no centre is given."""
    if entry.field is None or entry.airmass_max is None or None not in (entry.ra_deg, entry.dec_deg):
        return entry
    from fiberloom.sky.sky_field import SkyField

    field = SkyField.read(entry.field)
    return entry.model_copy(update={"ra_deg": field.ra_deg, "dec_deg": field.dec_deg})


def _from(folder: Path, table: BaseModel, *names: str) -> dict[str, Any]:
    """Paths of a table that are given from the folder of the file."""
    return {name: folder / value for name in names if (value := getattr(table, name)) is not None}
