"""The drive of steppers without encoders: what is planned becomes legs of counts, whatever carries them.

Where an arm is follows from the counts since its datum, and from what a bench has found of the unit. At the
begin all search their switches, go a little way and search again: one that does not count there what it went
loses steps, or does not move, and is left where it is.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from fiberloom.bus.motion import MotionWatch
from fiberloom.bus.outcome import Outcome, Result, Results
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
from fiberloom.drive.steppers.known import KnownUnits
from fiberloom.drive.steppers.link import Homed, Leg, StepperLink, UnitTold
from fiberloom.drive.steppers.ways import ArmWays
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.handicaps import Handicaps
from fiberloom.metrology import Measurement
from fiberloom.planning import MotionLimits, Plan, Trajectory, Verification, verify
from fiberloom.typing import Flags, Floats, Ints

SLIP_DEG = 0.5
"""[A] A unit that counts so much otherwise at its switch, after the trial, has lost steps."""
LOST_DEG = 0.1
"""[A] A unit that counts so much otherwise at its switch, after a field, has lost steps in it. Datums repeat
to 0.07 deg where 30 um at a reach of 25 mm is accepted (ukatc/FPUVerification)."""
NEAR_DEG = 5.0
"""[A] One that is stopped by its limit on its way home, for it has lost steps, is so near."""
TRIAL_DEG = 30.0
"""[A] Way of the trial, by alpha, folded."""
CLOCK = MotionLimits(speed_deg_s=1e3, acceleration_deg_s2=1e6)
"""What the clock of the controllers sees to."""
ROUNDS = 5
"""In which units whose ways the verifier refuses are left out."""


class Maker(Protocol):
    """Makes legs of what is wanted, as an instrument's controllers can run them."""

    def legs(
        self, wanted: Wanted, moves: Flags, counts: Ints, known: KnownUnits
    ) -> tuple[list[Leg], dict[int, str]]:
        """Legs of what is `wanted` of those that `moves` (N,); and by row why one does not move.

        `counts` (N, 2): now; `known` of the units.
        """
        ...

    def trial(self, rows: Ints, counts: Ints) -> Leg:
        """By which folded units `rows` turn alpha a little, from `counts` (N, 2)."""
        ...


@dataclass(frozen=True, eq=False)
class Legs:
    """The commands of a programme."""

    legs: tuple[Leg, ...]


