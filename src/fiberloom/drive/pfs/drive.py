"""The drive of PFS: an iteration of stages becomes one RUN of the FPGA; an image tells where cobras are."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from fiberloom.bus.motion import MotionWatch
from fiberloom.bus.outcome import Outcome, Result, Results
from fiberloom.drive.pfs.client import Ended, FpgaClient, Orders
from fiberloom.drive.piezo.air import air_mm
from fiberloom.drive.piezo.cobras import CobraArms, stops_deg
from fiberloom.drive.piezo.learning import LearningLaw, LearningSettings, Order
from fiberloom.drive.piezo.loose import pair_loose
from fiberloom.drive.piezo.maps import PULSE_CURVE_US, REVERSE, MotorMaps
from fiberloom.drive.piezo.stages import PHI, THETA, Chosen, CobraStage, Stages, StageSettings
from fiberloom.drive.piezo.tracking import Tracker
from fiberloom.drive.port import BelievedPlaces, DriveModel, Programme, Suspect, Wanted, none_answers
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Measurement
from fiberloom.planning import Plan, Trajectory, Verification
from fiberloom.planning.verification import Violation
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import UM_PER_MM

MOST_STEPS = 4000.0
"""Of a motor in one iteration (ics_fpsActor)."""
HOME_STEPS = (10_000, 5_000)
"""Theta, phi: into the stops from anywhere (cobraCharmer)."""
HOME_ROUNDS, HOME_WAYS = 3, 1.5
"""[A] So often, and by the map so many ranges at least: motors are slower than that, and scatter."""
TOLD_MM, STILL_MM, STILL_MOVES = 0.3, 0.02, 2
"""[A] One that was told to move its fibre by so much and moved it by less than that, so often, is stuck."""
HOME_SIGMA_DEG = 0.2
"""[A] How well a stop is known."""
LONGEST_RUN_S = 30.0
"""A RUN that an earlier host has begun has ended after so long."""
ASTRAY_MM = 20.0
"""Farther than any reach: one that went another way than it was told to is no fault, the next image tells."""
OUTCOMES = {
    Ended.DONE: Outcome.DONE,
    Ended.REFUSED: Outcome.REFUSED,
    Ended.TIMED_OUT: Outcome.STOPPED,
    Ended.UNPOWERED: Outcome.DISCONNECTED,
    Ended.UNKNOWN: Outcome.STOPPED,
}


@dataclass(frozen=True)
class CobraSettings:
    """How cobras are moved."""

    stages: StageSettings = field(default_factory=StageSettings)
    motors: LearningSettings = field(default_factory=lambda: LearningSettings(most_steps=MOST_STEPS))
    rest_share: float = 0.5
    """[A] Of the requirement: one that is believed to be so near stays: a move brings it no nearer."""
    stays_share: float = 0.6
    """[A] The same, of one that has stood for an image or more: a motor that is poor at short ways would give
    up a place that does."""


@dataclass(frozen=True, eq=False)
class Iteration:
    """The commands of a programme."""

    chosen: Chosen
    order: Order
    orders: Orders
    rows: Ints
    """(m,) of the focal plane that move."""


class CobraDrive:
    """Cobras behind an FPGA. Implements `fiberloom.drive.Drive`.

    They report nothing: where they are is added up from what they were told, and put right by every image.
    """

    def __init__(
        self,
        plane: FocalPlane,
        maps: MotorMaps,
        client: FpgaClient,
        dots_mm: Floats | None = None,
        settings: CobraSettings | None = None,
    ) -> None:
        """`plane`: layout of N cobras; `maps` of their 2 N motors; `client` of the FPGA.

        `dots_mm` (N, 3): x, y, radius of the dot of each, None: there are none; `settings`.
        """
        self.plane, self.client = plane, client
        self.settings = settings or CobraSettings()
        self.arms = CobraArms.of(plane)
        curve_us = np.tile(PULSE_CURVE_US, len(plane))
        self.law = LearningLaw(maps, curve_us, self.settings.motors)
        self.law.range_deg = self.arms.range_deg.ravel()
        self.tracker = Tracker(self.arms, self.law, dots_mm)
        self.stages = Stages.of(self.arms, plane.fiducials, self.settings.stages, dots_mm)
        self.model = DriveModel.of(plane, astray_mm=ASTRAY_MM, seen_is_believed=True, reports=False)
        self._discs_mm = plane.fiducials
        self._answers: list[int] = []
        self._moved, self._stood = np.ones(len(plane), dtype=bool), np.zeros(len(plane), dtype=bool)
        self._still, self._told_mm = np.zeros(len(plane), dtype=np.int64), np.zeros(len(plane))
        self._seen_mm = np.full((len(plane), 2), np.nan)
        self._standing_deg = np.full((len(plane), 2), np.nan)
        """(N, 2) alpha and beta of those that do not move, as told; NaN of the others."""
        self._seed = 0
        self._at_stops = False
        """All have searched their stops, and none was told to move since."""
        self.believe(np.zeros((len(plane), 2)))

    # where they are

    @property
    def ids(self) -> list[int]:
        """Cobras whose board answers."""
        return self._answers

    @property
    def time_s(self) -> float:
        """Of the FPGA's connection."""
        return self.client.time_s

    @property
    def hidden(self) -> Flags:
        """(N,) cobras whose fibre is behind its dot: believed by their steps, not lost."""
        return self.tracker.hidden

    def believe(self, angle_deg: Floats, sigma_deg: float = HOME_SIGMA_DEG) -> None:
        """They are at `angle_deg` (N, 2) from their stops, known to `sigma_deg`, in deg."""
        self.tracker.believe(angle_deg, sigma_deg)
        self._moved = np.ones(len(self.plane), dtype=bool)

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass, s."""
        await self.client.sleep(duration_s)

    async def connect(self) -> None:
        """Asks which boards answer; InputError where there is no FPGA, or none of the cobras' boards does."""
        await self.client.open()
        there = await self.client.powered(self.plane.positioner_id)
        self._answers = self.plane.positioner_id[there].tolist()
        if not self._answers:
            raise none_answers(self.plane)

    async def rest(self, alarm: Callable[[str], None], left_moving: bool = False) -> None:
        """A RUN ends by itself; `alarm` and `left_moving` as in the port."""
        if left_moving:
            alarm(f"cobras may move still: waiting {LONGEST_RUN_S:g} s for the end of the RUN")
            await self.sleep(LONGEST_RUN_S)

    async def believed(self, ids: Ints) -> BelievedPlaces:
        """Where these (n,) are by their steps and the images so far."""
        rows = np.atleast_1d(self.plane.index_of(ids))
        place = self.expected_deg[rows]
        answered = np.isin(ids, self._answers)
        return BelievedPlaces(place + stops_deg(self.plane)[0][rows], place, answered)

    async def heard_again(self, silent: Iterable[int]) -> list[int]:
        """Those of the `silent` whose boards answer now."""
        asked = np.array(sorted(silent), dtype=np.int64)
        back: list[int] = asked[await self.client.powered(asked)].tolist()
        self._answers = sorted({*self._answers, *back})
        return back

    def seen(self, image: Measurement, mobile: Flags) -> Floats:
        """Learns from an `image`; `mobile` (N,): cobras of which it may tell. Returns (N, 2) deg."""
        xy_mm = np.where(image.seen[:, None], image.xy_mm, self._loose_mm(image))
        xy_mm[~mobile & ~image.seen] = np.nan
        self._watch_motors(xy_mm)
        air = air_mm(xy_mm, self.arms.xy_mm(self.expected_deg), ~self._moved & image.seen)
        self.tracker.see(xy_mm - air, self._camera_um(image))
        self._stood, self._moved = ~self._moved, np.zeros(len(self.plane), dtype=bool)
        return self.tracker.place_deg + stops_deg(self.plane)[0]

    def _watch_motors(self, xy_mm: Floats) -> None:
        """Counts moves in a row that did nothing, by fibres at (N, 2) mm, NaN where not seen."""
        moved_mm = np.hypot(*(xy_mm - self._seen_mm).T)
        told = self._told_mm > TOLD_MM
        self._still = np.where(told & (moved_mm < STILL_MM), self._still + 1, self._still)
        self._still[moved_mm > STILL_MM] = 0
        self._seen_mm, self._told_mm = xy_mm, np.zeros(len(self.plane))

    def found_stuck(self) -> Flags:
        """(N,) cobras that have not moved though they were told to, more than once."""
        return self._still >= STILL_MOVES

    def excused(self, image: Measurement) -> Flags:
        """(N,) cobras that an `image` after a move does not show without being lost.

        Their fibre may be behind its dot, or its spot is among those that belong to none for certain.
        """
        found = np.isfinite(self._loose_mm(image)).all(axis=1)
        doubtful = image.ambiguous if image.ambiguous is not None else np.zeros(len(self.plane), dtype=bool)
        return ~image.seen & (found | doubtful | self.tracker.may_hide())

    def _loose_mm(self, image: Measurement) -> Floats:
        """(N, 2) spots that can only be those of cobras that ended far from where they should; else NaN."""
        if image.loose_mm is None:
            return np.full((len(self.plane), 2), np.nan)
        sigma = self.law.innovation_sigma_deg().reshape(-1, 2)
        return pair_loose(self.arms, self.expected_deg, sigma, ~image.seen, image.loose_mm)

    def _camera_um(self, image: Measurement) -> Floats:
        """(N,) um per axis by which an image errs."""
        usual = self.plane.instrument.metrology.noise_rms_um / np.sqrt(2.0)
        noise = image.noise_mm2 if image.noise_mm2 is not None else image.covariance_mm2
        if noise is None:
            return np.full(len(self.plane), usual)
        told = UM_PER_MM * np.sqrt(0.5 * np.trace(noise, axis1=1, axis2=2))
        camera_um: Floats = np.where(np.isfinite(told), np.maximum(told, usual), usual)
        return camera_um

    @property
    def expected_deg(self) -> Floats:
        """(N, 2) angles from the stops in deg where they should be now."""
        return self.law.expected_deg().reshape(-1, 2)

    # moves

    async def prepare(self, wanted: Wanted) -> Programme:
        """The next iteration towards the goals; who would touch another there is refused by name."""
        return await asyncio.to_thread(self._programme, wanted.goal_deg, wanted.here_deg, wanted.obstacles)

    async def compile(self, plan: Plan) -> Programme:
        """One iteration towards the end of a `plan` that was made elsewhere; its way is not gone."""
        here = self.expected_deg + stops_deg(self.plane)[0]
        return await asyncio.to_thread(self._programme, plan.end_deg, here, self.plane)

    def _programme(self, goal_deg: Floats, here_deg: Floats, obstacles: FocalPlane) -> Programme:
        begun_s, low = time.thread_time(), stops_deg(self.plane)[0]
        self._know_standing(obstacles)
        goal = goal_deg - low
        active = np.any(np.abs(goal_deg - here_deg) > 0.0, axis=1) & ~obstacles.offline
        goal = np.where(active[:, None], goal, self.tracker.place_deg)
        self._know_discs(obstacles.fiducials)
        refused = self._refused(goal, active)
        active &= ~np.isin(self.plane.positioner_id, list(refused))
        goal = np.where(active[:, None], goal, self.tracker.place_deg)
        active &= ~self.found_stuck() & ~self._rests(goal, self.settings.rest_share)
        self._seed += 1
        chosen = self.stages.choose(self.law, goal, active, self._seed)
        goes = chosen.stage != CobraStage.STAY
        order = self.law.order(chosen.target_deg.ravel(), np.repeat(goes, 2))
        iteration = self._iteration(chosen, order, goes)
        stages = np.bincount(chosen.stage, minlength=len(CobraStage)).tolist()
        about = {"stages": dict(zip([s.name.lower() for s in CobraStage], stages, strict=True))}
        made = Programme(self._plan(iteration, refused), self._tube_mm(chosen), iteration, about)
        return made.timed(begun_s)

    def _rests(self, goal: Floats, share: float | Floats) -> Flags:
        """(N,) cobras believed to be within a `share` of the requirement of their goals (N, 2) in deg."""
        off_um = UM_PER_MM * np.hypot(*(self.arms.xy_mm(goal) - self.arms.xy_mm(self.tracker.place_deg)).T)
        limit_um = share * self.plane.instrument.operation.requirement_um
        rests: Flags = off_um < limit_um
        return rests

    def _know_discs(self, discs_mm: Floats) -> None:
        """Discs stand for fiducials, and for cobras that may be anywhere within their reach."""
        if not np.array_equal(discs_mm, self._discs_mm):
            self._discs_mm = discs_mm
            self.stages = Stages.of(self.arms, discs_mm, self.settings.stages, self.tracker.dots_mm)

    def _know_standing(self, obstacles: FocalPlane) -> None:
        """Cobras that do not move are where the field has them, by an image before its first move.

        What was told once is not told again: images of moves have said more since.
        """
        told_deg = np.where(obstacles.offline[:, None], obstacles.offline_position_deg, np.nan)
        news = obstacles.offline & ~np.isclose(told_deg, self._standing_deg, rtol=0.0).all(axis=1)
        self._standing_deg = told_deg
        place = np.clip(told_deg - stops_deg(self.plane)[0], 0.0, self.arms.range_deg)
        news &= (np.abs(place - self.tracker.place_deg) > HOME_SIGMA_DEG).any(axis=1)
        self.tracker.stand(news, place, HOME_SIGMA_DEG)

    def _refused(self, goal: Floats, active: Flags) -> dict[int, str]:
        """Cobras that would touch another at their goals, one of each two: the reason by number."""
        refused: dict[int, str] = {}
        ids, n = self.plane.positioner_id, len(self.plane)
        for i, j in self.stages.touching(goal).tolist():
            other = f"cobra {ids[j]}" if j < n else "a fiducial"
            if j < n and active[j] and int(ids[i]) not in refused:
                refused[int(ids[j])] = f"its target would touch cobra {ids[i]}"
            elif active[i] and (j >= n or int(ids[j]) not in refused):
                refused[int(ids[i])] = f"its target would touch {other}"
        return refused

    def _iteration(self, chosen: Chosen, order: Order, goes: Flags) -> Iteration:
        rows = np.flatnonzero(goes)
        steps = order.programme.steps.reshape(-1, 2)[rows]
        pulse_us = order.programme.pulse_us.reshape(-1, 2)[rows]
        sleeps, phi_first = np.zeros_like(steps), chosen.phi_first[rows]
        sleeps[:, THETA] = np.where(phi_first, np.abs(steps[:, PHI]), 0)
        sleeps[:, PHI] = np.where(phi_first, 0, np.abs(steps[:, THETA]))
        orders = Orders(self.plane.positioner_id[rows], steps, pulse_us, sleeps)
        return Iteration(chosen, order, orders, rows)

    def _plan(self, iteration: Iteration, refused: dict[int, str]) -> Plan:
        """The ways as they are expected."""
        step_s = 1e-6 * 16 * 156
        low = stops_deg(self.plane)[0]
        here = self.tracker.place_deg + low
        told = (iteration.order.told_deg * self.law.gain_of(iteration.order.told_deg)).reshape(-1, 2)
        end = np.clip(here + told, low, stops_deg(self.plane)[1])
        ids, robots = self.plane.positioner_id, []
        steps = np.abs(iteration.order.programme.steps.reshape(-1, 2))
        first_s = step_s * np.where(iteration.chosen.phi_first, steps[:, PHI], steps[:, THETA])
        last_s = step_s * steps.sum(axis=1)
        for row in range(len(self.plane)):
            if not steps[row].any():
                robots.append(_standing(int(ids[row]), here[row]))
                continue
            corner = np.where(
                [False, True] if iteration.chosen.phi_first[row] else [True, False], end[row], here[row]
            )
            points = np.array([here[row], corner, end[row]])
            time_s = np.array([0.0, first_s[row], last_s[row]])
            keep = np.append(True, np.diff(time_s) > 0.0)
            robots.append(Trajectory(int(ids[row]), time_s[keep], points[keep, 0], points[keep, 1]))
        return Plan(self.plane.instrument.name, self.plane.collision_buffer_mm, tuple(robots), refused)

    def _tube_mm(self, chosen: Chosen) -> Floats:
        """(N,) mm that a fibre may be beside its expected end, at most."""
        boxes = chosen.boxes_deg[:, 1]
        half = np.deg2rad(0.5 * (boxes[..., 1] - boxes[..., 0]))
        levers = np.column_stack([self.arms.reach_mm(boxes[:, PHI, 1]), self.arms.link_mm[:, 1]])
        return np.where(chosen.stage == CobraStage.STAY, 0.0, (half * levers).sum(axis=1))

    def verify(self, obstacles: FocalPlane, programme: Programme) -> Verification:
        """Whatever cobras of the `programme` may sweep, whenever they do: no two can meet.

        `obstacles`: as in the port; those that do not move stand where the drive believes them to be.
        """
        iteration: Iteration = programme.commands
        boxes, moves = iteration.chosen.boxes_deg, iteration.chosen.stage != CobraStage.STAY
        check = self.stages.check
        fixed = np.zeros(len(check.arms) - len(self.plane), dtype=bool)
        pairs = np.flatnonzero(np.append(moves, fixed)[check.pairs].any(axis=1))
        met = check.pairs[pairs[check.meeting(boxes, boxes, pairs)]]
        ids = self.plane.positioner_id
        found = tuple(
            Violation("robots", int(ids[i]), str(ids[j]), 0.0, 0.0)
            if j < len(ids)
            else Violation("obstacle", int(ids[i]), f"fiducial {j - len(ids)}", 0.0, 0.0)
            for i, j in met.tolist()
        )
        return Verification(found, np.nan, np.nan, 0.0, 0.0, 0.0)

    async def run(self, programme: Programme, watch: MotionWatch, say: Callable[[str], None]) -> Results:
        """One RUN; `watch` has nothing to watch, cobras report nothing; `say` as in the port."""
        iteration: Iteration = programme.commands
        self._at_stops = self._at_stops and not len(iteration.rows)
        result = await self.client.run(iteration.orders)
        done, unknown = np.zeros((2, len(self.plane)), dtype=bool)
        ended = np.array([how is Ended.DONE for how in result.ended], dtype=bool)
        lost = np.array([how in (Ended.UNKNOWN, Ended.TIMED_OUT) for how in result.ended], dtype=bool)
        done[iteration.rows], unknown[iteration.rows] = ended, lost
        # by the maps: what is learned of one that does not move is that it goes nowhere
        told_deg = self.tracker.place_deg + iteration.order.told_deg.reshape(-1, 2)
        told_mm = self.arms.xy_mm(np.clip(told_deg, 0.0, self.arms.range_deg))
        was_mm = self.arms.xy_mm(self.tracker.place_deg)
        self._moved[iteration.rows] = True
        self.law.take(iteration.order, np.repeat(done, 2))
        self._told_mm = np.where(done, np.hypot(*(told_mm - was_mm).T), 0.0)
        self.law.doubt_way(iteration.order, np.repeat(unknown, 2))
        if unknown.any():
            say(f"how far {int(unknown.sum())} cobras came is not known: an image tells")
        ids = iteration.orders.cobra_id.tolist()
        return Results({i: Result(i, OUTCOMES[how]) for i, how in zip(ids, result.ended, strict=True)})

    def arrived(self, goal_deg: Floats, last: bool = False) -> Flags | None:
        """(N,) seen, and by all images since they moved so near to goals (N, 2) in deg that they rest.

        One that the next images show to be well farther moves again; `last`: not used.
        """
        seen = np.isfinite(self._seen_mm).all(axis=1)
        share = np.where(self._stood, self.settings.stays_share, self.settings.rest_share)
        arrived: Flags = seen & self._rests(goal_deg - stops_deg(self.plane)[0], share)
        return arrived

    async def settle(self, ids: list[int]) -> None:
        """Nothing is to be done: cobras stand."""

    async def stop(self) -> list[int]:
        """Cuts the power of all sectors, which stops the motors, and gives it back."""
        await self.client.power(on=0)
        await self.client.power()
        return list(self._answers)

    async def home(self, ids: Iterable[int] = ()) -> Results:
        """All cobras at once search their stops, those `ids` are told of; nothing where all are there."""
        if not self._at_stops:
            await self._search_stops()
        there = set(self._answers)
        how = {i: Outcome.DONE if i in there else Outcome.DISCONNECTED for i in ids}
        return Results({i: Result(i, outcome) for i, outcome in how.items()})

    async def _search_stops(self, steps: tuple[int, int] = HOME_STEPS) -> None:
        """Phi into its stop, folded, then theta: whatever was believed, they are known again.

        `steps` of theta and phi in one round; slow motors get longer pulses.
        """
        ids = self.plane.positioner_id
        wanted = HOME_WAYS * self.arms.range_deg / np.array(steps)
        pulse_us = self.law.pulse_for(wanted.ravel(), REVERSE).reshape(-1, 2)
        for axis in (PHI, THETA) * HOME_ROUNDS:
            told = np.zeros((len(ids), 2), dtype=np.int64)
            told[:, axis] = -steps[axis]
            await self.client.run(Orders(ids, told, pulse_us))
        self.believe(np.zeros((len(ids), 2)))
        self._at_stops = True

    def suspects(self) -> dict[int, Suspect]:
        """Those that are stuck."""
        stuck = self.plane.positioner_id[self.found_stuck()].tolist()
        return dict.fromkeys(stuck, Suspect(False, "stuck: it was told to move again, and did not"))

    async def close(self) -> None:
        """Lets go of the FPGA."""
        await self.client.close()


def _standing(positioner_id: int, at_deg: Floats) -> Trajectory:
    return Trajectory(positioner_id, np.zeros(1), at_deg[:1], at_deg[1:])
