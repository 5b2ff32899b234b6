"""A limit on the power is kept: by the plan as it counts currents, and by the twin's motors tick by tick."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest

from fiberloom.bus.client import Client
from fiberloom.bus.trajectory import WireTrajectory
from fiberloom.design.power import within_power
from fiberloom.drive.sdssv.care import MotorCare
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import plan, verify, verify_supply
from fiberloom.planning.supply import peak_current_A
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.motors.power import power_of_scope
from fiberloom.twin.transport import TwinTransport

N, SEED = 7, 3
SDSSV = load_instrument("sdssv")
WAY_DEG = 25.0


def driven(instrument, goal_deg, settle_s=0.0):
    """The plane with where all began, a plan within its `[care]`, and what each axis of the twin did."""
    plane = replace(generate(SDSSV, SEED, n_positioners=N), instrument=instrument)
    units = draw_units(plane, SEED)
    twin = Twin(plane, units, seed=SEED)
    client = Client(TwinTransport(twin))

    async def whole():
        await client.discover()
        # from where they report to be: else all would first turn by as much as their datums are off
        start_deg, _ = await client.positions_deg(plane.positioner_id)
        made = await MotorCare(plane, client).planned(plan, plane, start_deg, goal_deg, seed=1)
        scopes = [[twin.scope(row, axis) for axis in (0, 1)] for row in range(N)]
        wire = {int(r.positioner_id): WireTrajectory.from_deg(r.time_s, *r.points_deg.T) for r in made.robots}
        assert (await client.run_trajectories(wire)).ok.all()
        await client.sleep(settle_s)
        return start_deg, made, [[scope.take() for scope in pair] for pair in scopes]

    start_deg, made, seen = asyncio.run(whole())
    given = [
        power_of_scope(seen[row][axis], units.plant[row, axis]).supply_W
        for row in range(N)
        for axis in (0, 1)
    ]
    return replace(plane, offline_position_deg=start_deg), units, made, seen, np.sum(given, axis=0)


PARK_DEG = generate(SDSSV, SEED, n_positioners=N).park_deg


def moved(instrument):
    """Peak of the plan as it counts, and of what the supply gave to all motors, W; and the plan's time, s."""
    _, units, made, _, given_W = driven(instrument, PARK_DEG + np.array([WAY_DEG, -WAY_DEG]))
    volt = float(units.plant[0, 0]["supply"])
    counted_W = volt * peak_current_A(within_power(SDSSV, 1e3), made)[0]
    return counted_W, given_W, made.duration_s


def smoothed(power_W):
    """Mean over 0.1 s: at start and turn each motor has its full voltage for one tick of 0.5 ms."""
    return np.convolve(power_W, np.full(200, 1.0 / 200), "valid")


def test_a_limit_is_kept_by_the_twins_motors():
    counted_W, given_W, free_s = moved(SDSSV)
    # the plan counts each motor with the peak of its ramp: the supply gives less, but not much less
    assert 0.7 * counted_W < smoothed(given_W).max() < counted_W
    limit_W = 0.6 * counted_W
    assert smoothed(given_W).max() > limit_W
    kept_W, given_W, slower_s = moved(within_power(SDSSV, limit_W, SEED))
    assert kept_W <= limit_W
    assert smoothed(given_W).max() < limit_W
    # nothing is given away: the current as it is counted goes with friction and speed
    assert 0.97 * limit_W < kept_W
    assert free_s / 0.7 < slower_s < free_s / 0.5


def turning(seen):
    """(M,) positioners of which a rotor turns, every 10 ms: by more than 2 degrees of the motor in 50 ms."""

    def of(scope):
        angle = scope["motor_rad"][::20]
        return np.abs(angle[5:] - angle[:-5]) > np.deg2rad(2.0)

    return np.sum([of(alpha) | of(beta) for alpha, beta in seen], axis=0)


def test_in_waves_no_more_rotors_turn_than_may():
    most = 2
    full = within_power(SDSSV, 1e3, SEED).care
    # a motor that counts alike at every speed: to go slower is of no use
    care = full.model_copy(
        update={
            "supply_A": 1.001 * most * sum(full.motor_most_A),
            "motor_friction_A": full.motor_most_A,
            "motor_speed_A": (0.0, 0.0),
        }
    )
    goal_deg = PARK_DEG + np.array([WAY_DEG, -WAY_DEG])
    plane, units, made, seen, given_W = driven(SDSSV.model_copy(update={"care": care}), goal_deg, 0.5)
    assert made.statistics["waves"] == 4
    assert made.refused == {}
    assert verify(plane, made, start_deg=plane.offline_position_deg, goal_deg=goal_deg).ok
    counted = verify_supply(plane, made, at_once=most)
    assert counted.ok
    assert counted.most_at_once == most
    # within 0.1 s of the start every motor that is to move takes hold, and turns by some 10 motor degrees
    assert turning(seen)[10:].max() == most
    assert smoothed(given_W).max() < care.supply_A * float(units.plant[0, 0]["supply"])


def test_observe_keeps_the_power_or_says_what_one_positioner_takes(fl, tmp_path):
    targets = tmp_path / "targets.csv"
    targets.write_text("target_id,x_mm,y_mm\nA,10,0\n")
    words = ("--positioners", 1, "--camera", "noise", "--out", tmp_path / "out", "--power", 0.001)
    code, _, said = fl("observe", targets, *words)
    assert code == 2
    assert "one positioner takes 0.0" in said
    with pytest.raises(InputError, match="power is known of bldc"):
        within_power(load_instrument("moons"), 10.0)
