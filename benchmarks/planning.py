"""Planning of random pairs A -> B: solved, motion over its bound, CPU seconds. JSON out.

    python benchmarks/planning.py --pairs 5 --buffer 2.0 2.5 --layout DIR --out planning.json

Each pair is drawn so that every positioner stands free with 0.2 mm to spare at both ends and, alone,
gets from one to the other. The bound is that of `fiberloom.planning.bound_s`. Every plan is verified; the
verifier's time is given apart. One thread.
"""

import argparse
import json
import platform
import time
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.instruments import FocalPlane, generate, load_instrument, read_layout
from fiberloom.planning import PlanSettings, bound_s, plan, random_pair, verify
from fiberloom.version import __version__

INSTRUMENT = load_instrument("sdssv")


def main() -> None:
    """Run what the command line asks for."""
    asked = arguments()
    rows = []
    for name, plane in planes(asked):
        for buffer_mm in asked.buffer:
            rows.append(measure(name, plane, buffer_mm, asked))
            print(line(rows[-1]), flush=True)
    report = {"version": __version__, "machine": platform.processor(), "rows": rows}
    if asked.out:
        asked.out.write_text(json.dumps(report, indent=1) + "\n")


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--buffer", type=float, nargs="+", default=[2.0])
    parser.add_argument("--hexagon", type=int, nargs="*", default=[500], help="generated planes")
    parser.add_argument("--layout", type=Path, help="folder of SDSS-V calibration tables")
    parser.add_argument("--deadline", type=float, default=PlanSettings().first_deadline)
    parser.add_argument("--out", type=Path, help="JSON file")
    parser.add_argument("--verbose", action="store_true", help="one line per pair")
    return parser.parse_args()


def planes(asked: argparse.Namespace) -> list[tuple[str, FocalPlane]]:
    """The focal planes to plan for."""
    out = [] if asked.layout is None else [(asked.layout.name, read_layout(asked.layout, INSTRUMENT))]
    return out + [(f"hexagon {n}", generate(INSTRUMENT, 0, n)) for n in asked.hexagon]


def measure(name: str, plane: FocalPlane, buffer_mm: float, asked: argparse.Namespace) -> dict:
    """All pairs of one row."""
    pairs = [
        one_pair(plane, buffer_mm, seed, asked.deadline)
        for seed in range(asked.first_seed, asked.first_seed + asked.pairs)
    ]
    if asked.verbose:
        for pair in pairs:
            print(json.dumps(pair), flush=True)
    solved = [p for p in pairs if p["solved"]]
    row: dict[str, Any] = {"array": name, "buffer_mm": buffer_mm, "pairs": len(pairs)}
    row["solved"] = len(solved)
    row["all_verified"] = all(p["verified"] for p in pairs)
    for key in ("motion_s", "ratio", "plan_cpu_s", "verify_cpu_s", "points_max"):
        values = [p[key] for p in solved]
        row[key] = {"median": float(np.median(values)), "max": max(values)} if values else None
    return row | {"each": pairs}


def one_pair(plane: FocalPlane, buffer_mm: float, seed: int, deadline: float) -> dict[str, Any]:
    """Plan one random pair."""
    start_deg, goal_deg = random_pair(plane, seed, collision_buffer_mm=buffer_mm)
    settings = PlanSettings(collision_buffer_mm=buffer_mm, first_deadline=deadline)
    made = plan(plane, start_deg, goal_deg, seed=seed, settings=settings)
    begin = time.thread_time()
    found = verify(plane, made, start_deg=start_deg, goal_deg=goal_deg)
    least_s = bound_s(plane, start_deg, goal_deg, settings=settings)
    return {
        "seed": seed,
        "solved": not made.refused,
        "verified": found.ok,
        "refused": list(made.refused.values()),
        "motion_s": made.duration_s,
        "ratio": made.duration_s / least_s,
        "plan_cpu_s": made.cpu_s,
        "verify_cpu_s": time.thread_time() - begin,
        "clearance_mm": found.min_clearance_mm,
        "points_max": max(len(r.time_s) for r in made.robots),
        "points_mean": float(np.mean([len(r.time_s) for r in made.robots])),
        "repairs": made.statistics["repairs"],
        "first_conflicts": made.statistics["first_conflicts"],
    }


def line(row: dict[str, Any]) -> str:
    """One row of the table."""
    cells = [row["array"], f"{row['buffer_mm']:g} mm", f"{row['solved']} of {row['pairs']}"]
    for key, form in (("motion_s", ".1f"), ("ratio", ".3f"), ("plan_cpu_s", ".2f")):
        value = row[key]
        cells.append("-" if value is None else f"{value['median']:{form}} / {value['max']:{form}}")
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    main()
