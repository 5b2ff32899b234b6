"""The drive of DESI: plans become tables of rows, and what no encoder tells is learnt from images."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fiberloom.bus.motion import MotionWatch
from fiberloom.bus.outcome import Outcome, Result, Results
from fiberloom.bus.transport import Transport
from fiberloom.drive.desi.clock import TICK_HZ, degrees_of
from fiberloom.drive.desi.frames import (
    POSITIONERS,
    DesiCommand,
    DesiFrame,
    checksum,
    encode_row,
    rows_of,
    table_frames,
)
from fiberloom.drive.desi.homing import HOMED_SIGMA_DEG, homed_deg, homing_tables
from fiberloom.drive.desi.maps.kept import save_maps
from fiberloom.drive.desi.maps.learned import LearnedMaps
from fiberloom.drive.desi.paths import executed_path
from fiberloom.drive.desi.resolve import Resolver, counted_deg, proven
from fiberloom.drive.desi.safe import safe_phi_deg
from fiberloom.drive.desi.stages import Aims, Staged, staged
from fiberloom.drive.desi.standing import StandingPlaces
from fiberloom.drive.desi.tables import MoveTables
from fiberloom.drive.port import (
    BelievedPlaces,
    DriveModel,
    Programme,
    Suspect,
    UnitSays,
    Wanted,
    none_answers,
    with_tube,
)
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Measurement
from fiberloom.planning import Plan, Verification
from fiberloom.typing import Flags, Floats, Ints

TUBE_SIGMA = 1.5
"""[A] An arm may be so many of its map's sigma from its way: a 2-D rms, 0.1 mm before anything is learnt."""
ANSWER_S = 0.5
TRIES = 3
"""Of a question, and to load a table."""
SURPRISES = 2
"""[A] One may be a turn that was lost once."""
SETTLE_S = 0.05
"""After the last table has ended."""
ALIVE_S = 20.0
"""A unit that has heard nothing for 60 s is in standby, and runs nothing until it is reset."""
AIR_UM = 6.0
"""[A] Of one image, both axes together, where nothing tells how far it is off."""


@dataclass(frozen=True, eq=False)
class Tables:
    """The commands of a programme."""

    tables: MoveTables
    way_deg: Floats
    """(N, 2) counted by them."""
    loose: Plan
    """The way that arms go by them whose gears have all the play that they may have."""


