"""What swaps and strict priorities do on the real array: motion, CPU time, targets of each priority.

    python -m benchmarks.planning.motion --targets 1500 3500 --fields 4
    python -m benchmarks.planning.motion --targets 3500 --fields 1 --strict --priorities 40

Random lists one after the other: from the folded array to the first field, then from field to field. Each
move starts from what the plain assignment left. Three ways: plain; with the shortest ways of equally good
choices (`assign(start_deg=...)`); with swaps besides (`swap_targets`). Priorities are 1 to 5 as generated, or
as many as `--priorities` says; with 1 all targets are the same. `--strict` compares assignments alone: by
weight and strict.

Exit code 0: compared; 1: a way has other numbers of targets than the plain one; 2: there is no array.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from fiberloom.assignment import Assignment, AssignSettings, assign, swap_targets
from fiberloom.instruments import FocalPlane
from fiberloom.planning import bound_s, plan
from fiberloom.targets import TargetList, random_targets
from fiberloom.typing import Floats

from . import pairs

T = TypeVar("T")
HEAD = (
    "| targets | priorities | from | choice | bound s | motion s | refused | plans "
    "| CPU s, assign | CPU s, plans |",
    "|--:|--:|---|---|--:|--:|--:|--:|--:|--:|",
)


@dataclass(frozen=True)
class Way:
    """One way of choosing, and what came of it."""

    name: str
    found: Assignment
    assign_s: float
    bound_s: float
    motion_s: float
    refused: int
    plans: int
    plan_s: float


def timed(run: Callable[[], T]) -> tuple[T, float]:
    """What a call returns, and its CPU time in s."""
    begin = time.process_time()
    return run(), time.process_time() - begin


def three_ways(plane: FocalPlane, targets: TargetList, start_deg: Floats) -> Iterator[Way]:
    """Plain, shortest ways, and swaps besides; each planned and verified from the same start (N, 2)."""
    plain, plain_s = timed(lambda: assign(plane, targets))
    made, plan_s = timed(lambda: plan(plane, start_deg, plain.goal_deg, approach_deg=plain.approach_deg))
    least_s = bound_s(plane, start_deg, plain.goal_deg)
    yield Way("plain", plain, plain_s, least_s, made.duration_s, len(made.refused), 1, plan_s)
    near, near_s = timed(lambda: assign(plane, targets, start_deg=start_deg))
    swapped, swap_s = timed(lambda: swap_targets(plane, targets, near, start_deg))
    first, best = swapped.first, swapped.plan
    least_s = bound_s(plane, start_deg, near.goal_deg)
    yield Way("shortest ways", near, near_s, least_s, first.duration_s, len(first.refused), 1, first.cpu_s)
    last, n = swapped.assignment, swapped.n_plans
    least_s = bound_s(plane, start_deg, last.goal_deg)
    yield Way("with swaps", last, near_s, least_s, best.duration_s, len(best.refused), n, swap_s)


def served(targets: TargetList, found: Assignment) -> list[int]:
    """How many targets of each priority have a positioner, the highest first."""
    taken = targets.priority[found.target[found.target >= 0]]
    return [int((taken == value).sum()) for value in np.unique(targets.priority)[::-1]]


def drawn(plane: FocalPlane, n: int, seed: int, priorities: int | None) -> TargetList:
    """A random list of n targets."""
    targets = random_targets(plane, n, seed)
    if priorities is not None:
        targets.priority[:] = np.random.default_rng(seed).integers(1, priorities + 1, n)
    return targets


def motions(plane: FocalPlane, n: int, asked: argparse.Namespace) -> bool:
    """Prints the rows of fields of n targets; whether all ways observe as many targets."""
    start_deg, where, same = plane.park_deg, "folded", True
    for seed in range(asked.first_seed, asked.first_seed + asked.fields):
        targets = drawn(plane, n, seed, asked.priorities)
        ways = list(three_ways(plane, targets, start_deg))
        for way in ways:
            same &= served(targets, way.found) == served(targets, ways[0].found)
            times = f"{way.plans} | {way.assign_s:.1f} | {way.plan_s:.1f} |"
            motion = f"{way.bound_s:.1f} | {way.motion_s:.1f} | {way.refused} | {times}"
            levels = len(np.unique(targets.priority))
            print(f"| {n} | {levels} | {where} | {way.name} | {motion}", flush=True)
        start_deg, where = ways[0].found.goal_deg, f"field {seed}"
    return same


def strictness(plane: FocalPlane, n: int, asked: argparse.Namespace) -> None:
    """Prints targets of each priority by weight and strict, with CPU times."""
    for seed in range(asked.first_seed, asked.first_seed + asked.fields):
        targets = drawn(plane, n, seed, asked.priorities)
        for name, strict in (("by weight", False), ("strict", True)):
            how = AssignSettings(strict=strict)
            found, cpu_s = timed(partial(assign, plane, targets, settings=how))
            notes = f"; {'; '.join(found.notes)}" if found.notes else ""
            numbers = " ".join(map(str, served(targets, found)))
            print(f"{n} targets, seed {seed}, {name}: {numbers}; {cpu_s:.1f} CPU s{notes}", flush=True)


def main() -> int:
    """Runs what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.planning.motion")
    parser.add_argument("--targets", type=int, nargs="+", default=[1500, 3500])
    parser.add_argument("--fields", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--priorities", type=int, help="so many different ones; default: of the list")
    parser.add_argument("--strict", action="store_true", help="assignments by weight and strict")
    parser.add_argument("--layout", type=Path, help="tables of an array; default: beside the checkout")
    asked = parser.parse_args()
    layout = asked.layout or pairs.real_layout()
    if layout is None:
        print(f"there is no {pairs.REAL}, and no --layout", file=sys.stderr)
        return 2
    plane, same = pairs.array_of(str(layout)), True
    if not asked.strict:
        print("\n".join(HEAD), flush=True)
    for n in asked.targets:
        if asked.strict:
            strictness(plane, n, asked)
        else:
            same &= motions(plane, n, asked)
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
