"""The drive of SDSS-V: a plan becomes trajectories of motor angles by the transmission maps."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence

from fiberloom.bus.client import Client
from fiberloom.bus.motion import RECONNECT_S, MotionWatch
from fiberloom.bus.outcome import Results
from fiberloom.bus.trajectory import WireTrajectory
from fiberloom.bus.transport import Transport
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.drive.port import (
    BelievedPlaces,
    DriveModel,
    Programme,
    Suspect,
    Wanted,
    none_answers,
    verified,
)
from fiberloom.drive.sdssv.care import MotorCare
from fiberloom.drive.sdssv.rest import REST_TIMEOUT_S, AtRest
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Measurement
from fiberloom.planning import Plan, Trajectory, Verification, plan, plan_corrections
from fiberloom.planning.trajectories import corners_of
from fiberloom.timing import part
from fiberloom.typing import Flags, Floats, Ints


class SdssvDrive:
    """Positioners of SDSS-V's protocol on a bus. Implements `fiberloom.drive.Drive`."""

    def __init__(self, plane: FocalPlane, maps: TransmissionMaps, transport: Transport) -> None:
        """`plane`: layout of N positioners; `maps`: their transmission maps; `transport`: carries frames."""
        self.plane, self.maps = plane, maps
        self.client = Client(transport)
        self.care = MotorCare(plane, self.client)
        alpha_deg, beta_deg = [axis.smallest_step_deg for axis in plane.instrument.axes]
        self.model = DriveModel.of(plane, step_deg=(alpha_deg, beta_deg))

    @property
    def ids(self) -> list[int]:
        """Positioners that have answered."""
        return self.client.ids

    @property
    def time_s(self) -> float:
        """Of the bus."""
        return self.client.time_s

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass on the bus, s."""
        await self.client.sleep(duration_s)

    async def connect(self) -> None:
        """Asks all who they are. InputError where none of the layout's positioners answers."""
        if not set(await self.client.discover()) & set(self.plane.positioner_id.tolist()):
            raise none_answers(self.plane)

    async def rest(self, alarm: Callable[[str], None], left_moving: bool = False) -> None:
        """Stops what a host that was killed has left on its way; `alarm` and `left_moving` as in the port."""
        known = self.plane.positioner_id[~self.plane.offline].tolist()
        await AtRest(self.client, known, alarm).reach(left_moving)

    async def believed(self, ids: Ints) -> BelievedPlaces:
        """Where these (n,) report to be, by their maps."""
        wire_deg, answered = await self.client.positions_deg(ids)
        angles_deg = wire_deg.copy()
        rows = self.plane.index_of(ids[answered])
        angles_deg[answered] = self.maps.to_output(wire_deg[answered], index=rows)
        return BelievedPlaces(angles_deg, wire_deg, answered)

    async def heard_again(self, silent: Iterable[int]) -> list[int]:
        """Those of the `silent` that answer now; a stop has to reach them from now on."""
        back = (await self.client.poll(silent)).ok_ids
        self.client.ids = sorted({*self.client.ids, *back})
        return back

    async def prepare(self, wanted: Wanted) -> Programme:
        """A plan at the speed that temperature and supply allow, as trajectories."""
        made = await self.care.planned(
            plan_corrections if wanted.small else plan,
            wanted.obstacles,
            wanted.here_deg,
            wanted.goal_deg,
            seed=wanted.seed,
            approach_deg=wanted.approach_deg,
        )
        return await self.compile(made)

    async def compile(self, plan: Plan) -> Programme:
        """The trajectories of a `plan` that was made elsewhere."""
        return Programme(plan, commands=await asyncio.to_thread(self._all_on_the_wire, plan))

    def verify(self, obstacles: FocalPlane, programme: Programme) -> Verification:
        """The plan's own proof: positioners follow it. `obstacles` and `programme` as in the port."""
        return verified(obstacles, programme)

    async def run(self, programme: Programme, watch: MotionWatch, say: Callable[[str], None]) -> Results:
        """Sends trajectories, starts them and waits for their end; `watch` and `say` as in the port."""
        trajectories: dict[int, WireTrajectory] = programme.commands
        await self.care.begin(list(trajectories), say)
        await when_linked(self.client, trajectories)
        return await self.client.run_trajectories(trajectories, watch=watch)

    def arrived(self, goal_deg: Floats, last: bool = False) -> Flags | None:
        """None: the last image alone is what tells. `goal_deg` (N, 2) and `last`: not used."""
        return None

    async def settle(self, ids: list[int]) -> None:
        """Stops all and clears the flags of collisions, so that healthy positioners can move again."""
        await self.client.stop()
        await self.client.wait_until_done(ids, timeout_s=REST_TIMEOUT_S, stop_on_collision=False)

    async def stop(self) -> list[int]:
        """Brings every positioner to rest that can be reached; returns which have answered."""
        stopped = await self.client.stop_all()
        await self.client.wait_until_done(stopped.ok_ids, REST_TIMEOUT_S, stop_on_collision=False)
        return stopped.ok_ids

    def excused(self, image: Measurement) -> None:
        """None: a fibre that an `image` does not show is dark."""

    def seen(self, image: Measurement, mobile: Flags) -> None:
        """Nothing is learnt: positioners report where they are, `image` and `mobile` do not change that."""

    def suspects(self) -> dict[int, Suspect]:
        """None: the judgement after a move finds them."""
        return {}

    async def close(self) -> None:
        """Closes the bus; one that the caller has opened stays open."""
        await self.client.close()

    @part("maps")
    def _all_on_the_wire(self, planned: Plan) -> dict[int, WireTrajectory]:
        moving = [robot for robot in planned.robots if robot.moves]
        rows = self.plane.index_of([robot.positioner_id for robot in moving]).tolist()
        wire_deg = self.maps.paths_to_wire(rows, [robot.points_deg for robot in moving])
        return dict(
            zip([robot.positioner_id for robot in moving], _at_corners(moving, wire_deg), strict=True)
        )


def on_the_wire(maps: TransmissionMaps, row: int, robot: Trajectory) -> WireTrajectory:
    """What is sent of the way of the positioner in `row`: motor angles by `maps`, at the corners."""
    return _at_corners([robot], [maps.path_to_wire(row, robot.points_deg)])[0]


def _at_corners(robots: Sequence[Trajectory], wire_deg: Sequence[Floats]) -> list[WireTrajectory]:
    """Of `wire_deg` (M, 2) of each, the motor angles at all its points, those that its axes need."""
    return WireTrajectory.all_from_deg([robot.time_s for robot in robots], wire_deg, corners_of(robots))


async def when_linked(client: Client, ids: Iterable[int], within_s: float = RECONNECT_S) -> bool:
    """Waits until every link to these positioners is up, at most `within_s`; returns whether they are."""
    asked = list(ids)

    def linked() -> bool:
        return not client.exchange.cut_off(asked)

    return linked() or await client.exchange.wait(linked, client.time_s + within_s)