class StepperDrive:
    """Steppers on a link. Implements `fiberloom.drive.Drive`."""

    def __init__(self, plane: FocalPlane, link: StepperLink, known: KnownUnits, maker: Maker) -> None:
        """`plane`: N positioners; `link` to controllers; `known` of the units; `maker` of their legs."""
        self.plane, self.link, self.known, self.maker = plane, link, known, maker
        self.model = DriveModel.of(plane, step_deg=tuple(known.steps.step_deg.tolist()))
        self.ids: list[int] = []
        n = len(plane)
        self.counts = np.zeros((n, 2), dtype=np.int64)
        self.rising = np.full((n, 2), -known.steps.sign)
        """(N, 2) 1 or -1: how angles changed last."""
        self.doubt_deg = np.zeros((n, 2))
        """(N, 2) by so much an arm may be off where it is believed, that fell silent on its way."""
        self._found: dict[int, Suspect] = {}
        self._with_datum: set[int] = set()
        """Numbers of those that know their datum."""
        self._lost: dict[int, str] = {}

    # who is there

    @property
    def time_s(self) -> float:
        """Of the bus."""
        return self.link.time_s

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass, s."""
        await self.link.sleep(duration_s)

    async def connect(self) -> None:
        """Asks all what they are; those that have no datum search it, and go to and fro.

        InputError where none of the layout's positioners answers.
        """
        told = await self.link.ask(self.plane.positioner_id[~self.plane.offline].tolist())
        self.ids = sorted(told)
        if not self.ids:
            raise none_answers(self.plane)
        self._found |= self._exchanged(told) | self._from_the_bench(told)
        await self._begin(told)

    async def look(self) -> dict[int, UnitSays]:
        """What those of the layout say that answer, by number; nothing moves."""
        told = await self.link.ask(self.plane.positioner_id[~self.plane.offline].tolist())
        unfit = self._exchanged(told) | self._from_the_bench(told)
        return {
            number: UnitSays(one.homed, one.moving, unfit[number].why if number in unfit else "")
            for number, one in told.items()
        }

    async def _begin(self, told: dict[int, UnitTold]) -> None:
        """Believes what these count; those without a datum search it, and go to and fro."""
        self._believe(told)
        if new := [number for number, one in told.items() if not one.homed]:
            await self.home(new)
            await self._try(new)

    def _exchanged(self, told: dict[int, UnitTold]) -> dict[int, Suspect]:
        """Units that are not the ones of their places."""
        at = {one.serial: number for number, one in told.items()}
        return {
            number: Suspect(False, f"unit {one.serial} answers there, that of positioner {one.serial} is "
            f"{'elsewhere' if number not in at else f'at {at[number]}'}: check plugs and numbers")
            for number, one in told.items()
            if one.serial != number
        }  # fmt: skip

    def _from_the_bench(self, told: dict[int, UnitTold]) -> dict[int, Suspect]:
        numbers = {int(self.plane.positioner_id[row]): why for row, why in self.known.why.items()}
        return {number: Suspect(False, why) for number, why in numbers.items() if number in told}

    def _believe(self, told: dict[int, UnitTold]) -> None:
        """Where these are by what they have `told`; without a datum their counts say nothing."""
        for number, one in told.items():
            if one.homed:
                row = self.plane.index_of(number)
                self.counts[row], self.doubt_deg[row] = one.counts, 0.0
                self._with_datum.add(number)
            else:
                self._with_datum.discard(number)

    async def home(self, ids: Iterable[int]) -> Results:
        """Searches the switches of these, no two neighbours at once. Who ends well is there."""
        asked = list(ids)
        found: dict[int, Homed] = {}
        for rows in ArmWays(self.plane).apart(np.atleast_1d(self.plane.index_of(asked))):
            found |= await self.link.home(self.plane.positioner_id[rows].tolist())
        results = {}
        for number in asked:
            row, one = self.plane.index_of(number), found.get(number)
            if one is None or not one.found:
                results[number] = Result(number, Outcome.TIMED_OUT)
                continue
            results[number] = Result(number, Outcome.DONE)
            self._compare(number, one)
            self.counts[row], self.rising[row] = 0, -self.known.steps.sign
            self._with_datum.add(number)
        return Results(results)

    def _compare(self, number: int, found: Homed) -> None:
        """Notes what a unit has lost since its last datum, where it had one."""
        lost_deg = np.abs(found.slip) * self.known.steps.step_deg
        if number in self._with_datum and (lost_deg > LOST_DEG).any():
            self._lost[number] = (
                f"has lost steps since its last datum: {found.slip[0]} of alpha and {found.slip[1]} of beta, "
                f"{lost_deg[0]:.2f} and {lost_deg[1]:.2f} deg; where it was since then is not what it counted"
            )

    def near_datum(self) -> Flags:
        """(N,) by their counts, within `NEAR_DEG` of both switches; of the silent nothing is known."""
        near = (np.abs(self.counts) * self.known.steps.step_deg < NEAR_DEG).all(axis=1)
        return np.asarray(near & np.isin(self.plane.positioner_id, self.ids))

    def lost_steps(self) -> dict[int, str]:
        """What the latest searches have found to be lost, by number; each is told once."""
        found, self._lost = self._lost, {}
        return found

    async def _try(self, ids: list[int]) -> None:
        """A little way with arms folded, and the switches again: who counts otherwise loses steps."""
        fit = [number for number in ids if number not in self._found]
        await self._trial(fit)
        again = await self.link.home(fit)
        limit = SLIP_DEG / self.known.steps.step_deg
        for number in fit:
            one = again.get(number)
            if one is None or not one.found:
                self._found[number] = Suspect(False, "its search of the datum ends without its switch")
            elif (np.abs(one.slip) > limit).any():
                self._found[number] = Suspect(False, _slipped(one.slip))

    async def _trial(self, ids: list[int]) -> None:
        """A little way of all that can: where one cannot the others may not have started, and do so now."""
        while ids:
            leg = self.maker.trial(np.atleast_1d(self.plane.index_of(ids)), self.counts)
            told = await self.link.run(ids, leg)
            ids = [number for number in ids if told[number] is Outcome.STOPPED]

    async def rest(self, alarm: Callable[[str], None], left_moving: bool = False) -> None:
        """Stops what a host that was killed has left on its way; `alarm` and `left_moving` as in the port."""
        told = await self.link.ask(self.ids)
        moving = [number for number, one in told.items() if one.moving]
        if moving or left_moving:
            await self.link.stop()
            await self._begin(await self.link.ask(self.ids))
            alarm(f"{len(moving)} positioners were still moving at the begin; all are stopped")

    async def believed(self, ids: Ints) -> BelievedPlaces:
        """Where these (n,) are by their counts."""
        rows = np.atleast_1d(self.plane.index_of(ids))
        angles = self.known.true_deg(self.counts, self.rising)[rows]
        wire = self.known.steps.angles_deg(self.counts)[rows]
        return BelievedPlaces(angles, wire, np.isin(ids, self.ids))

    async def heard_again(self, silent: Iterable[int]) -> list[int]:
        """Those of the `silent` that answer now, and still know their datum."""
        told = await self.link.ask(sorted(silent))
        back = sorted(number for number, one in told.items() if one.homed)
        self._believe(told)
        self.ids = sorted({*self.ids, *back})
        return back

    # programmes

    async def prepare(self, wanted: Wanted) -> Programme:
        """Legs to the goals; who cannot make its way is named in the plan."""
        return await asyncio.to_thread(self._prepared, wanted)

    def _prepared(self, wanted: Wanted) -> Programme:
        begun_s = time.thread_time()
        wanted = replace(
            wanted, obstacles=self._doubted(wanted.obstacles), goal_deg=self._at_datum(wanted.goal_deg)
        )
        moves = (np.abs(wanted.goal_deg - wanted.here_deg).max(axis=1) > 1e-9) & ~wanted.obstacles.offline
        refused: dict[int, str] = {}
        made = self._made(wanted, moves, refused)
        for _ in range(ROUNDS):
            met = self._met(self.verify(wanted.obstacles, made), moves)
            if not met:
                break
            refused |= met
            moves[list(met)] = False
            made = self._made(wanted, moves, refused)
        return made.timed(begun_s)

    def _at_datum(self, goal_deg: Floats) -> Floats:
        """Goals (N, 2) deg, of those that are to fold at home by their own switches.

        These close a little off the place that the layout has, which may be beyond a limit.
        """
        home = np.stack([self.plane.park_deg, np.broadcast_to(self.known.steps.home_deg, goal_deg.shape)])
        folds = np.asarray((np.abs(goal_deg - home) < 1e-6).all(axis=(0, 2)))
        nothing = np.zeros_like(self.counts)
        datum = self.known.true_deg(nothing, np.full(goal_deg.shape, -self.known.steps.sign))
        return np.where(folds[:, None], datum, goal_deg)

    def _made(self, wanted: Wanted, moves: Flags, refused: dict[int, str]) -> Programme:
        legs, why = self.maker.legs(wanted, moves, self.counts, self.known)
        ids = self.plane.positioner_id
        named = {int(ids[row]): text for row, text in (why | refused).items()}
        plan = self._plan(wanted, legs, named)
        return Programme(plan, None, Legs(tuple(legs)), {"legs": len(legs)})

    def _met(self, found: Verification, moves: Flags) -> dict[int, str]:
        """Those that move and that the verifier has found to touch something, by row."""
        met: dict[int, str] = {}
        for one in found.violations:
            row = int(self.plane.index_of(one.positioner_id))
            pair = [row, int(self.plane.index_of(int(one.other)))] if one.other.isdigit() else [row]
            mover = next((k for k in reversed(pair) if moves[k]), None)
            if mover is not None and one not in found.contacts and not any(k in met for k in pair):
                near = one.other.isdigit()
                met[mover] = f"its way {'comes too near to another arm' if near else 'is not safe'}: {one}"
        return met

    def _plan(self, wanted: Wanted, legs: list[Leg], refused: dict[int, str]) -> Plan:
        """The ways that the counts mean."""
        at = _Moments(len(self.plane))
        counts, rising, sign = self.counts.copy(), self.rising.copy(), self.known.steps.sign
        begin_s = 0.0
        for leg in legs:
            for k in range(1, len(leg.time_s)):
                change = leg.counts[k] - counts[leg.rows]
                rising[leg.rows] = np.where(change == 0, rising[leg.rows], np.sign(sign * change))
                before = self.known.true_deg(counts, rising)
                counts[leg.rows] = leg.counts[k]
                after = self.known.true_deg(counts, rising)
                goes = (change != 0).any(axis=1)
                going = leg.rows[goes]
                span = begin_s + leg.time_s[k - 1, goes], begin_s + leg.time_s[k, goes]
                at.add(going, span, before[going], after[going])
            begin_s += leg.duration_s
        here = np.where(
            wanted.obstacles.offline[:, None], wanted.here_deg, self.known.true_deg(self.counts, self.rising)
        )
        return Plan(
            self.plane.instrument.name,
            self.plane.collision_buffer_mm,
            at.trajectories(self.plane.positioner_id, here),
            refused,
        )

    async def compile(self, plan: Plan) -> Programme:
        """Legs to the end of a `plan` that was made elsewhere: its way there is not gone."""
        here = self.known.true_deg(self.counts, self.rising)
        still = np.array([not robot.moves for robot in plan.robots])
        goal = np.where(still[:, None], here, plan.end_deg)
        return await self.prepare(Wanted(self.plane, here, goal, np.zeros(len(self.plane))))

    def verify(self, obstacles: FocalPlane, programme: Programme) -> Verification:
        """Proves the way that counts make arms go; `obstacles`, `programme` as in the port."""
        plane = self._doubted(with_tube(obstacles, programme.tube_mm))
        return verify(plane, programme.plan, limits=CLOCK)

    def _doubted(self, obstacles: FocalPlane) -> FocalPlane:
        """With what is not known of those that fell silent."""
        if not self.doubt_deg.any():
            return obstacles
        known = obstacles.handicaps or Handicaps.none(obstacles.n)
        return replace(obstacles, handicaps=replace(known, doubt_deg=self.doubt_deg))

    async def run(self, programme: Programme, watch: MotionWatch, say: Callable[[str], None]) -> Results:
        """Leg by leg; one that fails is left out of the rest, and so is whatever its way was proven with.

        `watch`: not used, no unit tells where it is on its way; `say`: told why a leg did not start.
        """
        commands: Legs = programme.commands
        ids, ended = self.plane.positioner_id, dict.fromkeys(programme.moving, Outcome.DONE)
        for leg in commands.legs:
            if any(how is not Outcome.DONE for how in ended.values()):
                ended |= {n: Outcome.STOPPED for n in ids[leg.rows].tolist() if ended.get(n) is Outcome.DONE}
                continue
            told = await self.link.run(ids[leg.rows].tolist(), leg, say)
            ended |= told
            gone = np.array([told.get(int(n)) is Outcome.DONE for n in ids[leg.rows]], dtype=bool)
            self._went(leg, gone)
            self._lose(leg, np.array([told.get(int(n)) is Outcome.DISCONNECTED for n in ids[leg.rows]]))
            if not gone.all():
                ended |= await self._silent(set(ended) - set(told))
        return Results({number: Result(number, how) for number, how in ended.items()})

    def _went(self, leg: Leg, gone: Flags) -> None:
        """Counts at the end of a leg, of those that have `gone` (m,) it."""
        rows, sign = leg.rows[gone], self.known.steps.sign
        for before, after in zip(leg.counts[:-1, gone], leg.counts[1:, gone], strict=True):
            self.rising[rows] = np.where(after == before, self.rising[rows], np.sign(sign * (after - before)))
        self.counts[rows] = leg.counts[-1, gone]

    async def _silent(self, ids: set[int]) -> dict[int, Outcome]:
        """Those of the others that do not answer either: they stand where they were."""
        silent = ids - set(await self.link.ask(sorted(ids)))
        self.ids = sorted(set(self.ids) - silent)
        return dict.fromkeys(silent, Outcome.DISCONNECTED)

    def _lose(self, leg: Leg, silent: Flags) -> None:
        """Those of a leg that have fallen `silent` (m,): anywhere on their way."""
        rows = leg.rows[silent]
        low, high = (end(leg.counts[:, silent], axis=0) for end in (np.min, np.max))
        self.counts[rows] = (low + high) // 2
        self.doubt_deg[rows] = 0.5 * (high - low) * self.known.steps.step_deg
        self.ids = sorted(set(self.ids) - set(self.plane.positioner_id[rows].tolist()))

    def arrived(self, goal_deg: Floats, last: bool = False) -> Flags | None:
        """None: the last image alone is what tells. `goal_deg` (N, 2) and `last`: not used."""
        return None

    async def settle(self, ids: list[int]) -> None:
        """After a move that went wrong: all stop, and these say where they stand."""
        await self.link.stop()
        self._believe(await self.link.ask(ids))

    async def stop(self) -> list[int]:
        """Stops all; what they have counted until then is believed. Returns which answer."""
        await self.link.stop()
        told = await self.link.ask(self.ids)
        self._believe(told)
        return sorted(told)

    def excused(self, image: Measurement) -> None:
        """None: a fibre that an `image` does not show is dark."""

    def seen(self, image: Measurement, mobile: Flags) -> Floats | None:
        """None: counts are believed, whatever an `image` shows; `mobile` as in the port."""
        return None

    def suspects(self) -> dict[int, Suspect]:
        """Units that are exchanged, that lose steps, or that the bench has refused."""
        return self._found

    async def close(self) -> None:
        """Closes the bus."""
        await self.link.close()


class _Moments:
    """Corners of N trajectories, as they come."""

    def __init__(self, n: int) -> None:
        self._rows: list[list[tuple[float, float, float]]] = [[] for _ in range(n)]

    def add(self, rows: Ints, span_s: tuple[Floats, Floats], before_deg: Floats, after_deg: Floats) -> None:
        """Rows (n,) go from one place to another, (n, 2) deg, each in its span of time, (n,) s."""
        ways = zip(rows.tolist(), *(part.tolist() for part in (*span_s, before_deg, after_deg)), strict=True)
        for row, begin_s, end_s, here, there in ways:
            own = self._rows[row]
            if not own or own[-1][0] < begin_s - 1e-9:
                own.append((begin_s, *here))
            own.append((end_s, *there))

    def trajectories(self, ids: Ints, here_deg: Floats) -> tuple[Trajectory, ...]:
        """Of all N, those that stand at `here_deg` (N, 2)."""
        return tuple(
            _trajectory(int(number), own, here)
            for number, own, here in zip(ids, self._rows, here_deg, strict=True)
        )


def _trajectory(number: int, corners: list[tuple[float, float, float]], here_deg: Floats) -> Trajectory:
    begin = [] if corners and corners[0][0] <= 0.0 else [(0.0, *here_deg)]
    time_s, alpha, beta = np.array(begin + corners).T
    return Trajectory(number, time_s, alpha, beta)


def _slipped(slip: tuple[int, int]) -> str:
    return f"loses steps: {slip[0]} of alpha and {slip[1]} of beta are missing at its switches after a trial"
