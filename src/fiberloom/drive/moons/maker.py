"""Waveforms of a whole field: the planner's ways, as near as the rules of the controllers allow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fiberloom.drive.moons.waveform import LEAST, MOST_SEGMENTS, SEGMENT_S, waveform
from fiberloom.drive.port import Wanted
from fiberloom.drive.steppers.known import KnownUnits
from fiberloom.drive.steppers.link import Leg
from fiberloom.drive.steppers.steps import AxisSteps
from fiberloom.instruments import FocalPlane, Instrument
from fiberloom.instruments.axis import Ranges
from fiberloom.planning import Plan, PlanSettings, Trajectory, plan, plan_corrections
from fiberloom.planning.bodies import beyond_range_deg
from fiberloom.typing import Flags, Floats, Ints

SETTINGS = PlanSettings(speed_deg_s=14.0, acceleration_deg_s2=56.0, grid_deg=11.7, in_hand_mm=0.3)
"""[A] Speed: a waveform that is behind its plan can catch up. The other numbers: ways within 256 segments,
and what waveforms differ from plans by. What is executed is verified by itself."""

PLANS = 4
"""In which units are left out whose waveforms their controllers would not take."""
AIMS = 3
"""Times that a waveform is made, until it ends as it was aimed."""


@dataclass(frozen=True)
class WaveformMaker:
    """One waveform for each unit. Implements `fiberloom.drive.steppers.drive.Maker`."""

    trial_steps: int

    @classmethod
    def of(cls, instrument: Instrument, trial_deg: float) -> WaveformMaker:
        """For an `instrument`, whose units are tried by `trial_deg` of alpha."""
        return cls(round(trial_deg / instrument.alpha.smallest_step_deg))

    def legs(
        self, wanted: Wanted, moves: Flags, counts: Ints, known: KnownUnits
    ) -> tuple[list[Leg], dict[int, str]]:
        """The planned ways as waveforms. `wanted`, `moves` (N,), `counts` (N, 2), `known`: as of `Maker`."""
        moves = moves.copy()
        stand: dict[int, str] = {}
        for _ in range(PLANS):
            made = _planned(wanted, moves)
            # of the plan before nothing is left: who was refused in it may have a way by now
            refused = stand | {int(wanted.obstacles.index_of(n)): why for n, why in made.refused.items()}
            rows = np.array([k for k, robot in enumerate(made.robots) if robot.moves], dtype=np.int64)
            if not len(rows):
                return [], refused
            within = _limit_counts(wanted.obstacles.instrument, known.steps)
            waves = _waves(made, rows, counts, known, within)
            unfit = _unfit(wanted.obstacles.instrument, known.steps, counts[rows], waves)
            if not unfit:
                break
            # the others were planned as if these moved: they stand from now on
            stand |= {int(rows[k]): why for k, why in unfit.items()}
            moves[rows[list(unfit)]] = False
        fit = np.array([k not in unfit for k in range(len(rows))], dtype=bool)
        if not fit.any():
            return [], refused | stand
        return [leg_of(rows[fit], counts[rows[fit]], waves[:MOST_SEGMENTS, fit])], refused | stand

    def trial(self, rows: Ints, counts: Ints) -> Leg:
        """Alpha out. `rows` (m,), `counts` (N, 2): as of `Maker`."""
        way = np.full(self.trial_steps // LEAST, LEAST)
        waves = np.zeros((len(way), len(rows), 2), dtype=np.int64)
        waves[..., 0] = way[:, None]
        return leg_of(rows, counts[rows], waves)


def limits_deg(instrument: Instrument) -> Floats:
    """(2, 2) by axis: lowest and highest angle, by its counts, that a unit lets an arm go to."""
    return np.array([instrument.alpha.target_range_deg, instrument.beta.hard_stop_deg])


def _beyond(instrument: Instrument, steps: AxisSteps, counts: Ints) -> Flags:
    """(m,) which would be stopped by their interlocks on ways through counts (K, m, 2)."""
    low, high = limits_deg(instrument).T
    angles = steps.angles_deg(counts)
    return np.asarray(((angles < low) | (angles > high)).any(axis=(0, 2)))


def leg_of(rows: Ints, before: Ints, waves: Ints) -> Leg:
    """The leg of units `rows` (m,) that begin at counts (m, 2), by steps (K, m, 2) of segments."""
    counts = np.concatenate([before[None], before + np.cumsum(waves, axis=0)])
    time_s = np.broadcast_to(SEGMENT_S * np.arange(len(counts))[:, None], counts.shape[:2])
    return Leg(rows, time_s, counts)


def _planned(wanted: Wanted, moves: Flags) -> Plan:
    """Ways of those that `moves` (N,); the others stand."""
    goal = np.where(moves[:, None], wanted.goal_deg, wanted.here_deg)
    make = plan_corrections if wanted.small else plan
    plane = _kept_within_limits(wanted.obstacles)
    return make(plane, wanted.here_deg, goal, seed=wanted.seed, approach_deg=0.0, settings=SETTINGS)


def _kept_within_limits(plane: FocalPlane) -> FocalPlane:
    """The same units, whose alpha is planned no farther than their interlocks let it go.

    Of other instruments ways may go some degrees beyond the range of targets. Beta's limits are its stops, to
    which all ways keep away. For planning alone: what is executed is held to limits by counts (`_unfit`), and
    beside a limit its angle in the layout may be beyond.
    """
    targets_deg, stops_deg = (
        np.tile(deg, (plane.n, 1, 1)) for deg in (plane.limits_deg, plane.hard_stops_deg)
    )
    targets_deg[:, 0] = limits_deg(plane.instrument)[0] - beyond_range_deg(plane)[0]
    return replace(plane, ranges=Ranges(targets_deg, stops_deg))


def _limit_counts(instrument: Instrument, steps: AxisSteps) -> Ints:
    """(2, 2) by end and axis: lowest and highest counts within the limits."""
    ends = (limits_deg(instrument).T - steps.home_deg) / (steps.sign * steps.step_deg)
    return np.stack([np.ceil(ends.min(axis=0)), np.floor(ends.max(axis=0))]).astype(np.int64)


def _waves(made: Plan, rows: Ints, counts: Ints, known: KnownUnits, within: Ints) -> Ints:
    """Steps (K, m, 2) of all that move, on their way `within` (2, 2) counts."""
    both = [_wave(made.robots[row], counts[row], known.of_unit(row), within) for row in rows.tolist()]
    out = np.zeros((max(max(map(len, pair)) for pair in both), len(rows), 2), dtype=np.int64)
    for k, pair in enumerate(both):
        for axis, steps in enumerate(pair):
            out[: len(steps), k, axis] = steps
    return out


def _unfit(instrument: Instrument, steps: AxisSteps, before: Ints, waves: Ints) -> dict[int, str]:
    """Which of m units would not run steps (K, m, 2) from counts `before` (m, 2), and why."""
    beyond = _beyond(instrument, steps, before + np.cumsum(waves, axis=0))
    late = waves[MOST_SEGMENTS:].any(axis=(0, 2))
    why = dict.fromkeys(
        np.flatnonzero(beyond).tolist(), "its way is beyond a limit by the unit's own switches"
    )
    return why | dict.fromkeys(
        np.flatnonzero(late).tolist(), f"its way takes more than {MOST_SEGMENTS} segments"
    )


def _wave(robot: Trajectory, start: Ints, unit: KnownUnits, within: Ints) -> list[Ints]:
    """Steps of alpha and beta along a trajectory, from counts `start` (2,), on the way `within` (2, 2).

    Folded, an arm as it was found has its fibre where the layout's has it by another alpha, up to a degree
    off: beside a limit a count on the way may ask for more than the unit lets it go.

    A waveform leaves out short turns, so an axis may come to its end from the other side than its plan does:
    then it is aimed as it really comes, for the gear has play.
    """
    way = _counted(robot, unit)
    way[:-1] = np.clip(way[:-1], *within)
    for _ in range(AIMS):
        pair = [waveform(robot.time_s, way[:, axis], int(start[axis])) for axis in (0, 1)]
        last = np.array([np.sign(steps[np.flatnonzero(steps)[-1:]]).sum() for steps in pair])
        comes = np.where(last == 0, 1.0, unit.steps.sign * last)
        end = np.where(last == 0, way[-1], unit.counts(robot.points_deg[-1:], comes[None])[0])
        if (end == way[-1]).all():
            break
        way[-1] = end
    return pair


def _counted(robot: Trajectory, unit: KnownUnits) -> Floats:
    """(n, 2) counts at the points of a trajectory of a unit."""
    points = robot.points_deg
    change = np.sign(np.diff(points, axis=0, prepend=points[:1]))
    for k in range(1, len(change)):
        change[k] = np.where(change[k] == 0.0, change[k - 1], change[k])
    rising = np.where(change == 0.0, 1.0, change)
    return unit.counts_on_way(points, points[-1:], rising).astype(np.float64)
