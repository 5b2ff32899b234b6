"""Waveforms of a whole field: the planner's ways, as near as the rules of the controllers allow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.drive.moons.waveform import LEAST, MOST_SEGMENTS, SEGMENT_S, waveform
from fiberloom.drive.port import Wanted
from fiberloom.drive.steppers.known import KnownUnits
from fiberloom.drive.steppers.link import Leg
from fiberloom.drive.steppers.steps import AxisSteps
from fiberloom.instruments import Instrument
from fiberloom.planning import Plan, PlanSettings, Trajectory, plan, plan_corrections
from fiberloom.typing import Flags, Floats, Ints

SETTINGS = PlanSettings(speed_deg_s=14.0, acceleration_deg_s2=56.0, grid_deg=11.7, in_hand_mm=0.3)
"""[A] Speed: a waveform that is behind its plan can catch up. The other numbers: ways within 256 segments,
and what waveforms differ from plans by. What is executed is verified by itself."""

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
        goal = np.where(moves[:, None], wanted.goal_deg, wanted.here_deg)
        make = plan_corrections if wanted.small else plan
        made = make(
            wanted.obstacles, wanted.here_deg, goal, seed=wanted.seed, approach_deg=0.0, settings=SETTINGS
        )
        rows = np.array([k for k, robot in enumerate(made.robots) if robot.moves], dtype=np.int64)
        refused = {int(wanted.obstacles.index_of(number)): why for number, why in made.refused.items()}
        if not len(rows):
            return [], refused
        waves, late = _waves(made, rows, counts, known)
        beyond = _beyond(wanted.obstacles.instrument, known.steps, counts[rows] + np.cumsum(waves, axis=0))
        refused |= dict.fromkeys(
            rows[beyond].tolist(), "its way is beyond a limit by the unit's own switches"
        )
        refused |= dict.fromkeys(rows[late].tolist(), f"its way takes more than {MOST_SEGMENTS} segments")
        if (late | beyond).all():
            return [], refused
        fit = ~(late | beyond)
        return [leg_of(rows[fit], counts[rows[fit]], waves[:MOST_SEGMENTS, fit])], refused

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


def _waves(made: Plan, rows: Ints, counts: Ints, known: KnownUnits) -> tuple[Ints, Flags]:
    """Steps (K, m, 2) of all that move; and (m,) whose ways are too long."""
    both = [_wave(made.robots[row], counts[row], known.of_unit(row)) for row in rows.tolist()]
    late = np.array([max(map(len, pair)) > MOST_SEGMENTS for pair in both])
    out = np.zeros((max(max(map(len, pair)) for pair in both), len(rows), 2), dtype=np.int64)
    for k, pair in enumerate(both):
        for axis, steps in enumerate(pair):
            out[: len(steps), k, axis] = steps
    return out, late


def _wave(robot: Trajectory, start: Ints, unit: KnownUnits) -> list[Ints]:
    """Steps of alpha and beta along a trajectory, from counts `start` (2,).

    A waveform leaves out short turns, so an axis may come to its end from the other side than its plan does:
    then it is aimed as it really comes, for the gear has play.
    """
    way = _counted(robot, unit)
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
