"""What one way apart is worth: verified again, and looked at where the arms really are."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import BODY_SHARE
from fiberloom.planning import MotionLimits, Plan, Trajectory, Untangled, verify
from fiberloom.typing import Floats

ANY = 1e9
HEAD = (
    "| array | from | off deg | overlap | freed, verified | all at the goal | new contacts | stages "
    "| motion s | CPU s |\n|---|---|--:|--:|--:|--:|--:|--:|--:|--:|"
)


@dataclass(frozen=True)
class Case:
    """What is tried. Two with the same words are the same."""

    array: str
    start: str
    """A kind of collision or of stop; `twin` before it where the firmware carries it out."""
    off_deg: float
    """By which angles are wrong at most, on each axis."""
    seed: int

    def __str__(self) -> str:
        return f"{self.array}, {self.start}, {self.off_deg:g} deg, seed {self.seed}"


@dataclass(frozen=True)
class Judged:
    """What one case came to."""

    overlaps: int
    """Pairs that overlap the buffer at the start."""
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
    whole: bool = False
    """All must get to their goals."""

    @property
    def good(self) -> bool:
        """In a safe place, and touched nothing anew on the way."""
        return self.free and self.verified and not self.contacts and not (self.whole and self.away)


def judge(plane: FocalPlane, found: Untangled, off_deg: Floats, whole: bool = False) -> Judged:
    """Every stage verified again. `off_deg` (N, 2): by how much angles are wrong."""
    return Judged(
        len(found.overlaps),
        found.free,
        verified(plane, found),
        sum(new_contacts(plane, stage.plan, off_deg) for stage in found.stages),
        len(found.refused),
        len(found.stages),
        found.duration_s,
        found.cpu_s,
        proven_off(found),
        whole,
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


def new_contacts(plane: FocalPlane, plan: Plan, off_deg: Floats) -> int:
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


def line(rows: list[tuple[Case, Judged]]) -> str:
    """One row of the table."""
    case, seen = rows[0][0], [judged for _, judged in rows]
    cpu_s, motion_s = [r.cpu_s for r in seen], [r.motion_s for r in seen]
    cells = (
        case.array,
        case.start,
        f"{case.off_deg:g}",
        sum(r.overlaps > 0 for r in seen),
        f"{sum(r.free and r.verified for r in seen)} of {len(seen)}",
        f"{sum(r.away == 0 for r in seen)} of {len(seen)}",
        sum(r.contacts for r in seen),
        f"{np.mean([r.stages for r in seen]):.1f}",
        f"{np.median(motion_s):.0f} / {max(motion_s):.0f}",
        f"{np.median(cpu_s):.2f} / {max(cpu_s):.2f}",
    )
    return "| " + " | ".join(map(str, cells)) + " |"


class Results:
    """Those of cases that have been tried, in a file if there is one."""

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.known: dict[Case, Judged] = {}
        if path is not None and path.exists():
            whole = [text for text in path.read_text().splitlines() if text.endswith("}}")]
            path.write_text("".join(f"{text}\n" for text in whole))  # the last may have been cut short
            for entry in map(json.loads, whole):
                judged = entry["judged"] | {"off_deg": tuple(entry["judged"]["off_deg"])}
                self.known[Case(**entry["case"])] = Judged(**judged)

    def add(self, case: Case, judged: Judged) -> None:
        """Keeps it."""
        self.known[case] = judged
        if self.path is not None:
            with self.path.open("a") as file:
                file.write(json.dumps({"case": asdict(case), "judged": asdict(judged)}) + "\n")
