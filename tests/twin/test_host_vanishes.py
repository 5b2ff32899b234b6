"""A host that vanishes: positioners that heard the same last frame slow down together on their way."""

import asyncio
from dataclasses import replace

import numpy as np

from fiberloom._core import firmware as fw
from fiberloom.bus.client import Client
from fiberloom.bus.protocol import Command
from fiberloom.bus.trajectory import WireTrajectory, upload
from fiberloom.instruments import generate, load_instrument
from fiberloom.instruments.model import Care
from fiberloom.planning import plan, verify
from fiberloom.planning.trajectories import Plan, Trajectory
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.transport import TwinTransport

N, SEED = 19, 5
TIMEOUT_S = 2.0


def begin(plane, planned):
    """A twin on its way by a plan, whose wire angles are the arms'; the host has just sent START."""
    twin = Twin(plane, draw_units(plane, SEED), seed=SEED)
    client = Client(TwinTransport(twin))
    ways = {
        robot.positioner_id: WireTrajectory.from_deg(robot.time_s, robot.alpha_deg, robot.beta_deg)
        for robot in planned.robots
        if robot.moves
    }

    async def whole():
        await client.discover()
        assert (await upload(client.exchange, ways, 10, 5.0)).ok.all()

    asyncio.run(whole())
    twin.send([(fw.encode_identifier(0, Command.START_TRAJECTORY), b"")])
    return twin, client


def stopped_deg(timeout_s):
    """(N, 2) reported angles once all rest, the plane and its plan."""
    plane = generate(load_instrument("sdssv"), SEED, n_positioners=N)
    care = Care(host_timeout_s=timeout_s)
    plane = replace(plane, instrument=plane.instrument.model_copy(update={"care": care}))
    rng = np.random.default_rng(SEED)
    goal = np.column_stack([rng.uniform(20.0, 120.0, N), rng.uniform(60.0, 170.0, N)])
    planned = plan(plane, plane.park_deg, goal, seed=SEED)
    twin, client = begin(plane, planned)
    twin.run(planned.duration_s + 2.0)
    where, answered = asyncio.run(client.positions_deg(plane.positioner_id.tolist()))
    assert answered.all()
    assert not client.collisions
    assert not twin.touches()
    # what does not move reports where the twin put it, which is not its wire angle to the last bit
    where[~moves(planned)] = planned.end_deg[~moves(planned)]
    return plane, planned, where


def moves(planned):
    return np.array([robot.moves for robot in planned.robots])


def at(planned, time_s):
    return np.vstack([robot.at(time_s) for robot in planned.robots])


def test_all_stop_at_one_place_of_their_common_motion():
    _, planned, where = stopped_deg(TIMEOUT_S)
    # half of the time of slowing is lost on the way
    times_s = TIMEOUT_S + np.arange(0.0, 0.3, 0.0005)
    off = [np.abs(at(planned, t) - where).max() for t in times_s]
    best_s = times_s[int(np.argmin(off))]
    assert 0.12 < best_s - TIMEOUT_S < 0.14
    # 15 motor degrees; a corner that is rounded may be 24 beside its line
    assert min(off) < 0.015
    moving = np.abs(at(planned, best_s + 0.1) - at(planned, best_s)).max(axis=1) > 0.1
    assert moving.sum() > N // 2


def test_with_the_watch_off_the_motion_runs_to_its_end():
    _, planned, where = stopped_deg(0.0)
    assert np.abs(planned.end_deg - where).max() < 0.01


def test_what_is_left_behind_is_free_of_collisions():
    """The part of a verified motion up to any time of it is verified, too."""
    plane, planned, where = stopped_deg(TIMEOUT_S)
    robots = tuple(
        Trajectory(r.positioner_id, np.array([0.0]), *(np.array([angle]) for angle in place))
        for r, place in zip(planned.robots, where, strict=True)
    )
    assert verify(plane, Plan(planned.instrument, planned.collision_buffer_mm, robots)).ok
