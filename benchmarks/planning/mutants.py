"""The verifier against an independent oracle, on mutated plans.

    python -m benchmarks.planning.mutants --mutants 10000 --grazing 1000 --workers 2 --out runs/planning

A plan that the verifier passes gets one of its motions shifted in time or angle, exchanged with a
neighbour's, cut or scaled. A grazing mutant is one whose smallest gap, by brute force, is within 0.02 mm of
touching. The oracle (oracle.py) says whether something that moves touches anything. Missed: it touches and
the verifier is content; false: it does not and the verifier complains. Such mutants are kept in `wrong/`.
Exit codes as of the campaign, of which this is a part; it resumes as well.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from benchmarks.faults.campaign import Campaign, interruptible

from fiberloom.instruments import FocalPlane, write_layout
from fiberloom.planning import Plan, PlanSettings, Trajectory, plan, random_pair
from fiberloom.typing import Floats, Ints

from . import pairs
from .bodies import Bodies, read_bodies
from .builds import claim, mark_of_build
from .goals import Cell, Line, Verdict
from .oracle import Answer, Scene, Way, answer, least_gap

MUTANTS, GRAZING = 10_000, 1_000
EACH, GRAZING_EACH = 100, 10
"""Of one plan."""
KINDS = ("late", "early", "angles", "swapped", "cut", "scaled", "slower")
GRAZED = ("late", "angles", "scaled")
"""Kinds whose size can be turned until they graze."""
GRAZE_MM, NEAR_MM = 0.02, 0.005
BUFFERS_MM = (1.5, 2.0, 2.5, 3.0)
POSITIONERS = 61
LONGER_S = 6.0
"""A mutant lasts at most so much longer than its plan, or twice as long."""
OPEN_SHARE = 0.002
"""The oracle may leave so many open."""
Motions = dict[int, Trajectory]


def main() -> int:
    """Runs what the command line asks for."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.planning.mutants", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--mutants", type=int, default=MUTANTS)
    parser.add_argument("--grazing", type=int, default=GRAZING)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument(
        "--deadline", type=float, default=600.0, help="s of real time for the mutants of a plan"
    )
    parser.add_argument("--anew", action="store_true", help="puts results of another build aside")
    parser.add_argument("--out", type=Path, default=Path("runs/planning"))
    asked = parser.parse_args()
    return interruptible(asked.out, partial(run, asked))


def run(asked: argparse.Namespace) -> int:
    """All mutants, then the table."""
    lines = tried(asked)
    print("\n".join(table(lines, asked)))
    return int(any(cell.verdict in (Verdict.MISSED, Verdict.FEW) for cell in cells(lines, asked)))


