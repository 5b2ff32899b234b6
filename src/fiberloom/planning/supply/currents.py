"""The current of all motors of a plan, as an instrument's `[care]` counts it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.instruments import Instrument
from fiberloom.planning.trajectories import Plan, Trajectory
from fiberloom.typing import Floats


@dataclass(frozen=True, eq=False)
class Currents:
    """Of all motors together, constant from each of M times to the next. Ramps are not counted."""

    time_s: Floats
    """(M,)"""
    friction_A: Floats
    """(M,) of the motors that turn, however slowly."""
    speed_A: Floats
    """(M,) what their speeds add."""

    @property
    def peak_A(self) -> tuple[float, float]:
        """Largest current, A, and when, s."""
        if not len(self.time_s):
            return 0.0, 0.0
        both = self.friction_A + self.speed_A
        worst = int(np.argmax(both))
        return float(both[worst]), float(self.time_s[worst])

    def share_within(self, supply_A: float) -> float:
        """By which factor all speeds have to go down so that `supply_A` is enough; 0: none would do.

        If nothing else about the plan changed. Above 1 where there is something left.
        """
        left_A = supply_A - self.friction_A
        if (left_A < -1e-9).any():
            return 0.0
        turns = self.speed_A > 1e-9
        return float((left_A[turns] / self.speed_A[turns]).min(initial=np.inf))


def currents(instrument: Instrument, planned: Plan) -> Currents:
    """Of the `instrument`'s `[care]`: friction of each motor that turns, and its speed as a share.

    `planned`: trajectories of the instrument's positioners.
    """
    moving = [robot for robot in planned.robots if robot.moves]
    if not moving:
        return Currents(np.zeros(0), np.zeros(0), np.zeros(0))
    changes = np.vstack([_changes(instrument, robot) for robot in moving])
    when_s, which = np.unique(changes[:, 0], return_inverse=True)
    steps = np.zeros((len(when_s), 2))
    np.add.at(steps, which.ravel(), changes[:, 1:])
    return Currents(when_s, *np.cumsum(steps, axis=0).T)


def peak_current_A(instrument: Instrument, planned: Plan) -> tuple[float, float]:
    """Largest current of all motors of a plan, A, and when, s. `instrument`, `planned` as in `currents`."""
    return currents(instrument, planned).peak_A


def _changes(instrument: Instrument, robot: Trajectory) -> Floats:
    """(k, 3) times in s, and by how much its two motors' currents change then by friction and speed, A."""
    care = instrument.care
    speed_deg_s = np.abs(np.diff(robot.points_deg, axis=0)) / np.diff(robot.time_s)[:, None]
    share = speed_deg_s / [axis.speed_deg_s for axis in instrument.axes]
    friction = np.where(share > 0.0, care.motor_friction_A, 0.0).sum(axis=1)
    speed = (share * care.motor_speed_A).sum(axis=1)
    steps = (np.diff(current, prepend=0.0, append=0.0) for current in (friction, speed))
    return np.column_stack([robot.time_s, *steps])
