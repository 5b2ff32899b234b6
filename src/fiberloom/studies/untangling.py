"""A real collision on the twin, and the way out of it: contact, stop, `untangle`, executed by the firmware.

The twin begins deployed. One positioner (two for a knot) is sent on without regard to the others until its
firmware reports the collision. What is known afterwards is what is read over the bus, wrong by as much as
asked for. The stages of `untangle` are carried out one by one. After a stage that did not end well, the
flags are cleared, positions are read again, and the rest is planned anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.bus.outcome import Outcome
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.drive.sdssv import on_the_wire
from fiberloom.instruments import FocalPlane
from fiberloom.planning import Stage, Trajectory, Untangled, random_configuration, untangle
from fiberloom.planning.crashes import Crash, random_crash
from fiberloom.twin.draw import draw_units
from fiberloom.twin.transport import TwinTransport
from fiberloom.twin.twin import Touch, Twin
from fiberloom.typing import Floats

ROUNDS = 5
"""How often is planned anew."""
_DRIVE_DEG_S = 6.0
_BEYOND_DEG = 12.0
"""How much farther than the contact a culprit is sent."""
_UNTIL_STOPPED_S = 1.0


@dataclass(frozen=True)
class TwinUntangling:
    """What came of one collision."""

    touches: tuple[Touch, ...]
    """Contacts of the collision itself."""
    found: tuple[Untangled, ...]
    """What was planned: the last entry went through to its end."""
    new_touches: tuple[Touch, ...]
    """Contacts that began while the way out was carried out."""
    collisions: int
    """Stages that the firmware ended by its collision watch."""
    free: bool
    """All stages were carried out, and nothing overlaps."""
    at_goal: int
    """Positioners folded at the end, by the twin's own truth."""
    positioners: int


async def collide_and_untangle(
    plane: FocalPlane, maps: TransmissionMaps, seed: int, kind: str = "two arms", off_deg: float = 0.1
) -> TwinUntangling:
    """One collision on the twin and the way out of it.

    Parameters
    ----------
    plane : FocalPlane
        N positioners.
    maps : TransmissionMaps
        Of the twin's units of seed 0.
    seed : int
        Of field, culprit, noise and planner.
    kind : str
        As for `random_crash`; "buffer" ends without a contact.
    off_deg : float
        The culprits' positions are declared wrong by up to this on each axis.
    """
    trial = _UntanglingTrial(plane, maps, seed)
    await trial.client.discover()
    await trial.collide(random_crash(plane, seed, kind), off_deg)
    return await trial.untangle()


class _UntanglingTrial:
    def __init__(self, plane: FocalPlane, maps: TransmissionMaps, seed: int) -> None:
        self.plane, self.maps, self.seed = plane, maps, seed
        deployed = random_configuration(plane, seed)  # in which `random_crash` drives a positioner
        self.twin = Twin(plane, draw_units(plane, 0), seed=seed, start_deg=deployed)
        self.client = Client(TwinTransport(self.twin))
        self.touches: list[Touch] = []
        self.collisions = 0

    async def collide(self, crash: Crash, off_deg: float) -> None:
        """Sends the culprits the way that `crash` found, and farther; stops, and declares where they are."""
        rng = np.random.default_rng([self.seed, 0x0FF])
        for row in crash.culprits:
            here = (await self._read())[row]
            way = crash.start_deg[row] - here
            goal = crash.start_deg[row] + _BEYOND_DEG * way / np.abs(way).max()
            low, high = self.plane.hard_stops_deg.T + np.array([[1.0], [-1.0]])
            await self._drive(row, here, np.clip(goal, low, high))
            number = [int(self.plane.positioner_id[row])]
            wire_deg, _ = await self.client.positions_deg(number)
            await self.client.set_position(number, *(wire_deg[0] + rng.uniform(-off_deg, off_deg, 2)))
        if crash.plane.offline.any():
            rows = np.flatnonzero(crash.plane.offline)
            self.plane = self.plane.with_offline(self.plane.positioner_id[rows], (await self._read())[rows])
        self.touches = self.twin.touches()

    async def _drive(self, row: int, here_deg: Floats, goal_deg: Floats) -> None:
        """Straight on, with no regard to others, until the end or a collision."""
        way_deg = np.abs(goal_deg - here_deg).max()
        robot = Trajectory(
            int(self.plane.positioner_id[row]),
            np.array([0.0, 0.1 + way_deg / _DRIVE_DEG_S]),
            *np.column_stack([here_deg, goal_deg]),
        )
        await self._send([robot])
        await self.client.sleep(_UNTIL_STOPPED_S)
        await self.client.stop()

    async def untangle(self) -> TwinUntangling:
        """Plans and executes until all is carried out, at most `ROUNDS` times."""
        found: list[Untangled] = []
        done = False
        while not done and len(found) < ROUNDS:
            found.append(untangle(self.plane, await self._read(), seed=self.seed + len(found)))
            done = await self._carry_out(found[-1])
        off_deg = np.abs(self.twin.truth() - self.plane.park_deg).max(axis=1)
        return TwinUntangling(
            touches=tuple(self.touches),
            found=tuple(found),
            new_touches=tuple(self.twin.touches()),
            collisions=self.collisions,
            free=done and found[-1].free,
            at_goal=int((off_deg < 1.0).sum()),
            positioners=self.plane.n,
        )

    async def _carry_out(self, found: Untangled) -> bool:
        for stage in found.stages:
            if not await self._stage(stage):
                await self.client.stop()
                await self.client.sleep(_UNTIL_STOPPED_S)
                return False
        return True

    async def _stage(self, stage: Stage) -> bool:
        """True if all went as planned."""
        robots = [robot for robot in stage.plan.robots if robot.moves]
        ids = [robot.positioner_id for robot in robots]
        # the firmware's own approach would go back to where a retreat came from; plans have theirs
        await self.client.set_precise_moves(ids, on=False)
        return await self._send(robots)

    async def _send(self, robots: list[Trajectory]) -> bool:
        rows = self.plane.index_of([r.positioner_id for r in robots]).tolist()
        ways = {r.positioner_id: on_the_wire(self.maps, k, r) for k, r in zip(rows, robots, strict=True)}
        results = await self.client.run_trajectories(ways)
        self.collisions += sum(r.outcome is Outcome.COLLIDED for r in results.values())
        return bool(results.ok.all())

    async def _read(self) -> Floats:
        """(N, 2) deg by what the positioners say."""
        wire_deg, _ = await self.client.positions_deg(self.plane.positioner_id)
        return self.maps.to_output(wire_deg)
