"""The planning campaign: a thousand random pairs A to B at each buffer, and who does not arrive.

    python -m benchmarks.planning.campaign --pairs 0:1000 --buffer 2.0 2.5 --workers 2 --out runs/planning

The array is the real one of SDSS-V where its tables are, or `--array DIR`, or `--array "hexagon 500"`.
Start and goal are drawn one by one: nobody looks whether there is a way. A positioner that is refused has
failed unless a flood of its two angles on a fine grid, which shares no code with the planner, proves that
there is no way past the bodies that rest for good (pockets.py). Run again, it goes on where it was stopped;
results of another build are not mixed: `--anew` puts them aside. Start, goal and reason of every failure
are kept in `failures/`. At the end the verifier is tried on mutated plans (mutants.py). Exit code 0: all
goals met; 1: one is missed, or too few pairs; 2: bad input; 130: interrupted.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from benchmarks.faults.campaign import Campaign, interruptible

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane, write_layout
from fiberloom.planning import bound_s, random_configuration, write_configuration
from fiberloom.typing import Floats, Ints

from . import goals, mutants, pairs
from .bodies import Bodies, read_bodies
from .builds import claim, mark_of_build
from .goals import Line
from .pockets import Pocket, Way, flood, meets_one

REASON = "pair.json"


@dataclass(frozen=True)
class Array:
    """One array at one buffer, read twice: for the planner, and from its tables for the flood."""

    name: str
    plane: FocalPlane
    bodies: Bodies
    buffer_mm: float

    @classmethod
    def of(cls, name: str, buffer_mm: float) -> Array:
        """`hexagon N`, or a folder of tables."""
        plane = pairs.array_of(name)
        if not name.startswith("hexagon "):
            return cls(Path(name).name, plane, read_bodies(Path(name)), buffer_mm)
        with tempfile.TemporaryDirectory() as folder:
            write_layout(plane, folder)
            return cls(name.replace(" ", "-"), plane, read_bodies(Path(folder)), buffer_mm)

    def ends_of(self, seed: int) -> tuple[Floats, Floats]:
        """Start and goal (N, 2) deg, each drawn for itself: a way from one to the other is not looked for."""
        start, goal = (
            random_configuration(self.plane, 2 * seed + end, collision_buffer_mm=self.buffer_mm)
            for end in (0, 1)
        )
        return start, goal


def main() -> int:
    """Runs what the command line asks for."""
    asked = arguments()
    return interruptible(asked.out, partial(run, asked))


def run(asked: argparse.Namespace) -> int:
    """All buffers, then the mutants, then the table."""
    rows, found, whys = {}, [], []
    for buffer_mm in asked.buffer:
        array = Array.of(_array_name(asked.array), buffer_mm)
        folder = asked.out / f"{array.name}-{buffer_mm:g}mm"
        if asked.again:
            again(array, asked)
            continue
        lines = pairs_of(array, folder, asked)
        wanted = goals.asked_at(buffer_mm, array.plane.n)
        if wanted is None:
            whys.append(f"{buffer_mm:g} mm, {array.plane.n} positioners: no goals")
        rows[buffer_mm] = goals.cells(lines, wanted), wanted
        found += rows[buffer_mm][0]
        whys += goals.told(buffer_mm, lines) + goals.only_off_the_stops(buffer_mm, lines)
    if asked.again:
        return 0
    print("\n".join([*goals.table(rows), "", *whys]))
    tried = mutants.tried(asked)
    print("\n".join(mutants.table(tried, asked)))
    return goals.exit_code([*found, *mutants.cells(tried, asked)])


def pairs_of(array: Array, folder: Path, asked: argparse.Namespace) -> list[Line]:
    """The lines of all pairs; those that are missing are computed."""
    claim(folder, array.plane.config_hash(), asked.anew)
    campaign = Campaign(folder, partial(one_pair, array), asked.workers, asked.deadline)

    def tell(line: Line) -> None:
        keep_failure(array, folder, line)
        print(_short(array, line), file=sys.stderr, flush=True)

    lines = campaign.run(range_of(asked.pairs), tell)
    for line in lines.values():  # killed between a line and its files
        keep_failure(array, folder, line)
    return list(lines.values())


def again(array: Array, asked: argparse.Namespace) -> None:
    """Some pairs elsewhere, so that the file keeps what it has."""
    with tempfile.TemporaryDirectory() as folder:
        campaign = Campaign(Path(folder), partial(one_pair, array), asked.workers, asked.deadline)
        for line in campaign.run(asked.again).values():
            print(json.dumps(line, indent=1))


# one pair


def one_pair(array: Array, seed: int, log: Path) -> Line:
    """In a process of its own."""
    try:
        ends_deg = array.ends_of(seed)
    except InputError as error:
        return {"seed": seed, "not_drawn": str(error)}
    made = pairs.made_of(array.plane, ends_deg, array.buffer_mm, seed)
    refused = {int(number): why for number, why in made.plan.refused.items()}
    rightly = pocketed(array.bodies, list(refused), ends_deg, array.buffer_mm)
    least_s = bound_s(array.plane, *ends_deg, refused=refused)
    points = made.plan.points_per_axis or [1]
    log.unlink(missing_ok=True)
    return {
        "seed": seed,
        **mark_of_build(),
        "failed": {str(number): why for number, why in refused.items() if number not in rightly},
        "rightly": {str(number): how for number, how in rightly.items()},
        "verified": made.found.ok,
        "why": "" if made.found.ok else str(made.found),
        "motion_s": made.plan.duration_s,
        "ratio": made.plan.duration_s / least_s if least_s else 1.0,
        "cpu_s": made.plan_cpu_s,
        "verify_cpu_s": made.verify_cpu_s,
        "gap_um": 1e3 * made.found.min_clearance_mm,
        "points_mean": float(np.mean(points)),
        "points_worst": max(points),
    }


def pocketed(
    bodies: Bodies, refused: list[int], ends_deg: tuple[Floats, Floats], buffer_mm: float
) -> dict[int, str]:
    """Of positioners that a plan refuses, those that cannot arrive, with the proof in words.

    First alone; then those that positioners in pockets, wherever there, keep from it, or that cannot arrive
    together with all that do: one in a pocket always meets one of their goals.
    """
    pockets: dict[int, Pocket] = {}
    proven: dict[int, str] = {}
    rows = [bodies.row_of(number) for number in refused]
    while True:
        before = len(proven)
        for number, row in zip(refused, rows, strict=True):
            if number in proven:
                continue
            arrive = np.setdiff1d(np.arange(len(bodies.centre)), [k for k in rows if k != row])
            if why := _one_too_many(bodies, row, arrive, pockets, ends_deg[1], buffer_mm):
                proven[number] = why
                continue
            found = flood(bodies, row, (ends_deg[0][row], ends_deg[1][row]), buffer_mm, pockets)
            if found.way == Way.NONE:
                others = f" beside {len(pockets)} in pockets" if pockets else " alone"
                near = np.intersect1d(list(pockets), bodies.neighbours(row, buffer_mm)).astype(int)
                room_deg = max([found.room_deg, *(pockets[k].room_deg for k in near)])
                proven[number] = f"no way{others}{_off(room_deg)}, cells of {found.cell_deg:g} deg"
                if found.pocket is not None:
                    pockets[row] = found.pocket
        if len(proven) == before:
            return proven


def _off(room_deg: float) -> str:
    """What a proof keeps to the hard stops, and a way up to them could undo."""
    return f" that keeps {room_deg:g} deg to {goals.STOPS}" if room_deg else ""


def _one_too_many(
    bodies: Bodies, row: int, arrive: Ints, pockets: Mapping[int, Pocket], goal_deg: Floats, buffer_mm: float
) -> str | None:
    """Why the goals of these rows, this one's among them, cannot all be held; None: nothing shows it."""
    for other, pocket in pockets.items():
        near = np.intersect1d(arrive, bodies.neighbours(other, buffer_mm))
        if row in near and meets_one(pocket, bodies.lines_of(near, goal_deg), buffer_mm):
            name = bodies.positioner_id[other]
            where = f"in a pocket{_off(pocket.room_deg)}"
            return f"not beside all that arrive: {name}, {where}, meets one of their goals"
    return None


