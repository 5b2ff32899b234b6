"""A blind move that was planned before its time, from where the field was expected to be.

While a shutter is open nothing moves, so that the start of the next move is known. It is proven all the same:
from the true start, by the verifier, when the move is to begin.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace

import numpy as np

from fiberloom.drive.port import Drive, Programme, Wanted
from fiberloom.planning import Plan, Trajectory, verify_supply
from fiberloom.typing import Floats

NEAR_DEG = 0.15
"""So far from where it was expected, a positioner is at rest there: the cogging pulls a rotor by 0.09 deg."""
BLEND_S = 1.0
"""Within which a trajectory goes over from the true start to what was planned."""
AHEAD = "ahead"


@dataclass
class PlannedAhead:
    """A plan of N positioners, made before its time."""

    plan: Plan
    here_deg: Floats
    """(N, 2) from where."""
    goal_deg: Floats
    """(N, 2) to where."""
    told: str = ""
    """What became of it: `AHEAD`, or why it was planned anew; empty: it was not asked for."""

    async def programme(self, drive: Drive, wanted: Wanted) -> Programme | None:
        """What `drive` is to be told for the `wanted` move; None: plan it anew, `told` says why."""
        self.told = self._differs(wanted)
        if self.told:
            return None
        begun = self.from_start(wanted.here_deg)
        fed = verify_supply(wanted.obstacles, begun)
        if not fed.ok:
            self.told = f"more than the supply gives from the true start: {fed}"
            return None
        made = await drive.compile(begun)
        found = await asyncio.to_thread(drive.verify, wanted.obstacles, made)
        self.told = AHEAD if found.ok else f"not proven from the true start: {found}"
        return made if found.ok else None

    def _differs(self, wanted: Wanted) -> str:
        """What is not as it was expected; empty: nothing that matters."""
        ids = wanted.obstacles.positioner_id
        if self.plan.collision_buffer_mm != wanted.obstacles.collision_buffer_mm:
            return "the collision buffer is another one"
        off_deg = np.abs(wanted.here_deg - self.here_deg).max(axis=1)
        row = int(off_deg.argmax())
        if off_deg[row] > NEAR_DEG:
            return f"positioner {ids[row]} is {off_deg[row]:.2f} deg from where it was expected"
        dead = wanted.obstacles.offline & [robot.moves for robot in self.plan.robots]
        if dead.any():  # also one that stands at its goal already: the plan takes up its backlash
            return f"positioner {ids[dead][0]} cannot be moved any more"
        # one that does not follow any more has its own place for its goal
        other = np.abs(wanted.goal_deg - self.goal_deg).max(axis=1) > NEAR_DEG
        return f"positioner {ids[other][0]} has another goal" if other.any() else ""

    def from_start(self, here_deg: Floats) -> Plan:
        """The plan with trajectories that begin where positioners are: `here_deg` (N, 2)."""
        robots = zip(self.plan.robots, here_deg, strict=True)
        return replace(self.plan, robots=tuple(_from(robot, here) for robot, here in robots))


def _from(robot: Trajectory, here_deg: Floats) -> Trajectory:
    """A trajectory that begins at `here_deg` (2,) and is as planned from BLEND_S on."""
    if not robot.moves:
        return replace(robot, alpha_deg=here_deg[:1].copy(), beta_deg=here_deg[1:].copy())
    left = np.clip(1.0 - robot.time_s / min(BLEND_S, robot.time_s[-1]), 0.0, 1.0)
    alpha_deg = robot.alpha_deg + left * (here_deg[0] - robot.alpha_deg[0])
    return replace(
        robot, alpha_deg=alpha_deg, beta_deg=robot.beta_deg + left * (here_deg[1] - robot.beta_deg[0])
    )
