"""The table of the campaign: what was found at each buffer, what was asked, and whether it is met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

Line = dict[str, Any]
PAIRS = 1000
"""So many a goal asks for. With fewer none is met, but one can be missed."""
FEW = 20
"""With fewer, a median is not even missed."""
STOPS = "the hard stops"
"""In a proof that holds only for motions that keep some room to them."""


class Verdict(StrEnum):
    """Of one cell."""

    MET = "met"
    MISSED = "MISSED"
    FEW = "too few pairs"
    NONE = ""
    """Nothing is asked."""


@dataclass(frozen=True)
class Goals:
    """At one buffer. Nothing is to be above these."""

    failures: int
    """Of 1000 pairs: those in which a positioner that can arrive does not."""
    ratio_median: float
    """Motion over its bound."""
    ratio_worst: float
    cpu_median_s: float
    cpu_worst_s: float


ASKED = {
    2.0: Goals(0, 1.08, 1.30, 0.5, 2.0),
    2.5: Goals(0, 1.13, 1.40, 0.8, 3.0),
    3.0: Goals(5, 1.17, 1.50, 1.2, 5.0),
}
"""By buffer, mm: 500 positioners on the real array."""
POSITIONERS = 500


@dataclass(frozen=True)
class Cell:
    """One figure and its verdict."""

    text: str
    verdict: Verdict = Verdict.NONE

    def __str__(self) -> str:
        return f"{self.text} {self.verdict}".strip()


def failed(line: Line) -> bool:
    """Whether a positioner that can arrive does not, or there is no sound plan at all."""
    return bool(line.get("failed") or line.get("hang") or line.get("crash") or not line.get("verified", True))


def of_count(found: int, most: int | None, pairs: int) -> Cell:
    """Pairs that fail, against at most so many of 1000."""
    text = f"{found}"
    if most is None:
        return Cell(text)
    if found > most * max(pairs, PAIRS) / PAIRS:
        return Cell(text, Verdict.MISSED)
    return Cell(text, Verdict.MET if pairs >= PAIRS else Verdict.FEW)


def of_figure(
    values: Sequence[float], share: float, most: float | None, pairs: int, form: str = ".3f"
) -> Cell:
    """A median (share 0.5), a percentile or the worst (1.0) of values, against at most this."""
    if not len(values):
        return Cell("-", Verdict.NONE if most is None else Verdict.FEW)
    found = float(np.quantile(values, share))
    text = f"{found:{form}}"
    if most is None:
        return Cell(text)
    if found > most and (share == 1.0 or pairs >= FEW):
        return Cell(text, Verdict.MISSED)
    return Cell(text, Verdict.MET if pairs >= PAIRS and found <= most else Verdict.FEW)


HEAD = (
    "| buffer mm | pairs | with a failure | refused rightly | over the bound, median | 95 % | worst "
    "| CPU s, median | worst | points, mean | worst |",
    "|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
)


def cells(lines: list[Line], asked: Goals | None) -> list[Cell]:
    """One row: all pairs at one buffer. Motion is of the pairs without a failure; CPU time of all."""
    drawn = [line for line in lines if not line.get("not_drawn")]
    n, good = len(drawn), [line for line in drawn if not failed(line)]
    ratio = [line["ratio"] for line in good]
    cpu_s = [line["cpu_s"] for line in drawn if "cpu_s" in line]
    goal = (lambda name: None) if asked is None else (lambda name: getattr(asked, name))
    return [
        Cell(str(n)),
        of_count(n - len(good), goal("failures"), n),
        Cell(str(sum(len(line.get("rightly", ())) for line in drawn))),
        of_figure(ratio, 0.5, goal("ratio_median"), n),
        of_figure(ratio, 0.95, None, n),
        of_figure(ratio, 1.0, goal("ratio_worst"), n),
        of_figure(cpu_s, 0.5, goal("cpu_median_s"), n),
        of_figure(cpu_s, 1.0, goal("cpu_worst_s"), n),
        of_figure([line["points_mean"] for line in good], 0.5, None, n, ".1f"),
        of_figure([line["points_worst"] for line in good], 1.0, None, n, ".0f"),
    ]


def asked_at(buffer_mm: float, positioners: int) -> Goals | None:
    """The goals are for arrays of 500; at other sizes and buffers nothing is asked."""
    return ASKED.get(buffer_mm) if positioners == POSITIONERS else None


def asked_row(buffer_mm: float, asked: Goals) -> str:
    """What the row above it is held against."""
    texts = [f"at most, {buffer_mm:g}", f"{PAIRS}", f"{asked.failures}", "", f"{asked.ratio_median:.2f}", ""]
    texts += [f"{asked.ratio_worst:.2f}", f"{asked.cpu_median_s:.2f}", f"{asked.cpu_worst_s:.2f}", "", ""]
    return f"| {' | '.join(texts)} |"


def table(rows: dict[float, tuple[list[Cell], Goals | None]]) -> list[str]:
    """Markdown: a row per buffer, and below it what is asked."""
    out = [*HEAD]
    for buffer_mm, (found, asked) in rows.items():
        out.append(f"| {buffer_mm:g} | {' | '.join(map(str, found))} |")
        if asked is not None:
            out.append(asked_row(buffer_mm, asked))
    return out


def told(buffer_mm: float, lines: list[Line]) -> list[str]:
    """Every pair with a failure, with its reasons, and those that could not be drawn."""
    out = []
    for line in lines:
        name = f"{buffer_mm:g} mm, pair {line['seed']}"
        if line.get("not_drawn"):
            out.append(f"{name}: not drawn: {line['not_drawn']}")
        elif failed(line):
            whys = list(line.get("failed", {}).values())
            whys += ["takes too long"] if line.get("hang") else []
            whys += [line["crash"].strip().splitlines()[-1]] if line.get("crash") else []
            whys += [f"not verified: {line['why']}"] if not line.get("verified", True) else []
            out.append(f"{name}: {'; '.join(whys)}")
    return out


def only_off_the_stops(buffer_mm: float, lines: list[Line]) -> list[str]:
    """The pairs without a failure that would have one if motions might go up to the hard stops."""
    seeds = [
        str(line["seed"])
        for line in lines
        if not failed(line) and any(STOPS in how for how in line.get("rightly", {}).values())
    ]
    if not seeds:
        return []
    what = f"pairs without a failure only as motions keep off {STOPS}"
    return [f"{buffer_mm:g} mm: {len(seeds)} {what}: {', '.join(seeds)}"]


def exit_code(found: list[Cell]) -> int:
    """0: all that is asked is met; 1: something is missed, or too few pairs were run to tell."""
    return int(any(cell.verdict in (Verdict.MISSED, Verdict.FEW) for cell in found))