# failures


def keep_failure(array: Array, folder: Path, line: Line) -> None:
    """Start, goal and reason of a pair that failed, in files from which it can be planned again."""
    if not goals.failed(line):
        return
    place = folder / "failures" / f"pair-{line['seed']}"
    if (place / REASON).exists():
        return
    place.mkdir(parents=True, exist_ok=True)
    for name, angles_deg in zip(("start", "goal"), array.ends_of(line["seed"]), strict=True):
        write_configuration(place / f"{name}.csv", array.plane.positioner_id, angles_deg)
    reason = {"array": array.name, "buffer_mm": array.buffer_mm} | mark_of_build() | line
    (place / REASON).write_text(json.dumps(reason, indent=1) + "\n")


def _short(array: Array, line: Line) -> str:
    name = f"{array.buffer_mm:g} mm, pair {line['seed']}"
    if why := goals.told(array.buffer_mm, [line]):
        return why[0]
    return f"{name}: {line['ratio']:.3f} of the bound, {line['cpu_s']:.2f} CPU s"


def range_of(text: str) -> range:
    """A:B, the first and the one after the last."""
    first, _, after = text.partition(":")
    if not (first.isdigit() and after.isdigit()):
        raise InputError(f"--pairs {text}: A:B is asked for, the first and the one after the last")
    return range(int(first), int(after))


def _array_name(given: str | None) -> str:
    if given is not None:
        return given
    layout = pairs.real_layout()
    if layout is None:
        print(f"no real array: there is no {pairs.REAL}; `hexagon 500` in its place", file=sys.stderr)
        return "hexagon 500"
    return str(layout)


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.planning.campaign", description="planning campaign"
    )
    parser.add_argument("--pairs", default="0:1000", help="A:B: the first, and the one after the last")
    parser.add_argument("--buffer", type=float, nargs="+", default=[2.0, 2.5], help="mm")
    parser.add_argument("--array", help='a folder of tables, or "hexagon N"; the real array if left out')
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument(
        "--deadline", type=float, default=600.0, help="s of real time; a pair beyond it fails"
    )
    parser.add_argument("--again", type=int, nargs="+", help="these pairs only, in full, kept nowhere")
    parser.add_argument("--anew", action="store_true", help="puts results of another build aside")
    parser.add_argument("--mutants", type=int, default=mutants.MUTANTS, help="0: none")
    parser.add_argument("--grazing", type=int, default=mutants.GRAZING, help="0: none")
    parser.add_argument("--out", type=Path, default=Path("runs/planning"))
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
