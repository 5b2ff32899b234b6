"""What it costs that any one positioner may be late: motion, processor time, and pairs that cannot bear it.

    python -m benchmarks.planning.late --pairs 3 --late 0 0.5 1 2 5 inf --layout DIR

The same random pairs A to B as `benchmarks.planning`. Every plan is verified, and the independent proof
(`verify_late`) says which pairs of positioners cannot bear the lateness: of the plan that was asked for it,
and of the one that was not. Medians and the worst over the pairs A to B. Without `--layout` a generated array
of `--hexagon` positioners.

Exit code 0: all plans verified, and no pair fails but those that the planner names; 1 otherwise.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from statistics import median
from typing import Any

from fiberloom.instruments import FocalPlane
from fiberloom.planning import Plan, PlanSettings, bound_s, plan, verify, verify_late

from .. import pairs

HEAD = [
    "| late s | over the bound, median / worst | motion s, median | plan CPU s, median / worst | "
    "cannot bear it, median / worst | the same without `late_s` | refused | proof CPU s |",
    "|--:|--:|--:|--:|--:|--:|--:|--:|",
]

Line = dict[str, Any]


def main() -> int:
    """Runs what the command line asks for."""
    asked = arguments()
    plane = pairs.array_of(str(asked.layout) if asked.layout else f"hexagon {asked.hexagon}")
    seeds = range(asked.first_seed, asked.first_seed + asked.pairs)
    print(f"{plane.n} positioners, buffer {asked.buffer:g} mm, {len(seeds)} pairs A to B")
    plain = {seed: made_of(plane, seed, asked.buffer, 0.0) for seed in seeds}
    print("\n".join(HEAD), flush=True)
    sound = True
    for late_s in asked.late:
        lines = [measured(plane, seed, asked.buffer, late_s, plain[seed]) for seed in seeds]
        print(row(late_s, lines), flush=True)
        sound &= all(line["sound"] for line in lines)
    return 0 if sound else 1


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.planning.late", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument(
        "--late", type=float, nargs="+", default=[0.0, 0.5, 1.0, 2.0], help="s; inf: for good"
    )
    parser.add_argument("--buffer", type=float, default=2.0, help="mm")
    parser.add_argument("--layout", type=Path, help="calibration tables")
    parser.add_argument("--hexagon", type=int, default=127, help="generated array, positioners")
    return parser.parse_args()


def made_of(plane: FocalPlane, seed: int, buffer_mm: float, late_s: float) -> tuple[Plan, float]:
    """A plan of a seed, and its processor time in s."""
    ends_deg = pairs.ends_of(plane, seed, buffer_mm)
    settings = PlanSettings(collision_buffer_mm=buffer_mm, late_s=late_s)
    begin_s = time.process_time()
    made = plan(plane, *ends_deg, seed=seed, settings=settings)
    return made, time.process_time() - begin_s


def measured(
    plane: FocalPlane, seed: int, buffer_mm: float, late_s: float, plain: tuple[Plan, float]
) -> Line:
    """One pair A to B at one lateness."""
    made, cpu_s = made_of(plane, seed, buffer_mm, late_s) if late_s else plain
    start_deg, goal_deg = pairs.ends_of(plane, seed, buffer_mm)
    begin_s = time.process_time()
    found = verify_late(plane, made, late_s)
    proof_s = time.process_time() - begin_s
    failing = found.failing_pairs
    return {
        "over": made.duration_s / bound_s(plane, start_deg, goal_deg, refused=made.refused),
        "motion_s": made.duration_s,
        "cpu_s": cpu_s,
        "proof_s": proof_s,
        "failing": len(failing),
        "without": len(verify_late(plane, plain[0], late_s).failing_pairs),
        "refused": len(made.refused),
        "sound": verify(plane, made, start_deg=start_deg, goal_deg=goal_deg).ok
        and (made.late_s < late_s or set(failing) <= set(made.not_late)),
    }


def row(late_s: float, lines: list[Line]) -> str:
    """Of the table."""

    def both(key: str, form: str) -> str:
        values = [line[key] for line in lines]
        return f"{median(values):{form}} / {max(values):{form}}"

    cells = [
        "for good" if late_s == float("inf") else f"{late_s:g}",
        both("over", ".2f"),
        f"{median(line['motion_s'] for line in lines):.1f}",
        both("cpu_s", ".1f"),
        both("failing", ".0f"),
        f"{median(line['without'] for line in lines):.0f}",
        f"{sum(line['refused'] for line in lines)}",
        f"{median(line['proof_s'] for line in lines):.1f}",
    ]
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    raise SystemExit(main())
