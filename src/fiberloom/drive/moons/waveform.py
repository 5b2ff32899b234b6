"""Waveforms of MOONS: steps of each axis in segments of 125 ms, as near to a planned way as its rules allow.

In a segment an axis makes no step, or 62 to 250 (500 to 2000 a second); from one segment to the next the
number changes by 50 at most; from rest and before rest it is 68 at most (550 a second), and the last before
rest may be smaller than 62. A turn back counts as a rest (ukatc/fpu_driver, rules of version 5).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fiberloom.errors import InputError
from fiberloom.typing import Floats, Ints
from fiberloom.units import AXES

SEGMENT_S = 0.125
MOST_SEGMENTS = 256
LEAST, MOST, START, CHANGE = 62, 250, 68, 50
"""Steps of a segment."""


def broken_rule(steps: Ints) -> str:
    """Which rule the steps (K,) of an axis break first, and where; empty: none."""
    if len(steps) > MOST_SEGMENTS:
        return f"{len(steps)} segments; at most {MOST_SEGMENTS}"
    padded = [0, *steps.tolist(), 0]
    for k in range(1, len(padded) - 1):
        if why := _broken(*padded[k - 1 : k + 2]):
            return f"segment {k}: {padded[k]} steps {why}"
    return ""


def _broken(before: int, now: int, after: int) -> str:
    if now == 0:
        return ""
    before, after = (0 if now * other < 0 else other for other in (before, after))  # a turn is a rest
    if abs(now) > MOST or (abs(now) < LEAST and after != 0):
        return f"are not within {LEAST} and {MOST}"
    if max(abs(now) if before == 0 else 0, abs(now) if after == 0 else 0) > START:
        return f"are more than {START} beside a rest"
    if before != 0 and abs(now - before) > CHANGE and abs(now) > LEAST:
        return f"change by more than {CHANGE} from {before}"
    return ""


def check_waveform(steps: Ints) -> None:
    """InputError with the rule that the steps (K, 2) of a unit break first."""
    for axis, name in enumerate(AXES):
        if why := broken_rule(steps[:, axis]):
            raise InputError(f"moons: waveform, {name}: {why}")


def braking(steps: int) -> int:
    """Steps that an axis still makes after a segment of `steps`, until it may rest."""
    left = 0
    while steps > START:
        steps = max(steps - CHANGE, LEAST)
        left += steps
    return left


_BRAKING = np.array([braking(n) for n in range(MOST + 1)])


@dataclass
class _Axis:
    """One axis on its way."""

    at: int
    speed: int = 0
    """Signed steps of the last segment."""

    def follow(self, wanted: float, end: int) -> int:
        """The next segment, signed: towards where the plan is then, in the run that ends at `end`."""
        sign = 1 if end > self.at else -1
        left, desire, before = abs(end - self.at), sign * (wanted - self.at), abs(self.speed)
        steps = _allowed(before, desire, left)
        self.speed = sign * steps
        self.at += self.speed
        return self.speed


def _allowed(before: int, desire: float, left: int) -> int:
    """Steps nearest to what is desired, after a segment of `before`, with `left` to the end of the run."""
    if left == 0:
        return 0
    if left <= LEAST:  # the rest of a run: below the least only here
        return left if before > START or desire > 0.5 * left else 0
    high = START if before == 0 else min(MOST, before + CHANGE)
    low = max(LEAST, before - CHANGE)
    while high > low and _BRAKING[high] > left - high:
        high -= 1
    may_rest = before <= START
    if may_rest and desire < (LEAST if before == 0 else 0.5 * LEAST):
        return 0
    return int(np.clip(round(desire), min(low, high), high))


def waveform(time_s: Floats, counts: Floats, start: int) -> Ints:
    """(K,) steps of one axis along a way in counts, straight between times (n,) in s.

    `counts` (n,): those at the times, the first near `start`, where the axis is; the last is where it ends.
    Turns of fewer than `LEAST` steps are left out.
    """
    runs = _runs(time_s, counts, start)
    axis, out, t = _Axis(start), [], 0.0
    for begin_s, end_s, end in runs:
        # before its run an axis waits; a run is over when its end is reached
        while t + SEGMENT_S <= begin_s:
            out.append(0)
            t += SEGMENT_S
        axis.speed = 0
        while axis.at != end:
            t += SEGMENT_S
            wanted = float(end) if t >= end_s else float(np.interp(t, time_s, counts))
            out.append(axis.follow(wanted, end))
            if len(out) > 4 * MOST_SEGMENTS:
                raise InputError(f"moons: a way of {len(time_s)} points takes too long")
    return np.array(out, dtype=np.int64)


def _runs(time_s: Floats, counts: Floats, start: int) -> list[tuple[float, float, int]]:
    """Begin, end in s and last count of the parts of a way that go in one direction."""
    at = np.concatenate([[start], np.rint(counts[1:])]).astype(np.int64)
    corners = [0]
    for k in range(1, len(at)):
        ahead = at[k] - at[corners[-1]]
        if len(corners) > 1 and (at[corners[-1]] - at[corners[-2]]) * ahead > 0:
            corners[-1] = k
        elif abs(ahead) >= LEAST or k == len(at) - 1:
            corners.append(k)
    runs = []
    for first, last in pairwise(corners):
        if at[last] != at[first]:
            runs.append((_leaves_s(time_s, at, first, last), float(time_s[last]), int(at[last])))
    return runs


def _leaves_s(time_s: Floats, at: Ints, first: int, last: int) -> float:
    """When a run leaves its first place."""
    moved = np.flatnonzero(at[first : last + 1] != at[first])
    return float(time_s[first + moved[0] - 1])
