"""The field file: where the telescope looks, when, for how long, from where and through what air."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from fiberloom.errors import InputError
from fiberloom.files import parse_toml, read_text
from fiberloom.instruments.load import all_problems
from fiberloom.instruments.model import Instrument
from fiberloom.sky.chain import Chain, SkyPointing
from fiberloom.sky.earth import SkyTime
from fiberloom.sky.site import SkySite, Weather
from fiberloom.wholefile import write_whole

_LONGEST_S = 86400.0


def _line(key: str, value: Any) -> str:
    """Of a TOML file: texts, numbers and truths are written as in JSON."""
    return f"{key} = {json.dumps(value)}"


class _FieldTable(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class OwnSite(_FieldTable):
    """A place on Earth that the instrument does not name."""

    longitude_deg: Annotated[float, Field(ge=-360, le=360)]
    """East of Greenwich."""
    latitude_deg: Annotated[float, Field(ge=-90, le=90)]
    height_m: Annotated[float, Field(ge=-500, le=10000)]


class MeasuredWeather(_FieldTable):
    """Air at the telescope."""

    pressure_hPa: Annotated[float, Field(ge=0, le=1200)]
    temperature_C: Annotated[float, Field(ge=-80, le=60)]
    humidity: Annotated[float, Field(ge=0, le=1)]
    """Relative, 0 to 1."""


class SkyField(_FieldTable):
    """A field on the sky, as a TOML file says it.

    Raises
    ------
    InputError
        All keys that are wrong, by `read`: key, value, rule of each.
    """

    ra_deg: Annotated[float, Field(ge=-360, le=360)]
    """Centre, ICRS."""
    dec_deg: Annotated[float, Field(ge=-90, le=90)]
    position_angle_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    """From the image's north through east to +y of the focal plane."""
    time: str | float
    """Begin of the exposure: 2024-04-26T06:00:00, or a Julian date."""
    time_scale: Literal["utc", "tai", "tt"]
    exposure_s: Annotated[float, Field(ge=0, le=_LONGEST_S)] = 0.0
    overhead_s: Annotated[float, Field(ge=0, le=_LONGEST_S)] = 0.0
    """Between two exposures of a series: reading out, moving."""
    place_for: Literal["middle", "begin"] = "middle"
    """Part of the exposure for which fibres are placed."""
    site: str | OwnSite | None = None
    """None: the instrument's first."""
    weather: MeasuredWeather | None = None
    """None: what the instrument computes with."""
    scale: Annotated[float, Field(gt=0.9, lt=1.1)] | None = None
    """Of the guider; None: that of the site."""
    polar_motion: bool = False
    """Of the IERS' table, in place of 0."""

    @field_validator("time", mode="before")
    @classmethod
    def _text(cls, value: Any) -> Any:
        """TOML has times of its own."""
        if isinstance(value, datetime) and value.tzinfo is not None:
            return value.astimezone(UTC).replace(tzinfo=None).isoformat() + "Z"
        return value.isoformat() if hasattr(value, "isoformat") else value

    @model_validator(mode="after")
    def _moment(self) -> Self:
        SkyTime.of(self.time, self.time_scale)  # InputError is a ValueError
        return self

    @classmethod
    def read(cls, path: str | Path) -> SkyField:
        """The field of a TOML file."""
        return cls.parse(parse_toml(read_text(Path(path)), str(path)), str(path))

    @classmethod
    def parse(cls, told: Mapping[str, Any], where: str) -> SkyField:
        """The field of keys and values; `where` names their file in errors."""
        if "time_scale" not in told:
            raise InputError(f"{where}: time_scale: is missing; it is utc, tai or tt, and has no default")
        try:
            return cls.model_validate(told)
        except ValidationError as error:
            raise InputError(f"{where}: {all_problems(error)}") from None

    def write(self, path: Path) -> None:
        """A TOML file that `read` reads."""
        known = self.model_dump(exclude_none=True, exclude_defaults=True)
        tables = {key: value for key, value in known.items() if isinstance(value, dict)}
        lines = [_line(key, value) for key, value in known.items() if key not in tables]
        for name, table in tables.items():
            lines += [f"\n[{name}]", *(_line(key, value) for key, value in table.items())]
        write_whole(path, "\n".join(lines) + "\n")

    @classmethod
    def of_confsummary(cls, keywords: Mapping[str, str], where: str) -> SkyField:
        """The field of a confSummary of SDSS-V, by its `keywords`: `epoch` is TAI. `where` names it."""
        names = {
            "ra_deg": "raCen",
            "dec_deg": "decCen",
            "position_angle_deg": "pa",
            "scale": "focal_scale",
            "time": "epoch",
        }
        missing = [key for key in (*names.values(), "observatory") if key not in keywords]
        if missing:
            raise InputError(f"{where}: no keyword {', '.join(missing)}; give the field with --field")
        try:
            told: dict[str, Any] = {name: float(keywords[key]) for name, key in names.items()}
        except ValueError as error:
            raise InputError(f"{where}: {', '.join(names.values())}: {error}") from None
        site = keywords["observatory"].lower()
        return cls.parse(told | {"time_scale": "tai", "site": site}, where)

    # what it means

    @property
    def cadence_s(self) -> float:
        """From one exposure of a series to the next."""
        return self.exposure_s + self.overhead_s

    @property
    def begin(self) -> SkyTime:
        """Of the exposure."""
        return SkyTime.of(self.time, self.time_scale)

    @property
    def placing(self) -> SkyTime:
        """The moment for which fibres are placed."""
        return self.begin.later(0.5 * self.exposure_s) if self.place_for == "middle" else self.begin

    def begun(self, begin: SkyTime, exposure_s: float | None = None) -> SkyField:
        """The same field at another time; `exposure_s`: the duration of its exposure, if another."""
        told = self.model_dump() | {"time": begin.iso, "time_scale": "utc"}
        told |= {} if exposure_s is None else {"exposure_s": exposure_s}
        return SkyField.parse(told, "field")

    def pointing(self) -> SkyPointing:
        """Of the telescope, at the moment of placing."""
        return SkyPointing(self.ra_deg, self.dec_deg, self.placing, self.position_angle_deg, self.scale)

    def chain(self, instrument: Instrument, where: str | Path | None = None) -> Chain:
        """From the sky to the focal plane of an instrument, at the moment of placing.

        `where` names the file of the field in errors.
        """
        try:
            return self._chain(instrument)
        except InputError as error:
            raise InputError(f"{where}: {error}" if where else str(error)) from None

    def _chain(self, instrument: Instrument) -> Chain:
        site, air = self._site(instrument), self.weather
        weather = None if air is None else Weather(air.pressure_hPa, air.temperature_C, air.humidity)
        return Chain(instrument, self.pointing(), site, weather, polar_motion=self.polar_motion)

    def _site(self, instrument: Instrument) -> SkySite:
        if isinstance(self.site, OwnSite):
            own = self.site
            return SkySite.of(instrument).elsewhere(own.longitude_deg, own.latitude_deg, own.height_m)
        return SkySite.of(instrument, self.site)
