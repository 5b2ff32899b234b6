"""The table of a campaign, its goals, and whether they are reached."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from scipy.stats import beta

from .draw import KINDS, OF_POSITIONERS

Line = dict[str, Any]
SEEDS = 1000
"""In so many there shall be none of what must not be."""
MISSED, FALSE_FLAGS = 0.02, 0.001
HEAD = ("fault", "seeds", "injected", "shown", "flagged", "missed", "open")
GUARDS = ("false_flags", "false_good", "contacts")


class Verdict(StrEnum):
    """Of one goal."""

    REACHED = "reached"
    MISSED = "NOT REACHED"
    OPEN = "not judged"


def interval(k: int, n: int) -> tuple[float, float]:
    """Clopper and Pearson's interval of a share k of n, 95 %; all of it where nothing was tried."""
    low = float(beta.ppf(0.025, k, n - k + 1)) if k else 0.0
    high = float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
    return low, high


@dataclass(frozen=True)
class Goal:
    """A share that is not to be larger, and what was found."""

    name: str
    found: int
    of: int
    most: float = 0.0
    least: int = 0
    """So many have to be tried."""

    @property
    def verdict(self) -> Verdict:
        """Open where too few were tried to tell."""
        if self.found > self.most * self.of:
            return Verdict.MISSED
        if self.of < max(self.least, 1):
            return Verdict.OPEN
        beyond = self.most > 0.0 and interval(self.found, self.of)[1] > self.most
        return Verdict.OPEN if beyond else Verdict.REACHED

    def __str__(self) -> str:
        low, high = (100.0 * share for share in interval(self.found, self.of))
        asked = f"at most {100 * self.most:g} %" if self.most else f"none in {self.least}"
        share = f"{100.0 * self.found / max(self.of, 1):.3g} %, {low:.2g} to {high:.2g} %"
        return f"| {self.name} | {self.found} of {self.of} | {share} | {asked} | {self.verdict} |"


def count(lines: Iterable[Line], name: str) -> int:
    """Sum over seeds of numbers, or of the lengths of lists, or of what is true."""
    values = [line.get(name) or 0 for line in lines]
    return sum(v if isinstance(v, int) else 1 if isinstance(v, str) else len(v) for v in values)


def seeds_with(lines: Iterable[Line], *names: str) -> int:
    """Seeds with any of these."""
    return sum(any(line.get(name) for name in names) for line in lines)


def goals(lines: list[Line]) -> list[Goal]:
    """All goals of a campaign."""
    n, faults = len(lines), [f for line in lines for f in line.get("faults", ()) if "shown" in f]
    judged = [f for f in faults if f["flagged"] or f["missed"]]
    flags, healthy = count(lines, "false_flags"), count(lines, "healthy")

    def none(name: str, key: str) -> Goal:
        return Goal(name, seeds_with(lines, key), n, least=SEEDS)

    return [
        none("seeds that hang", "hang"),
        none("seeds that crash", "crash"),
        none("seeds whose store cannot be read", "unreadable"),
        none("seeds with a gross false good", "false_good"),
        none("seeds with a false success", "false_success"),
        none("seeds with a contact with anything known", "contacts"),
        Goal("faults missed", sum(f["missed"] for f in judged), len(judged), MISSED),
        Goal("healthy positioners flagged", flags, healthy, FALSE_FLAGS),
    ]


def table(lines: list[Line]) -> list[str]:
    """Markdown: a row for each kind and one for all, then the goals."""
    out = [f"| {' | '.join((*HEAD, *GUARDS))} |".replace("_", " ")]
    out.append("|---|" + "--:|" * (len(HEAD) + len(GUARDS) - 1))
    out += [_row(kind, (kind,), lines) for kind in KINDS]
    out += [_row("of positioners", OF_POSITIONERS, lines), _row("all", KINDS, lines), ""]
    out += ["| goal | found | share, 95 % | asked | |", "|---|--:|---|---|---|"]
    return out + [str(goal) for goal in goals(lines)] + ["", *_further(lines)]


def _row(name: str, kinds: tuple[str, ...], lines: list[Line]) -> str:
    faults = [f for line in lines for f in line.get("faults", ()) if f["kind"] in kinds]
    seeds = [line for line in lines if any(f["kind"] in kinds for f in line.get("faults", ()))]
    shown = [f for f in faults if f.get("shown")]
    flagged, missed = (sum(bool(f.get(key)) for f in faults) for key in ("flagged", "missed"))
    still = sum(not f["flagged"] and not f["missed"] for f in shown)
    cells = [len(seeds), len(faults), len(shown), flagged, missed, still]
    cells += [count(seeds, guard) for guard in GUARDS]
    return f"| {name.replace('_', ' ')} | {' | '.join(map(str, cells))} |"


def _further(lines: list[Line]) -> list[str]:
    exits = [code for line in lines for code in line.get("exits", ())]
    codes = ", ".join(f"{code}: {exits.count(code)}" for code in sorted(set(exits)))
    cpu = [line["cpu_s"] for line in lines if "cpu_s" in line]
    return [
        f"{len(lines)} seeds, {sum(cpu) / max(len(cpu), 1):.1f} CPU s each; "
        f"{count(lines, 'told_good')} fibres told on target",
        f"contacts with what nothing had shown yet: {count(lines, 'contacts_unknown')} in "
        f"{seeds_with(lines, 'contacts_unknown')} seeds; that no frame could prevent: "
        f"{count(lines, 'contacts_unreached')} in {seeds_with(lines, 'contacts_unreached')} seeds",
        f"arrays left locked by a collision: {count(lines, 'locked')}; no longer after `recover`: "
        f"{count(lines, 'recovered')}",
        f"commands by exit code: {codes}",
    ]


def exit_code(lines: list[Line]) -> int:
    """0: every goal reached; 1: one is not; 3: none is missed, but not all could be judged."""
    verdicts = {goal.verdict for goal in goals(lines)}
    if Verdict.MISSED in verdicts:
        return 1
    return 3 if Verdict.OPEN in verdicts else 0
