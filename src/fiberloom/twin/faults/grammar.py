"""The one grammar of `--faults`, for every command that has the option.

    lying=2, stuck_hall=#17@30, powercut=3@20+5, busoff=1@60+10, lost=0.01, late=0.05:1.5

Parts are joined by commas. A part is KIND, KIND=COUNT, KIND=#ID (one positioner by its number),
lost=SHARE or late=SHARE:SECONDS, then @START and +DURATION in seconds of the twin's time: from the
beginning and for good unless told. COUNT is 1 unless told; which positioners are hit is drawn by the seed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal

from fiberloom.errors import InputError
from fiberloom.twin.faults.kinds import ANYWHERE, SHARES, CameraFaultKind, Reach, ServiceKind

POWER_CUT_S = 1.0
"""How long a power cut lasts unless told."""
LATE_S = 1.0
"""By how much replies are late unless told."""

_NUMBER = r"[0-9.]+"
_PART = re.compile(
    rf"(?P<kind>\w+)(?:\s*=\s*(?P<named>#?)(?P<amount>{_NUMBER})?(?::(?P<by>{_NUMBER}))?)?"
    rf"\s*(?:@(?P<start>{_NUMBER}))?\s*(?:\+(?P<last>{_NUMBER}))?",
    re.ASCII,
)


@dataclass(frozen=True)
class FaultRequest:
    """One part of `--faults`, as typed. `str` gives the text of which it is read."""

    kind: str
    count: int = 1
    """How many positioners (of bus off: ports) have it; 1 where one is named, or for shares."""
    positioner_id: int | None = None
    share: float | None = None
    """Of replies that are lost or late, 0 to 1."""
    late_s: float | None = None
    start_s: float = 0.0
    duration_s: float | None = None
    """None: until the end; of a power cut, a second."""

    @property
    def end_s(self) -> float:
        """When it is over; infinity: never."""
        usual_s = POWER_CUT_S if self.kind == ServiceKind.POWER_CUT else math.inf
        return self.start_s + (usual_s if self.duration_s is None else self.duration_s)

    def __str__(self) -> str:
        amount = str(self.count)
        if self.positioner_id is not None:
            amount = f"#{self.positioner_id}"
        if self.share is not None:
            amount = _plain(self.share) + ("" if self.late_s is None else f":{_plain(self.late_s)}")
        start = f"@{_plain(self.start_s)}" if self.start_s else ""
        last = "" if self.duration_s is None else f"+{_plain(self.duration_s)}"
        return f"{self.kind}={amount}{start}{last}"


def parse_faults(text: str, reach: Reach = ANYWHERE) -> tuple[FaultRequest, ...]:
    """Reads a text of `--faults`; an empty text asks for none.

    Raises InputError that names the part which is not of the grammar, or which `reach`, the kinds of
    the command at hand, does not hold.
    """
    return tuple(_parse(part.strip(), reach) for part in text.split(",") if part.strip())


def faults_text(requests: Iterable[FaultRequest]) -> str:
    """The text that `parse_faults` reads as these."""
    return ",".join(map(str, requests))


def _parse(part: str, reach: Reach) -> FaultRequest:
    match = _PART.fullmatch(part)
    if match is None or match["kind"] not in ANYWHERE.kinds:
        raise _refusal(part, f"write {_ways(reach)}; KIND is one of {', '.join(reach.kinds)}")
    kind = match["kind"]
    if kind not in reach.kinds:
        raise _refusal(part, f"this command cannot act on {kind}; KIND is one of {', '.join(reach.kinds)}")
    if not reach.timed and (match["start"] or match["last"]):
        raise _refusal(part, "this command has no clock for @START and +DURATION; `fiberloom twin` has one")
    when = (_number(part, match["start"], 0.0), _duration(part, match["last"]))
    return _of_replies(part, match, when) if kind in SHARES else _of_positioners(part, match, when)


def _ways(reach: Reach) -> str:
    ways = "KIND=COUNT or KIND=#ID"
    if not reach.timed:
        return ways
    return f"{ways}, lost=SHARE or late=SHARE:SECONDS, with @START and +DURATION in seconds where wanted"


def _of_replies(part: str, match: re.Match[str], when: tuple[float, float | None]) -> FaultRequest:
    share = _number(part, match["amount"], 1.0)
    if match["named"] or share > 1.0:
        raise _refusal(part, "give the share of replies, 0 to 1")
    late_s = None
    if match["kind"] == ServiceKind.LATE:
        late_s = _number(part, match["by"], LATE_S)
    elif match["by"]:
        raise _refusal(part, "only late has seconds, as in late=SHARE:SECONDS")
    return FaultRequest(match["kind"], 1, None, share, late_s, *when)


def _of_positioners(part: str, match: re.Match[str], when: tuple[float, float | None]) -> FaultRequest:
    if match["by"]:
        raise _refusal(part, "only late has seconds, as in late=SHARE:SECONDS")
    amount = _number(part, match["amount"], 1.0)
    if amount != int(amount):
        raise _refusal(part, f"'{match['amount']}' is not a whole number")
    start_s, duration_s = when
    if match["kind"] in set(CameraFaultKind) and match["named"]:
        raise _refusal(part, "no positioner has it but the camera: write it without a number")
    if not match["named"]:
        return FaultRequest(match["kind"], int(amount), start_s=start_s, duration_s=duration_s)
    if match["amount"] is None or match["kind"] == ServiceKind.BUS_OFF:
        raise _refusal(part, "no such positioner: give its number after the #")
    return FaultRequest(match["kind"], 1, int(amount), start_s=start_s, duration_s=duration_s)


def _duration(part: str, text: str | None) -> float | None:
    return None if text is None else _number(part, text, 0.0)


def _number(part: str, text: str | None, default: float) -> float:
    try:
        number = default if text is None else float(text)
    except ValueError:
        raise _refusal(part, f"'{text}' is not a number") from None
    if not math.isfinite(number):
        raise _refusal(part, f"'{text}' is too large")
    return number


def _plain(number: float) -> str:
    """Exactly this number without an exponent, whose plus sign would begin a duration."""
    return format(Decimal(repr(float(number))), "f").removesuffix(".0")


def _refusal(part: str, why: str) -> InputError:
    return InputError(f"--faults {part}: {why}")
