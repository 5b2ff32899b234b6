"""What it takes to load the trajectories of a plan: frames, and time on the wires."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from fiberloom.bus.protocol import COMMANDS, Command, frame_s
from fiberloom.errors import InputError
from fiberloom.planning.trajectories import Plan

PORTS = 24
"""Of an SDSS-V array: six gateways with four ports each."""


@dataclass(frozen=True)
class FrameBudget:
    """Frames that load a plan, each of which is answered by a frame without data."""

    frames: int
    """A point of an axis each, and for each positioner that moves one before its points and one after."""
    wire_s: float
    """Until the last answer is there, s, at 1 Mbit/s and without waiting for the host: at least so long."""


def frame_budget(plan: Plan, ports: int = PORTS) -> FrameBudget:
    """What a plan takes.

    Parameters
    ----------
    plan : Plan
        Positioners that do not move get no frames.
    ports : int
        Wires, from 1 on, over which the positioners are spread evenly. Which of them share one is not known:
        `wire_s` is of those with the most points on one wire.

    Raises
    ------
    InputError
        Fewer than one port.
    """
    if ports < 1:
        raise InputError(f"ports {ports}: positioners hang on 1 or more")
    points = [sum(len(robot.corners(axis)) for axis in (0, 1)) for robot in plan.robots if robot.moves]
    on_one = sorted(points, reverse=True)[: -(-len(plan.robots) // ports)]
    ends = _exchange_s(Command.SEND_NEW_TRAJECTORY) + _exchange_s(Command.TRAJECTORY_DATA_END)
    wire_s = sum(on_one) * _exchange_s(Command.SEND_TRAJECTORY_DATA) + len(on_one) * ends
    return FrameBudget(sum(points) + 2 * len(points), wire_s)


def _exchange_s(command: Command) -> float:
    """A frame and its answer."""
    spec = COMMANDS[command]
    return frame_s(struct.calcsize("<" + spec.request)) + frame_s(spec.layout.size)
