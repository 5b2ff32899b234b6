"""A limit on the power is kept: by the plan as it counts currents, and by the twin's motors tick by tick."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest

from fiberloom.bus.client import Client
from fiberloom.bus.trajectory import WireTrajectory
from fiberloom.design.power import within_power
from fiberloom.drive.sdssv.care import MotorCare
from fiberloom.drive.sdssv.limits import peak_current_A
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import plan
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.motors.power import power_of_scope
from fiberloom.twin.transport import TwinTransport

N, SEED = 7, 3
SDSSV = load_instrument("sdssv")
WAY_DEG = 25.0


def moved(instrument):
    """Peak of the plan as it counts, and of what the supply gave to all motors, W; and the plan's time, s."""
    plane = replace(generate(SDSSV, SEED, n_positioners=N), instrument=instrument)
    units = draw_units(plane, SEED)
    twin = Twin(plane, units, seed=SEED)
    client = Client(TwinTransport(twin))
    goal = plane.park_deg + np.array([WAY_DEG, -WAY_DEG])

    async def whole():
        await client.discover()
        made = await MotorCare(plane, client).planned(plan, plane, plane.park_deg, goal, seed=1)
        scopes = [[twin.scope(row, axis) for axis in (0, 1)] for row in range(N)]
        wire = {int(r.positioner_id): WireTrajectory.from_deg(r.time_s, *r.points_deg.T) for r in made.robots}
        assert (await client.run_trajectories(wire)).ok.all()
        return made, scopes

    made, scopes = asyncio.run(whole())
    given = [
        power_of_scope(scopes[row][axis].take(), units.plant[row, axis]).supply_W
        for row in range(N)
        for axis in (0, 1)
    ]
    volt = float(units.plant[0, 0]["supply"])
    counted_W = volt * peak_current_A(within_power(SDSSV, 1e3), made)[0]
    return counted_W, np.sum(given, axis=0), made.duration_s


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
    assert slower_s == pytest.approx(free_s / 0.5, rel=0.1)  # the first share of the speed below 0.6


def test_observe_keeps_the_power_or_says_what_one_positioner_takes(fl, tmp_path):
    targets = tmp_path / "targets.csv"
    targets.write_text("target_id,x_mm,y_mm\nA,10,0\n")
    words = ("--positioners", 1, "--camera", "noise", "--out", tmp_path / "out", "--power", 0.001)
    code, _, said = fl("observe", targets, *words)
    assert code == 2
    assert "one positioner takes 0.0" in said
    with pytest.raises(InputError, match="power is known of bldc"):
        within_power(load_instrument("moons"), 10.0)
