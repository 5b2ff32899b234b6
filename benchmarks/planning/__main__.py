"""Random pairs A to B by fiberloom and by kaiju: the same arrays, bodies, goals and speed, in one run.

    python -m benchmarks.planning --pairs 5 --buffer 1.5 2.0 2.5 3.0 --hexagon 500 1000 2000 5000

Each pair is drawn so that every positioner stands free with 0.2 mm to spare at both ends and, alone, gets
from one to the other. The real array is added where its tables are (`--layout DIR`). kaiju goes by the folded
lattice, there and back; its clearances are those that our verifier finds. The bound is the longest way of an
axis, approach included, at the common speed. CPU s: of all threads; kaiju's with its smoothing. `make kaiju`
builds kaiju.

Arrays of another instrument, with all its parts and keep-outs, ours alone:

    python -m benchmarks.planning --alone --generated --hexagon --preset "desi 5000" --buffer 1.58 --pairs 3

With `--keep DIR` each pair is kept at once, and the same command goes on where it was stopped; results of
another build are not mixed.

Exit code 0: compared; 1: a plan of ours does not pass the verifier; 2: bad input; 3: no comparison; 130:
interrupted.
"""

from __future__ import annotations

import argparse
import json
import math
import platform
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.faults.campaign import Campaign, interruptible

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.planning import bound_s
from fiberloom.version import __version__

from . import pairs, peer
from .builds import claim
from .rows import HEAD, Line, growth, row, show, smoothing, why

ALONE = "ours alone"


def main() -> int:
    """Runs what the command line asks for."""
    asked = arguments()
    if asked.keep:
        return interruptible(asked.keep, partial(run, asked))
    with tempfile.TemporaryDirectory() as folder:
        asked.keep = Path(folder)
        return run(asked)


def run(asked: argparse.Namespace) -> int:
    """All arrays at all buffers, then the tables."""
    reason = ALONE if asked.alone else peer.why_not()
    print(f"no comparison with kaiju: {reason}" if reason else "kaiju: there and back by the folded lattice")
    try:
        arrays = arrays_of(asked)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    print("\n".join(HEAD), flush=True)
    rows, each = [], []
    for name, plane in arrays:
        for buffer_mm in asked.buffer:
            folder = asked.keep / f"{name.replace(' ', '-')}-{buffer_mm:g}mm{'-alone' * bool(reason)}"
            lines = measured(plane, buffer_mm, asked, not reason, folder)
            each += [{"array": name, "buffer_mm": buffer_mm} | line for line in lines]
            for who in ("fiberloom", "kaiju"):
                if of_it := [line for line in lines if line["who"] == who]:
                    rows.append(row(name, buffer_mm, who, of_it))
                    print(show(rows[-1]), flush=True)
    print("\n".join(["", *smoothing(rows), *growth(rows), *why(each)]))
    report = {"version": __version__, "machine": platform.processor(), "no_comparison": reason or None}
    if asked.out:
        asked.out.write_text(json.dumps(report | {"rows": rows, "each": each}, indent=1) + "\n")
    if not all(line["verified"] for line in each if line["who"] == "fiberloom"):
        return 1
    return 3 if reason and not asked.alone else 0


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.planning", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--pairs", type=int, default=3)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--buffer", type=float, nargs="+", default=[2.0], help="mm")
    parser.add_argument("--hexagon", type=int, nargs="*", default=[500], help="generated arrays, positioners")
    parser.add_argument(
        "--preset", nargs="+", default=[], help='arrays of other instruments, as "desi 5000"; with --alone'
    )
    parser.add_argument(
        "--layout", type=Path, help="calibration tables; those beside the checkout if left out"
    )
    parser.add_argument("--generated", action="store_true", help="without the real array")
    parser.add_argument("--alone", action="store_true", help="without kaiju")
    parser.add_argument("--limit", type=float, default=1800.0, help="CPU s that kaiju has for a pair")
    parser.add_argument(
        "--keep", type=Path, help="folder where each pair is kept; goes on where it was stopped"
    )
    parser.add_argument("--out", type=Path, help="JSON file")
    parser.add_argument("--verbose", action="store_true", help="a line per pair, on stderr")
    return parser.parse_args()