def tried(asked: argparse.Namespace) -> list[Line]:
    """A line per plan with its mutants."""
    plans = max(-(-asked.mutants // EACH), -(-asked.grazing // GRAZING_EACH))
    folder = asked.out / "mutants"
    claim(folder, "mutants", asked.anew)
    work = partial(of_one_plan, folder, asked.mutants > 0, asked.grazing > 0)
    campaign = Campaign(folder, work, asked.workers, asked.deadline)
    return list(campaign.run(range(plans), _tell).values()) if plans else []


def _tell(line: Line) -> None:
    wrong = {key: line[key] for key in ("missed", "false", "crash", "hang") if line.get(key)}
    print(f"mutants of plan {line['seed']}: {line.get('mutants', 0)}, {wrong or 'none wrong'}",
          file=sys.stderr, flush=True)  # fmt: skip


# the verdict


def table(lines: list[Line], asked: argparse.Namespace) -> list[str]:
    """What the verifier missed and told falsely."""
    if not lines:
        return ["", "the verifier was not tried on mutants"]
    out = ["", "| mutants | grazing | touch | missed | false | open |", "|--:|--:|--:|--:|--:|--:|"]
    found = cells(lines, asked)
    counts = [str(_sum(lines, key)) for key in ("mutants", "grazing", "touch")]
    out.append(f"| {' | '.join([*counts, *map(str, found)])} |")
    broken = [line for line in lines if line.get("crash") or line.get("hang")]
    return out + [f"plan {line['seed']}: {line.get('crash', 'takes too long')}" for line in broken]


def cells(lines: list[Line], asked: argparse.Namespace) -> list[Cell]:
    """Missed 0, false 0, few open; all of `MUTANTS` and `GRAZING` are needed to meet them."""
    if not lines:
        return []
    number, grazing = _sum(lines, "mutants"), _sum(lines, "grazing")
    enough = number >= MUTANTS + GRAZING and grazing >= GRAZING
    good = Verdict.MET if enough else Verdict.FEW
    broken = any(line.get("crash") or line.get("hang") for line in lines)
    out = []
    for key, most in (("missed", 0), ("false", 0), ("open", OPEN_SHARE * number)):
        found = _sum(lines, key)
        out.append(Cell(str(found), Verdict.MISSED if found > most or broken else good))
    return out


def _sum(lines: list[Line], key: str) -> int:
    return sum(int(line.get(key, 0)) for line in lines)


# mutants of one plan


def of_one_plan(folder: Path, plain: bool, grazing: bool, seed: int, log: Path) -> Line:
    """In a process of its own."""
    rng = np.random.default_rng([seed, 0x3A])
    plane, bodies = array_of(seed % 2)
    buffer_mm = BUFFERS_MM[seed % len(BUFFERS_MM)]
    ends_deg = random_pair(plane, seed, collision_buffer_mm=buffer_mm)
    made = plan(plane, *ends_deg, seed=seed, settings=PlanSettings(collision_buffer_mm=buffer_mm))
    scene = Scene.of(bodies, made, 2.0 * made.duration_s + LONGER_S)
    line: Line = {"seed": seed, **mark_of_build(), "mutants": 0, "grazing": 0, "touch": 0}
    line |= {"missed": 0, "false": 0, "open": 0, "plan": str(answer(scene, range(plane.n)))}
    if line["plan"] == Answer.TOUCH:
        line["missed"] += 1  # `plan` has verified it
    for k in range(EACH * plain + GRAZING_EACH * grazing):
        graze = k >= EACH * plain
        motions = grazing_mutant(rng, made, scene) if graze else mutant(rng, made, bodies)
        if not motions:
            continue  # nothing to graze; the count tells
        changed = with_motions(made, motions)
        said = not pairs.clear(plane, changed).collisions
        sure = answer(
            scene.with_others(Way.of(bodies, m) for m in motions.values()), rows_of(bodies, motions)
        )
        judge(line, sure, said)
        line["mutants"] += 1
        line["grazing"] += graze
        if (sure == Answer.TOUCH and said) or (sure == Answer.CLEAR and not said):
            place = folder / "wrong"
            place.mkdir(exist_ok=True)
            changed.save(place / f"plan-{seed}-mutant-{k}.json", array=seed % 2, oracle=str(sure))
    log.unlink(missing_ok=True)
    return line


def judge(line: Line, sure: Answer, content: bool) -> None:
    """Counts one mutant: what the oracle is sure of, and whether the verifier is content."""
    line["touch"] += sure == Answer.TOUCH
    line["open"] += sure == Answer.OPEN
    line["missed"] += sure == Answer.TOUCH and content
    line["false"] += sure == Answer.CLEAR and not content


@cache
def array_of(which: int) -> tuple[FocalPlane, Bodies]:
    """61 positioners: in the middle of a generated array with its fiducials, or beside a guide camera."""
    plane = pairs.array_of("hexagon 500")
    camera = plane.guide_cameras[0].reshape(-1)
    at = plane.centres_mm[0] * 0.0 if which == 0 else (camera[:2] + camera[2:4]) / 2
    nearest = np.argsort(np.hypot(*(plane.centres_mm - at).T), kind="stable")[:POSITIONERS]
    plane = plane.select(np.sort(nearest))
    with tempfile.TemporaryDirectory() as folder:
        write_layout(plane, folder)
        return plane, read_bodies(Path(folder))


def rows_of(bodies: Bodies, motions: Motions) -> list[int]:
    """Of the positioners that move otherwise."""
    return [bodies.row_of(number) for number in motions]


def with_motions(made: Plan, motions: Motions) -> Plan:
    """The plan with other motions of some."""
    return replace(made, robots=tuple(motions.get(robot.positioner_id, robot) for robot in made.robots))


def mutant(rng: np.random.Generator, made: Plan, bodies: Bodies) -> Motions:
    """One motion, or two, changed at random."""
    kind = str(rng.choice(KINDS))
    robot = _mover(rng, made)
    if kind == "swapped":
        near: Ints = bodies.neighbours(bodies.row_of(robot.positioner_id), made.collision_buffer_mm)
        other = made.robots[int(rng.choice(near))]
        numbers = robot.positioner_id, other.positioner_id
        swapped = replace(other, positioner_id=numbers[0]), replace(robot, positioner_id=numbers[1])
        return {moved.positioner_id: moved for moved in swapped}
    # small ones as often as large ones
    size = float(10.0 ** rng.uniform(-3.0, 0.0))
    return {robot.positioner_id: changed(robot, kind, size, _direction(rng))}


def grazing_mutant(rng: np.random.Generator, made: Plan, scene: Scene) -> Motions:
    """One motion changed so far that it just grazes something; empty where none of 50 does."""
    for _ in range(50):
        robot, kind, turn = _mover(rng, made), str(rng.choice(GRAZED)), _direction(rng)
        row = scene.bodies.row_of(robot.positioner_id)

        def gap(size: float, robot: Trajectory = robot, kind: str = kind, turn: complex = turn,
                row: int = row) -> float:  # fmt: skip
            way = Way.of(scene.bodies, changed(robot, kind, size, turn))
            return least_gap(scene.with_others([way]), [row], NEAR_MM / 10)

        wanted = float(rng.uniform(-GRAZE_MM, GRAZE_MM))
        low, high = 0.0, 1.0
        if gap(low) <= wanted or gap(high) >= wanted:
            continue
        for _ in range(40):
            middle = (low + high) / 2
            found = gap(middle)
            if abs(found - wanted) < NEAR_MM and abs(found) <= GRAZE_MM:
                return {robot.positioner_id: changed(robot, kind, middle, turn)}
            low, high = (middle, high) if found > wanted else (low, middle)
    return {}


def changed(robot: Trajectory, kind: str, size: float, turn: complex) -> Trajectory:
    """A motion changed by a size of 0 to 1: 5 s, 10 deg, or up to the double.

    `turn`: which way in alpha and beta, a number of modulus 1.
    """
    time_s, angles = robot.time_s, robot.points_deg
    if kind == "late":
        time_s = np.concatenate([[0.0], time_s + max(5.0 * size, 1e-6)])
        angles = np.vstack([angles[:1], angles])
    elif kind == "early":
        begin_s = min(5.0 * size, 0.9 * float(time_s[-1]))
        time_s, angles = _between(robot, begin_s, float(time_s[-1]))
    elif kind == "cut":
        time_s, angles = _between(robot, 0.0, max(size, 1e-2) * float(time_s[-1]))
    elif kind == "angles":
        angles = angles + 10.0 * size * np.array([turn.real, turn.imag])
    elif kind == "scaled":
        angles = angles[0] + (angles - angles[0]) * (1.0 + size * np.array([turn.real, turn.imag]))
    elif kind == "slower":
        time_s = time_s * (1.0 + size)
    return Trajectory(robot.positioner_id, time_s, *angles.T)


def _between(robot: Trajectory, begin_s: float, end_s: float) -> tuple[Floats, Floats]:
    """Points of a part of the motion, from time 0."""
    inner = robot.time_s[(robot.time_s > begin_s) & (robot.time_s < end_s)]
    when_s = np.concatenate([[begin_s], inner, [end_s]])
    return when_s - begin_s, robot.at(when_s)


def _mover(rng: np.random.Generator, made: Plan) -> Trajectory:
    movers = [robot for robot in made.robots if robot.moves]
    return movers[int(rng.integers(len(movers)))]


def _direction(rng: np.random.Generator) -> complex:
    return complex(np.exp(2j * np.pi * rng.random()))


if __name__ == "__main__":
    sys.exit(main())