class DesiDrive:
    """Positioners of DESI on a bus. Implements `fiberloom.drive.Drive`.

    No positioner reports where it is. What was commanded is added up, a learnt map turns it into angles of
    the arm, and every image teaches the map.
    """

    def __init__(
        self,
        plane: FocalPlane,
        transport: Transport,
        maps: LearnedMaps | None = None,
    ) -> None:
        """`plane`: N positioners; `transport` of their frames; `maps` as learnt so far: when left out
        nothing, and all are taken to be folded.
        """
        self.plane, self.transport = plane, transport
        self.maps = maps or LearnedMaps(plane, plane.park_deg)
        self.model = DriveModel.of(plane, seen_is_believed=True, reports=False)
        self.standing = StandingPlaces(self.maps)
        self.ids: list[int] = []
        self.kept: Path | None = None
        """File to which what was learnt is written after each image; None: it is not kept."""
        self.safe_deg = safe_phi_deg(plane)
        self._image_um = max(self.model.noise.camera_um, 1e-3)
        self._back = np.zeros(len(plane), dtype=bool)
        """(N,) that were silent and answer again, and that no image has shown since."""
        self._spoke_s = -np.inf
        """When the last frame went out, s of the bus."""
        self._ran = False
        self._running: tuple[float, MoveTables] | None = None

    @property
    def time_s(self) -> float:
        """Of the bus."""
        return self.transport.time_s

    # the bus

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass, s; what units say meanwhile is dropped."""
        end_s = self.time_s + duration_s
        while (left_s := end_s - self.time_s) > 1e-9:
            await self.transport.receive(min(left_s, ALIVE_S))
            if left_s > ALIVE_S:
                await self._broadcast(DesiCommand.STAY_ALIVE)

    async def _broadcast(self, command: DesiCommand, data: bytes = b"") -> None:
        await self._send([DesiFrame.of(POSITIONERS, command, data)])

    async def _send(self, frames: list[DesiFrame]) -> None:
        await self.transport.send(frames)
        self._spoke_s = self.time_s

    async def _ask(
        self, frames: list[DesiFrame], command: DesiCommand, whom: Iterable[int]
    ) -> dict[int, bytes]:
        """Sends frames; the answers to a command by positioner, of those that answer in time."""
        waiting, found = set(whom), {}
        await self._send(frames)
        end_s = self.time_s + ANSWER_S
        while waiting and (left_s := end_s - self.time_s) > 1e-9:
            for reply in await self.transport.receive(left_s):
                sender = reply.id >> 8
                if reply.id & 0xFF == command and sender in waiting:
                    waiting.discard(sender)
                    found[sender] = reply.data
        return found

    async def connect(self) -> None:
        """Asks all for their firmware. InputError where none of the layout's positioners answers."""
        known = self.plane.positioner_id[~self.plane.offline].tolist()
        self.ids = sorted(await self._told(DesiCommand.VERSION, known))
        if not self.ids:
            raise none_answers(self.plane)

    async def look(self) -> dict[int, UnitSays]:
        """Which of the layout answer, by number, and whether they move; where they are none can say."""
        here = await self._told(DesiCommand.VERSION, self.plane.positioner_id[~self.plane.offline].tolist())
        moving = set(_still_moving(await self._told(DesiCommand.MOVE_STATUS, here)))
        return {number: UnitSays(None, number in moving) for number in here}

    async def _told(self, command: DesiCommand, whom: Iterable[int]) -> dict[int, bytes]:
        """What these answer to a question; one that does not is asked again, `TRIES` times in all."""
        found: dict[int, bytes] = {}
        left = set(whom)
        for _ in range(TRIES):
            found |= await self._ask([DesiFrame.of(k, command) for k in sorted(left)], command, left)
            left -= set(found)
            if not left:
                break
        return found

    def _lose(self, silent: Iterable[int]) -> None:
        self.ids = sorted(set(self.ids) - set(silent))

    async def rest(self, alarm: Callable[[str], None], left_moving: bool = False) -> None:
        """Stops what a host that was killed has left on its way; `alarm` and `left_moving` as in the port."""
        told = await self._told(DesiCommand.MOVE_STATUS, self.ids)
        moving = _still_moving(told)
        if moving or left_moving:
            await self._broadcast(DesiCommand.STOP)
            alarm(f"{len(moving)} positioners were still moving at the begin; all are stopped")

    async def believed(self, ids: Ints) -> BelievedPlaces:
        """Where these (n,) are by what was counted and learnt; known of those that answer on the bus."""
        rows = self.plane.index_of(ids)
        angles = self.maps.output_deg(self.maps.believed_deg)[rows]
        return BelievedPlaces(angles, self.maps.believed_deg[rows], np.isin(ids, self.ids))

    async def heard_again(self, silent: Iterable[int]) -> list[int]:
        """Those of the `silent` that answer now. Where they stand the next image tells the map."""
        back = sorted(await self._told(DesiCommand.VERSION, silent))
        self.ids = sorted({*self.ids, *back})
        self._back[self.plane.index_of(back)] = True
        return back

    # programmes

    async def prepare(self, wanted: Wanted) -> Programme:
        """Tables in stages, of ways by what was learnt; who cannot make its move is named in the plan."""
        return await asyncio.to_thread(self._prepared, wanted)

    def _prepared(self, wanted: Wanted) -> Programme:
        begun_s, tube_mm = time.thread_time(), self._tube_mm(wanted.goal_deg)
        plane = with_tube(wanted.obstacles, tube_mm)
        asked = np.abs(wanted.goal_deg - wanted.here_deg).max(axis=1) > 1e-9
        asked &= ~plane.offline
        way = np.where(asked[:, None], self.maps.way_deg(wanted.goal_deg), 0.0)
        move = staged(plane, wanted.here_deg, way, self.safe_deg, small=wanted.small)

        def ends(reduced: Staged) -> Aims:
            counted = counted_deg(reduced)
            there = self.maps.output_deg(self.maps.believed_deg + counted)
            off = there - wanted.here_deg - counted
            return Aims(wanted.here_deg, np.where(reduced.moves[:, None], off, 0.0))

        found = Resolver(plane, move, ends).resolve()
        way = degrees_of(found.made.tables.way_tenths.sum(axis=1))
        commands = Tables(found.made.tables, way, found.loose)
        about = {"rounds": found.rounds, "waits": found.waits}
        return Programme(found.plan, tube_mm, commands, about).timed(begun_s)

    def arrived(self, goal_deg: Floats, last: bool = False) -> Flags:
        """(N,) surely within the requirement of goals (N, 2) in deg; another move draws another scatter."""
        goal_mm = self.plane.forward(*goal_deg.T)
        requirement_um = self.plane.instrument.operation.requirement_um
        rests = self.standing.arrived(goal_mm, requirement_um)
        return rests | self.standing.best_kept(goal_mm, requirement_um) if last else rests

    def _tube_mm(self, angles_deg: Floats) -> Floats:
        """(N,) mm, by how well the map is known at angles (N, 2) in deg."""
        return 1e-3 * TUBE_SIGMA * self.maps.sigma_um(angles_deg)

    async def compile(self, plan: Plan) -> Programme:
        """Only where nothing moves: InputError for a `plan` of trajectories, which no table can follow."""
        if any(robot.moves for robot in plan.robots):
            raise InputError(
                f"{self.plane.instrument.name}: its motors run tables, not trajectories made elsewhere"
            )
        still = np.zeros((len(self.plane), 0, 2), dtype=np.int64)
        tables = MoveTables(still, still.astype(bool), np.zeros((len(self.plane), 0), dtype=np.int64))
        return Programme(plan, None, Tables(tables, np.zeros((len(self.plane), 2)), plan))

    def verify(self, obstacles: FocalPlane, programme: Programme) -> Verification:
        """Proves the way that tables make arms go, with tubes; `obstacles`, `programme` as in the port."""
        plans = programme.plan, programme.commands.loose
        return proven(with_tube(obstacles, programme.tube_mm), plans)

    async def run(self, programme: Programme, watch: MotionWatch, say: Callable[[str], None]) -> Results:
        """Loads tables, proves their checksums, starts all at once and waits. `watch` and `say`: not used.

        Nothing starts where one unit does not hold its table: the way was proven for all together. One that
        answers and does not hold it has refused.
        """
        commands: Tables = programme.commands
        results = await self._run(commands.tables, programme.moving)
        if self._ran:
            self._went(commands.way_deg)
        return results

    def _went(self, way_deg: Floats) -> None:
        """A way (N, 2) in deg was made."""
        self.maps.went(way_deg)
        self.standing.went((way_deg != 0.0).any(axis=1))

    async def _run(self, tables: MoveTables, moving: list[int]) -> Results:
        """Loads, starts and waits for the end; `_ran` says whether anything was started."""
        self._ran = False
        missing = await self._load(tables, moving)
        if missing:
            heard = await self._told(DesiCommand.VERSION, missing)
            self._lose(missing - set(heard))
            why = {i: Outcome.REFUSED if i in heard else Outcome.TIMED_OUT for i in missing}
            return Results({i: Result(i, why.get(i, Outcome.STOPPED)) for i in moving})
        await self._broadcast(DesiCommand.RUN, b"\x01")
        self._ran, self._running = True, (self.time_s, tables)
        await self.sleep(float(tables.duration_s.max(initial=0.0)) + SETTLE_S)
        told = await self._told(DesiCommand.MOVE_STATUS, moving)
        late = {*_still_moving(told), *set(moving) - set(told)}
        self._lose(set(moving) - set(told))
        self._running = None
        return Results({i: Result(i, Outcome.TIMED_OUT if i in late else Outcome.DONE) for i in moving})

    async def _load(self, tables: MoveTables, moving: list[int]) -> set[int]:
        """Those that do not hold their table after `TRIES`."""
        rows = {i: rows_of(tables, int(self.plane.index_of(i))) for i in moving}
        if self.time_s - self._spoke_s > ALIVE_S:  # planning may take longer than units wait
            await self._broadcast(DesiCommand.RESET)
        # a table that was run is still there, and the start is for all
        await self._broadcast(DesiCommand.CLEAR)
        missing = set(moving)
        for _ in range(TRIES):
            frames = [frame for i in sorted(missing) for frame in table_frames(i, rows[i])]
            told = await self._ask(frames, DesiCommand.CHECKSUM, missing)
            missing -= {
                i
                for i, data in told.items()
                if int.from_bytes(data, "big") == checksum([encode_row(row) for row in rows[i]])
            }
            if not missing:
                break
        return missing

    async def home(self, ids: Iterable[int]) -> Results:
        """Searches both stops of these by creep, some minutes; who ends well is believed to be there.

        Nothing says where their arms are on the way: the caller sees to it that none is in their reach.
        """
        rows = np.sort(self.plane.index_of(list(ids)))
        tables, numbers = homing_tables(self.plane, rows), self.plane.positioner_id[rows].tolist()
        results = await self._run(tables, numbers)
        done = rows[[results[k].ok for k in numbers]]
        self.maps.homed(done, homed_deg(self.plane, done), HOMED_SIGMA_DEG)
        self.standing.fresh[rows] = True
        return results

    async def settle(self, ids: list[int]) -> None:
        """Stops these and forgets their tables."""
        frames = [DesiFrame.of(i, command) for i in ids for command in (DesiCommand.STOP, DesiCommand.CLEAR)]
        await self._send(frames)

    async def stop(self) -> list[int]:
        """Stops all; what was counted until then is believed. Returns which answer."""
        await self._broadcast(DesiCommand.STOP)
        if self._running is not None:
            begin_s, tables = self._running
            gone = executed_path(tables).at(np.array([(self.time_s - begin_s) * TICK_HZ]))[:, 0]
            self._went(degrees_of(gone))
            self._running = None
        return sorted(await self._told(DesiCommand.VERSION, self.ids))

    def excused(self, image: Measurement) -> None:
        """None: a fibre that an `image` does not show is dark."""

    def seen(self, image: Measurement, mobile: Flags) -> Floats:
        """Learns from an image; (N, 2) deg where arms are believed to be now. `mobile` (N,): who may tell."""
        told, sigma_mm = image.seen & mobile, self._sigma_mm(image)
        moved = self.standing.fresh.copy()
        self.standing.see(image.xy_mm, sigma_mm, told)
        # one that rests shows the scatter of the same move again, which is nothing new of its map
        self.maps.see(image.xy_mm, sigma_mm, told & moved)
        self.maps.stands(image.xy_mm, image.seen & self._back)
        self._back &= ~image.seen
        if self.kept is not None:
            save_maps(self.maps, self.kept)
        return self.maps.output_deg(self.maps.believed_deg)

    def suspects(self) -> dict[int, Suspect]:
        """Those that an image has shown `SURPRISES` times where no map can have them: degraded motors."""
        why = "seen {} times where its map cannot have it: a motor that slips, or loses turns"
        times = self.maps.surprises
        return {
            int(self.plane.positioner_id[row]): Suspect(True, why.format(times[row]))
            for row in np.flatnonzero(times >= SURPRISES)
        }

    def _sigma_mm(self, image: Measurement) -> Floats | float:
        """(N,) mm per coordinate: as the camera tells it, else as several images of a place scatter."""
        told = image.noise_mm2 if image.covariance_mm2 is None else image.covariance_mm2
        if told is None:
            return float(1e-3 * np.hypot(self._image_um, AIR_UM) / np.sqrt(2.0))
        mean = 0.5 * np.einsum("ncc->n", np.nan_to_num(told, nan=1.0))
        return np.asarray(np.sqrt(np.maximum(mean, 1e-8)))

    async def close(self) -> None:
        """Closes the bus."""
        await self.transport.close()


def _still_moving(told: dict[int, bytes]) -> list[int]:
    """Those whose answer to the question for their move is not 0."""
    return [number for number, data in told.items() if data != b"\x00"]