def arrays_of(asked: argparse.Namespace) -> list[tuple[str, FocalPlane]]:
    """The focal planes to plan for."""
    layout = None if asked.generated else asked.layout or pairs.real_layout()
    if layout is None and not asked.generated:
        print(f"no real array: there is no {pairs.REAL}, and no --layout; generated ones only")
    names = [] if layout is None else [(layout.name, str(layout))]
    names += [(f"hexagon {n}", f"hexagon {n}") for n in asked.hexagon]
    if asked.preset and not asked.alone:
        raise InputError("--preset: kaiju knows one capsule for an arm; ours alone with --alone")
    names += [(name, name) for name in asked.preset]
    return [(name, pairs.array_of(place)) for name, place in names]


def measured(
    plane: FocalPlane, buffer_mm: float, asked: argparse.Namespace, both: bool, folder: Path
) -> list[Line]:
    """A line per pair and planner; what is in the folder is not computed again."""
    claim(folder, plane.config_hash())
    work = partial(one_pair, plane, buffer_mm, asked.limit if both else None)

    def tell(found: Line) -> None:
        if asked.verbose:
            print(json.dumps(found), file=sys.stderr, flush=True)

    seeds = range(asked.first_seed, asked.first_seed + asked.pairs)
    kept = Campaign(folder, work, deadline_s=math.inf).run(seeds, tell)
    return [line for found in kept.values() for line in found.get("lines") or [crashed(plane, found)]]


def one_pair(plane: FocalPlane, buffer_mm: float, limit_s: float | None, seed: int, log: Path) -> Line:
    """One pair by fiberloom and, with a limit, by kaiju; in a process of its own."""
    ends_deg = pairs.ends_of(plane, seed, buffer_mm)
    lines = [ours(plane, ends_deg, buffer_mm, seed)]
    if limit_s is not None:
        job = peer.job_of(plane, ends_deg, buffer_mm, pairs.speed_deg_s(plane), seed)
        lines.append(theirs(plane, peer.asked(plane, job, limit_s)))
    log.unlink(missing_ok=True)
    common = {"seed": seed, "positioners": plane.n, "bound_s": bound_s(plane, *ends_deg)}
    return {"seed": seed, "lines": [common | line for line in lines]}


def crashed(plane: FocalPlane, found: Line) -> Line:
    """The line of a pair whose process has died: none of ours arrives."""
    reason = found["crash"].strip().splitlines()[-1]
    failed = dict.fromkeys(map(str, plane.positioner_id), reason)
    common = {"seed": found["seed"], "positioners": plane.n, "bound_s": math.nan}
    return common | {"who": "fiberloom", "failed": failed, "verified": False, "cpu_s": 0.0}


def ours(plane: FocalPlane, ends_deg: Any, buffer_mm: float, seed: int) -> Line:
    """One pair by fiberloom."""
    made = pairs.made_of(plane, ends_deg, buffer_mm, seed)
    return {
        "who": "fiberloom",
        "failed": {str(number): reason for number, reason in made.plan.refused.items()},
        "verified": made.found.ok,
        "motion_s": made.plan.duration_s,
        "cpu_s": made.plan_cpu_s,
        "verify_cpu_s": made.verify_cpu_s,
        "gap_um": 1e3 * made.found.min_clearance_mm,
        "top_speed_deg_s": made.found.top_speed_deg_s,
        "points": made.plan.points_per_axis,
    }


def theirs(plane: FocalPlane, answer: peer.Answer) -> Line:
    """One pair by kaiju, judged by our verifier."""
    line: Line = {
        "who": "kaiju",
        "version": answer.version,
        "failed": {str(number): reason for number, reason in answer.failed.items()},
        "verified": False,
        "cpu_s": answer.plan_cpu_s + answer.smooth_cpu_s,
        "smooth_cpu_s": answer.smooth_cpu_s,
    }
    if answer.sent is None or answer.raw is None:
        return line
    found, raw = (pairs.clear(plane, made) for made in (answer.sent, answer.raw))
    return line | {
        "verified": not found.collisions,
        "motion_s": answer.sent.duration_s,
        "gap_um": 1e3 * found.min_clearance_mm,
        "raw_gap_um": 1e3 * raw.min_clearance_mm,
        "collisions": len(found.collisions),
        "top_speed_deg_s": found.top_speed_deg_s,
        "points": answer.sent.points_per_axis,
    }


if __name__ == "__main__":
    sys.exit(main())
