"""Times, and how the Earth turns: Julian dates with their scale, UT1 - UTC and polar motion.

The table of the IERS comes with astropy (`astropy_iers_data`): nothing is downloaded.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import erfa
import numpy as np

from fiberloom.errors import InputError

SCALES = ("utc", "tai", "tt")
DAY_S = 86400.0
_MJD_ZERO = 2400000.5
_ISO = re.compile(r"(\d{4})-(\d\d)-(\d\d)[T ](\d\d):(\d\d)(?::(\d\d(?:\.\d+)?))?")
_SOONEST, _LATEST = 2440000.5, 2500000.5
"""1968 to 2132: what a table of leap seconds can say."""
_YEARS = (1969, 2131)
ARCSEC_RAD = np.pi / 180.0 / 3600.0


def quiet(call: Callable[..., Any], *arguments: Any) -> Any:
    """What an ERFA function gives; it warns of years whose leap seconds are not decided yet."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*dubious year.*", category=erfa.ErfaWarning)
        return call(*arguments)


@dataclass(frozen=True)
class SkyTime:
    """A moment, as a Julian date of UTC in two parts."""

    day: float
    part: float

    @classmethod
    def of(cls, value: float | str, scale: str) -> SkyTime:
        """Of a Julian date (`value`, a count of days: 2460427.5) or of a text (2024-04-26T06:00:00), in a
        time `scale`.

        Raises InputError for a scale other than utc, tai, tt, and for a time that is none.
        """
        if scale not in SCALES:
            raise InputError(f"time scale '{scale}': must be one of {', '.join(SCALES)}")
        parts = _calendar(value, scale) if isinstance(value, str) else _julian(value)
        if scale == "utc":
            return cls(*map(float, parts))
        tai = parts if scale == "tai" else erfa.tttai(*parts)
        return cls(*map(float, quiet(erfa.taiutc, *tai)))

    def later(self, seconds_s: float) -> SkyTime:
        """So many s afterwards, by TAI."""
        day, part = self.tai
        return SkyTime(*map(float, quiet(erfa.taiutc, day, part + seconds_s / DAY_S)))

    @property
    def julian_year(self) -> float:
        """In TT, Julian years: 2016.0 is JD 2457388.5 of TT but for 0.01 s."""
        day, part = self.tt
        return 2000.0 + ((day - float(erfa.DJ00)) + part) / float(erfa.DJY)

    @property
    def tt(self) -> tuple[float, float]:
        """Terrestrial time, as a Julian date in two counts of days."""
        day, part = erfa.taitt(*self.tai)
        return float(day), float(part)

    @property
    def tai(self) -> tuple[float, float]:
        """International atomic time, as a Julian date in two counts of days."""
        day, part = quiet(erfa.utctai, self.day, self.part)
        return float(day), float(part)

    @property
    def iso(self) -> str:
        """UTC, to the millisecond."""
        year, month, day, clock = quiet(erfa.d2dtf, "UTC", 3, self.day, self.part)
        hour, minute, second, part = (int(x) for x in clock.item())
        return f"{int(year)}-{int(month):02d}-{int(day):02d}T{hour:02d}:{minute:02d}:{second:02d}.{part:03d}"

    def after_s(self, other: SkyTime) -> float:
        """Since another moment, in s of TAI."""
        (a, b), (c, d) = self.tai, other.tai
        return float(((a - c) + (b - d)) * DAY_S)


def _julian(value: float) -> tuple[float, float]:
    if not _SOONEST <= value <= _LATEST:
        raise InputError(f"time = {value:g}: a Julian date is {_SOONEST:g} to {_LATEST:g}")
    day = float(np.floor(value))
    return day, value - day


def _calendar(text: str, scale: str) -> tuple[float, float]:
    match = _ISO.fullmatch(text.strip().removesuffix("Z"))
    if match is None or (text.strip().endswith("Z") and scale != "utc"):
        raise InputError(f"time = '{text}': must be as 2024-04-26T06:00:00 (a Z at the end means utc)")
    *whole, second = match.groups()
    if not _YEARS[0] <= int(whole[0]) <= _YEARS[1]:
        raise InputError(f"time = '{text}': must be in the years {_YEARS[0]} to {_YEARS[1]}")
    try:
        day, part = quiet(erfa.dtf2d, scale.upper(), *map(int, whole), float(second or 0.0))
    except erfa.ErfaError as error:
        why = str(error).rpartition("yielded ")[2]
        raise InputError(f"time = '{text}': {why}") from None
    return float(day), float(part)


class Orientation(NamedTuple):
    """Of the Earth."""

    ut1_utc_s: float
    x_arcsec: float
    """Polar motion."""
    y_arcsec: float


_LINE = 188
"""Bytes of a line of finals2000A, one line a day."""
_COLUMNS = ((58, 68), (18, 27), (37, 46))
"""UT1 - UTC in s, x and y of the pole in arcsec (IERS, readme.finals2000A, counted from 0)."""


def orientation(time: SkyTime) -> Orientation:
    """Of the bundled table, between its days; zeros outside of it (0.01 um in the focal plane)."""
    first, rows = _table()
    days = (time.day - _MJD_ZERO - first) + time.part
    k = int(np.floor(days))
    if not 0 <= k < rows - 1:
        return Orientation(0.0, 0.0, 0.0)
    today, next_day = _row(k), _row(k + 1)
    if today is None or next_day is None:
        return Orientation(0.0, 0.0, 0.0)
    change = next_day - today
    change[0] -= np.rint(change[0])  # a leap second is no turn of the Earth
    return Orientation(*map(float, today + (days - k) * change))


@cache
def _content() -> bytes:
    import astropy_iers_data

    return Path(astropy_iers_data.IERS_A_FILE).read_bytes()


@cache
def _table() -> tuple[float, int]:
    """Modified Julian date of the first line, and the number of lines."""
    text = _content()
    return float(text[7:15]), len(text) // _LINE


def _row(k: int) -> np.ndarray[tuple[int], np.dtype[np.float64]] | None:
    line = _content()[_LINE * k : _LINE * (k + 1)]
    cells = [line[a:b].strip() for a, b in _COLUMNS]
    return np.array([float(c) for c in cells]) if all(cells) else None
