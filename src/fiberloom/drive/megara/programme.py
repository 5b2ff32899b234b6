"""Programmes of moves as MEGARA's control reads them: groups of goals in steps, one line a rotor.

    pos_0 {
        group_1 {
        rp1 r1 40685
        rp1 r2 -0
        }
    }

All rotors of a group start together; a group waits until the one before has ended. Goals count from home.
Format: sample programmes of guaix-ucm/megara-fmpt, 2017.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from fiberloom.errors import InputError
from fiberloom.typing import Ints

ROTORS = ("r1", "r2")
MOST_STEPS = 2**31 - 1
_HEAD = re.compile(r"pos_(\d{1,9})\s*\{")
_GROUP = re.compile(r"group_(\d{1,9})\s*\{")
_GOAL = re.compile(r"rp(\d{1,9})\s+(r[12])\s+(-?\d{1,10})")


@dataclass(frozen=True)
class MoveProgramme:
    """Groups of goals: for each robot by its number the steps of rotors 1 and 2."""

    groups: tuple[dict[int, tuple[int, int]], ...]
    number: int = 0
    """Of the pointing: pos_0."""

    def __post_init__(self) -> None:
        for k, group in enumerate(self.groups, 1):
            for robot, (r1, r2) in group.items():
                if not (0 <= r1 <= MOST_STEPS and -MOST_STEPS <= r2 <= 0):
                    raise InputError(
                        f"group_{k}: rp{robot}: r1 {r1}, r2 {r2}; r1 >= 0 and r2 <= 0 of 31 bits fit"
                    )

    @property
    def robots(self) -> list[int]:
        """Numbers of those that have a goal anywhere, rising."""
        return sorted(set().union(*self.groups))

    def ends(self) -> dict[int, tuple[int, int]]:
        """Steps (r1, r2) of each robot after the last group."""
        return {robot: goal for group in self.groups for robot, goal in group.items()}

    def steps_of(self, robots: Ints) -> Ints:
        """(G + 1, N, 2) steps of robots (N,) before the first group, all home, and after each."""
        out = np.zeros((len(self.groups) + 1, len(robots), 2), dtype=np.int64)
        for k, group in enumerate(self.groups):
            out[k + 1] = out[k]
            for row, robot in enumerate(np.asarray(robots).tolist()):
                if robot in group:
                    out[k + 1, row] = group[robot]
        return out

    def back(self) -> MoveProgramme:
        """The same way in reverse: from its end, group by group, to home; the last group goes back first."""
        states: list[dict[int, tuple[int, int]]] = [dict.fromkeys(self.robots, (0, 0))]
        for group in self.groups:
            states.append(states[-1] | group)
        pairs = zip(self.groups, states, strict=False)
        return MoveProgramme(tuple({k: at[k] for k in group} for group, at in pairs)[::-1], self.number)

    def text(self) -> str:
        """As a file."""
        lines = [f"pos_{self.number} {{"]
        for k, group in enumerate(self.groups, 1):
            lines.append(f"\tgroup_{k} {{")
            for robot, (r1, r2) in group.items():
                lines += [f"\trp{robot} r1 {r1}", f"\trp{robot} r2 -{-r2}"]
            lines.append("\t}")
        return "\n".join([*lines, "}"])


def read_programme(text: str) -> MoveProgramme:
    """The programme of a text; InputError with line, what is there, and what is wanted."""
    lines = [(k, line.strip()) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    if not lines or not (head := _HEAD.fullmatch(lines[0][1])):
        raise InputError("programme: must begin with 'pos_NUMBER {'")
    if len(lines) < 2 or lines[-1][1] != "}":
        raise InputError(f"programme: line {lines[-1][0]}: must end with the '}}' of pos_{head[1]}")
    groups: list[dict[int, tuple[int, int]]] = []
    open_: dict[int, dict[str, int]] | None = None
    for k, line in lines[1:-1]:
        if open_ is None:
            if (found := _GROUP.fullmatch(line)) is None or int(found[1]) != len(groups) + 1:
                raise InputError(
                    f"programme: line {k}: {line[:40]!r}; 'group_{len(groups) + 1} {{' is wanted"
                )
            open_ = {}
        elif line == "}":
            groups.append(_whole(open_, k))
            open_ = None
        else:
            _take(open_, line, k)
    if open_ is not None:
        raise InputError(f"programme: line {lines[-1][0]}: group_{len(groups) + 1} is not closed by '}}'")
    return MoveProgramme(tuple(groups), int(head[1]))


def _take(group: dict[int, dict[str, int]], line: str, k: int) -> None:
    """A goal of a rotor into the group that is open."""
    if (found := _GOAL.fullmatch(line)) is None:
        raise InputError(f"programme: line {k}: {line[:40]!r}; 'rpNUMBER r1|r2 STEPS' or '}}' is wanted")
    goals = group.setdefault(int(found[1]), {})
    if found[2] in goals:
        raise InputError(f"programme: line {k}: rp{found[1]} {found[2]} has a goal in this group already")
    goals[found[2]] = int(found[3])


def _whole(group: dict[int, dict[str, int]], k: int) -> dict[int, tuple[int, int]]:
    for robot, goals in group.items():
        if len(goals) != len(ROTORS):
            raise InputError(f"programme: line {k}: rp{robot} needs goals of r1 and r2 in its group")
    return {robot: (goals["r1"], goals["r2"]) for robot, goals in group.items()}
