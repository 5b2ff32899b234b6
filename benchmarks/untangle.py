"""Collided fields taken apart: how many, how long it takes, and whether anything new touches.

    python benchmarks/untangle.py [--positioners 37 61] [--seeds 100] [--kinds "two arms" knot ...]
    python benchmarks/untangle.py --twin [--positioners 37] [--seeds 20]

Each seed is a random field in which one positioner (two for a knot) moved from a false place until it met
something. `untangle` plans from there; every stage is verified again. New contacts are looked for where
the arms really are: each is up to --off deg from where it is said to be, on both axes, and the bodies have
their own radius, 1.5 mm, instead of the buffer's 2.0. Bodies that touch at the start may only part.

`--twin`: the collision happens on the twin, and the firmware carries the stages out. New contacts are those
that the twin itself has seen. Exit code 1 where something is not freed, not verified or touches anew.
"""

import argparse
import asyncio
import sys
from dataclasses import dataclass, replace

import numpy as np

from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.field import Field
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import BODY_SHARE
from fiberloom.planning import MotionLimits, Plan, Trajectory, Untangled, untangle, verify
from fiberloom.planning.crashes import KINDS, random_crash
from fiberloom.studies.untangling import collide_and_untangle

ANY = 1e9
HEAD = "| positioners | collision | freed | at the goal | new contacts | stages | motion s | CPU s |"


@dataclass(frozen=True)
class Row:
    """What one seed came to."""

    free: bool
    verified: bool
    contacts: int
    away: int
    """Positioners, not immobile ones, that did not get to their goal."""
    stages: int
    motion_s: float
    cpu_s: float
    off_deg: tuple[float, ...]
    """For how wrong angles each retreat is proven."""


def main() -> int:
    """Run what the command line asks for."""
    given = arguments()
    print(HEAD)
    print("|--:|---|--:|--:|--:|--:|--:|--:|", flush=True)
    good = True
    for n in given.positioners:
        plane = FocalPlane.of("sdssv", n=n)
        maps = Field.twin(plane, camera="noise").run.calibrate() if given.twin else None
        for kind in given.kinds:
            rows = [one(plane, maps, seed, kind, given.off) for seed in seeds(given)]
            print(line(n, kind, rows), flush=True)
            good &= all(row.free and row.verified and not row.contacts for row in rows)
    return 0 if good else 1


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--positioners", type=int, nargs="+", default=[37, 61])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--off", type=float, default=0.1, help="deg by which angles are wrong at most")
    parser.add_argument("--twin", action="store_true", help="collide and untangle on the twin")
    return parser.parse_args()


def seeds(given: argparse.Namespace) -> range:
    """Those asked for."""
    return range(given.first, given.first + given.seeds)


def one(plane: FocalPlane, maps: TransmissionMaps | None, seed: int, kind: str, off_deg: float) -> Row:
    """One collision."""
    row = by_plan(plane, seed, kind, off_deg) if maps is None else on_twin(plane, maps, seed, kind, off_deg)
    if not row.free or not row.verified or row.contacts or min(row.off_deg, default=1.0) < 0.2:
        print(f"{len(plane)} positioners, {kind}, seed {seed}: {row}", file=sys.stderr, flush=True)
    return row


def by_plan(plane: FocalPlane, seed: int, kind: str, off_deg: float) -> Row:
    """Planned and verified."""
    crash = random_crash(plane, seed, kind)
    found = untangle(crash.plane, crash.start_deg, seed=seed)
    rng = np.random.default_rng([seed, 0x0FF])
    off = rng.uniform(-off_deg, off_deg, (plane.n, 2))
    return Row(
        found.free,
        verified(crash.plane, found),
        sum(new_contacts(crash.plane, stage.plan, off) for stage in found.stages),
        len(found.refused),
        len(found.stages),
        found.duration_s,
        found.cpu_s,
        proven_off(found),
    )


def proven_off(found: Untangled) -> tuple[float, ...]:
    """Of each retreat."""
    return tuple(s.uncertainty_deg for s in found.stages if s.uncertainty_deg is not None)


def verified(plane: FocalPlane, found: Untangled) -> bool:
    """Every stage, from where the one before ends."""
    here = found.start_deg
    for stage in found.stages:
        limits = MotionLimits(separating=stage.separates)
        if not verify(plane, stage.plan, start_deg=here, limits=limits).ok:
            return False
        here = stage.plan.end_deg
    return True


def new_contacts(plane: FocalPlane, plan: Plan, off_deg: np.ndarray) -> int:
    """Bodies that come to touch, or to press harder, where the arms really are."""
    moved = plane.with_offline(
        plane.positioner_id[plane.offline], (plane.offline_position_deg + off_deg)[plane.offline]
    )
    shifted = [
        Trajectory(r.positioner_id, r.time_s, r.alpha_deg + off[0], r.beta_deg + off[1])
        for r, off in zip(plan.robots, off_deg, strict=True)
    ]
    limits = MotionLimits(ANY, ANY, BODY_SHARE * plan.collision_buffer_mm, separating=True)
    return len(verify(moved, replace(plan, robots=tuple(shifted)), limits=limits).collisions)


def on_twin(plane: FocalPlane, maps: TransmissionMaps, seed: int, kind: str, off_deg: float) -> Row:
    """Carried out."""
    seen = asyncio.run(collide_and_untangle(plane, maps, seed, kind, off_deg))
    return Row(
        seen.free,
        bool(seen.touches) or kind == "buffer",
        len(seen.new_touches),
        seen.positioners - seen.at_goal,
        sum(len(found.stages) for found in seen.found),
        sum(found.duration_s for found in seen.found),
        max(found.cpu_s for found in seen.found),
        tuple(off for found in seen.found for off in proven_off(found)),
    )


def line(n: int, kind: str, rows: list[Row]) -> str:
    """One row of the table."""
    cpu_s = [row.cpu_s for row in rows]
    motion_s = [row.motion_s for row in rows]
    cells = (
        n,
        kind,
        f"{sum(r.free and r.verified for r in rows)} of {len(rows)}",
        f"{sum(r.away == 0 for r in rows)} of {len(rows)}",
        sum(r.contacts for r in rows),
        f"{np.mean([r.stages for r in rows]):.1f}",
        f"{np.median(motion_s):.0f} / {max(motion_s):.0f}",
        f"{np.median(cpu_s):.2f} / {max(cpu_s):.2f}",
    )
    return "| " + " | ".join(map(str, cells)) + " |"


if __name__ == "__main__":
    sys.exit(main())
