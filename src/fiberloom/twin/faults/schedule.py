"""What goes wrong while the twin is served, and when: `--faults` of `fiberloom twin`.

    lying=2, stuck_hall=#17@30, powercut=3@20+5, busoff=1@60+10, lost=0.01, late=0.05:1.5

KIND=HOW_MANY, or KIND=#ID for one positioner, from @START for +DURATION seconds of the twin's time; from
the beginning and without end by default. The seed determines which positioners are hit.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from fiberloom.errors import InputError
from fiberloom.twin.faults.faults import Fault, FaultKind

UNITS = frozenset(FaultKind) - {FaultKind.DARK}  # there is no camera
POWER_CUT, BUS_OFF, LOST, LATE = "powercut", "busoff", "lost", "late"
KINDS = (*sorted(UNITS), POWER_CUT, BUS_OFF, LOST, LATE)

POWER_CUT_S = 1.0
"""How long a power cut lasts unless told."""

_WHEN = r"(?:@(?P<start>[0-9.]+))?(?:\+(?P<last>[0-9.]+))?"
_PART = re.compile(rf"(?P<kind>\w+)(?:=(?P<who>#?)(?P<amount>[0-9.]+)(?::(?P<by>[0-9.]+))?)?{_WHEN}")


@dataclass(frozen=True)
class Trouble:
    """One thing that goes wrong. Times are virtual seconds."""

    kind: str
    positioner_id: int = 0  # of faults of a positioner, and power cuts
    place: tuple[int, int] = (0, 0)  # of bus off: device (from 0), port
    share: float = 0.0  # of replies that are lost or late
    late_s: float = 0.0
    start_s: float = 0.0
    end_s: float = np.inf

    @property
    def fault(self) -> Fault:
        """As the twin knows it."""
        return Fault(self.kind, self.positioner_id)

    def __str__(self) -> str:
        if self.kind == BUS_OFF:
            return f"{self.kind} device {self.place[0] + 1} port {self.place[1]}"
        if self.kind in (LOST, LATE):
            return f"{self.kind} {100 * self.share:g} % of replies"
        return f"{self.kind} positioner {self.positioner_id}"


def troubles_of(
    text: str, positioner_ids: list[int], places: list[tuple[int, int]], seed: int
) -> list[Trouble]:
    """Reads the `text` of `--faults`.

    Positioners (of `positioner_ids`) and ports (of `places`: device, port) are drawn by the `seed`,
    each hit once. InputError for a text that does not fit.
    """
    rng = np.random.default_rng([seed, 0xFA17])
    free_ids = [int(i) for i in rng.permutation(positioner_ids)]
    free_places = [places[k] for k in rng.permutation(len(places))]
    return [
        trouble
        for part in text.split(",")
        if part.strip()
        for trouble in _read(part.strip(), positioner_ids, free_ids, free_places)
    ]


def _read(
    part: str, known: list[int], free_ids: list[int], free_places: list[tuple[int, int]]
) -> list[Trouble]:
    match = _PART.fullmatch(part)
    if match is None or match["kind"] not in KINDS:
        raise InputError(
            f"--faults {part}: write KIND=COUNT, KIND=#ID, lost=SHARE or late=SHARE:SECONDS, with @START "
            f"and +DURATION in seconds where wanted; KIND is one of {', '.join(KINDS)}"
        )
    kind, amount = match["kind"], _number(part, match["amount"], 1.0)
    when = _when(part, match, kind)
    if kind in (LOST, LATE):
        return [_of_replies(part, kind, amount, _number(part, match["by"], 1.0), when)]
    if match["who"]:
        if kind == BUS_OFF or int(amount) not in known:
            raise InputError(f"--faults {part}: no such positioner")
        if int(amount) in free_ids:
            free_ids.remove(int(amount))
        return [Trouble(kind, positioner_id=int(amount), start_s=when[0], end_s=when[1])]
    pool: list = free_places if kind == BUS_OFF else free_ids
    if amount != int(amount) or amount > len(pool):
        raise InputError(f"--faults {part}: give a whole number, at most {len(pool)} here")
    hit = [pool.pop(0) for _ in range(int(amount))]
    if kind == BUS_OFF:
        return [Trouble(kind, place=place, start_s=when[0], end_s=when[1]) for place in hit]
    return [Trouble(kind, positioner_id=i, start_s=when[0], end_s=when[1]) for i in hit]


def _when(part: str, match: re.Match[str], kind: str) -> tuple[float, float]:
    start_s = _number(part, match["start"], 0.0)
    last_s = _number(part, match["last"], POWER_CUT_S if kind == POWER_CUT else np.inf)
    return start_s, start_s + last_s


def _of_replies(part: str, kind: str, share: float, late_s: float, when: tuple[float, float]) -> Trouble:
    if not 0.0 <= share <= 1.0:
        raise InputError(f"--faults {part}: give the share of replies, 0 to 1")
    return Trouble(kind, share=share, late_s=late_s, start_s=when[0], end_s=when[1])


def _number(part: str, text: str | None, default: float) -> float:
    try:
        return default if text is None else float(text)
    except ValueError:
        raise InputError(f"--faults {part}: '{text}' is not a number") from None
