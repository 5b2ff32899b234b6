"""Care for motors and supply: what each limit means, and that a field moves within all of them."""

import asyncio
import re
from dataclasses import replace

import numpy as np
import pydantic
import pytest

from fiberloom.bus.client import Client
from fiberloom.bus.outcome import Outcome, Result, Results
from fiberloom.bus.protocol import Command
from fiberloom.calibration.transmission.sweep import SweepSettings, calibrate_transmission
from fiberloom.drive.sdssv.care import MotorCare
from fiberloom.drive.sdssv.limits import (
    cold_rule,
    groups_within_supply,
    holding_percent,
    motor_speed_rpm,
    temperature_C,
)
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.instruments.model import Care
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.move import Goals
from fiberloom.planning import plan
from fiberloom.planning.supply import peak_current_A
from fiberloom.planning.trajectories import Plan, Trajectory
from fiberloom.studies.paper.no_record import NoRecord
from fiberloom.twin import bench_hardware, draw_units, field_hardware

N, SEED = 7, 3
SDSSV = load_instrument("sdssv")
COLD = [
    {"below_C": 0.0, "speed_rpm": 1000.0},
    {"below_C": -10.0, "speed_rpm": 500.0, "holding_percent": [45.0, 30.0]},
]
SCALE = {"temperature_zero_C": -40.0, "temperature_C_per_count": 0.02}
RAW = 1900
"""What the twin's firmware reports: -2 deg C on that scale."""


def with_care(instrument=SDSSV, **care):
    return instrument.model_copy(update={"care": Care.model_validate(care)})


def cared_plane(**care):
    plane = generate(SDSSV, SEED, n_positioners=N)
    return replace(plane, instrument=with_care(**care))


# -- temperature -------------------------------------------------------------------------------------------


def reports(*counts):
    results = Results({i: Result(i, Outcome.DONE, values=(c,)) for i, c in enumerate(counts)})
    results[99] = Result(99, Outcome.TIMED_OUT)
    return results


def test_the_temperature_is_the_median_of_those_that_answer():
    care = Care(cold=COLD, **SCALE)
    assert temperature_C(care, reports(2000, 2050, 2100)) == pytest.approx(1.0)
    assert temperature_C(care, reports(2050, 2050, 0)) == pytest.approx(1.0)
    assert temperature_C(care, reports()) is None
    assert temperature_C(Care(), reports(2000)) is None


@pytest.mark.parametrize(
    ("at_C", "rpm", "holding"),
    [(20.0, 1996.8, (0, 0)), (0.1, 1996.8, (0, 0)), (0.0, 1000.0, (0, 0)), (-9.0, 1000.0, (0, 0)),
     (-10.0, 500.0, (45, 30)), (-40.0, 500.0, (45, 30)), (None, 500.0, (45, 30))],
)  # fmt: skip
def test_the_coldest_rule_that_fits_counts_and_an_unknown_temperature_is_cold(at_C, rpm, holding):
    care = Care(cold=COLD, **SCALE)
    rule = cold_rule(care, at_C)
    assert motor_speed_rpm(SDSSV, 0, rule) == pytest.approx(rpm)
    assert holding_percent(rule) == holding


def test_a_rule_never_makes_a_motor_faster():
    rule = cold_rule(Care(cold=[{"below_C": 0.0, "speed_rpm": 5000.0}], **SCALE), -5.0)
    assert motor_speed_rpm(SDSSV, 1, rule) == pytest.approx(1996.8)


# -- current -----------------------------------------------------------------------------------------------


def lines(*robots):
    """A plan of (times, alpha, beta)."""
    made = [
        Trajectory(k + 1, *(np.array(column, float) for column in robot)) for k, robot in enumerate(robots)
    ]
    return Plan("sdssv", 2.0, tuple(made))


def test_currents_add_up_at_each_instant():
    """Friction of each motor that turns, and a share of the speed: 12 deg/s are full speed."""
    instrument = with_care(supply_A=10.0, motor_friction_A=[0.1, 0.01], motor_speed_A=[0.2, 0.02])
    one = ([0.0, 1.0, 2.0], [0.0, 6.0, 6.0], [0.0, 0.0, 12.0])
    assert peak_current_A(instrument, lines(one)) == (pytest.approx(0.2), 0.0)
    late = ([0.0, 1.0, 2.0], [5.0, 5.0, 17.0], [5.0, 5.0, 5.0])
    # in the second second: beta of the first at full speed, alpha of the other one
    assert peak_current_A(instrument, lines(one, late)) == (pytest.approx(0.33), 1.0)
    back = ([0.0, 1.0], [17.0, 5.0], [5.0, 5.0])
    assert peak_current_A(instrument, lines(back)) == (pytest.approx(0.3), 0.0)
    still = ([0.0], [1.0], [1.0])
    assert peak_current_A(instrument, lines(still)) == (0.0, 0.0)


def test_groups_are_as_large_as_the_supply_allows_and_hold_each_positioner_once():
    instrument = with_care(supply_A=1.0, motor_friction_A=[0.1, 0.05], motor_speed_A=[0.1, 0.05])
    assert groups_within_supply(instrument, [5, 3, 9, 1, 7, 2, 8]) == [[5, 3, 9], [1, 7, 2], [8]]
    assert groups_within_supply(SDSSV, [5, 3, 9]) == [[5, 3, 9]]
    assert groups_within_supply(SDSSV, []) == []


@pytest.mark.parametrize(
    ("care", "told"),
    [
        ({"supply_A": 1.0}, "needs motor_friction_A"),
        ({"supply_A": 0.1, "motor_friction_A": [0.1, 0.1]}, "enough for one positioner"),
        ({"cold": COLD}, "needs temperature_C_per_count"),
        ({"moves_max": 0}, "greater than or equal to 1"),
        ({"motor_A": 1.0}, "Extra inputs"),
    ],
)
def test_care_that_contradicts_itself_is_refused(care, told):
    with pytest.raises(pydantic.ValidationError, match=re.escape(told)):
        Care.model_validate(care)


def test_care_makes_no_other_array_of_it():
    """Calibrations and plans of an array stay its own."""
    plane = generate(SDSSV, SEED, n_positioners=N)
    assert cared_plane(moves_max=3, host_timeout_s=4.0).config_hash() == plane.config_hash()


# -- on the twin -------------------------------------------------------------------------------------------


class Cared:
    """A field with its client, and every request that was sent."""

    def __init__(self, **care):
        self.plane = cared_plane(**care)
        self.units = draw_units(self.plane, SEED)
        self.client = Client(field_hardware(self.plane, self.units, SEED).transport)
        self.care = MotorCare(self.plane, self.client)
        self.sent = []
        send = self.client.exchange.unicast

        async def listen(command, ids, payloads, timeout_s):
            self.sent.append(command)
            return await send(command, ids, payloads, timeout_s)

        self.client.exchange.unicast = listen

    def run(self, steps):
        async def whole():
            await self.client.discover()
            return await steps

        return asyncio.run(whole())

    def plan(self, way_deg=60.0):
        goal = self.plane.park_deg - [0.0, way_deg]
        return self.run(self.care.planned(plan, self.plane, self.plane.park_deg, goal, seed=1))


def test_without_limits_nothing_is_asked_and_the_plan_is_the_same():
    cared = Cared()
    same = plan(cared.plane, cared.plane.park_deg, cared.plane.park_deg - [0.0, 60.0], seed=1)
    assert cared.plan().to_json() == same.to_json()
    ids = [int(i) for i in cared.plane.positioner_id]
    for _ in range(100):
        cared.run(cared.care.begin(ids))
    assert cared.care.wait_s(ids) == 0.0
    assert cared.sent == []


def test_in_the_cold_plans_and_go_to_moves_are_slower_each_time():
    warm_s = Cared().plan().duration_s
    cared = Cared(cold=COLD, **SCALE)
    cold = cared.plan()
    assert cared.care.at_C == pytest.approx(-40.0 + 0.02 * RAW)
    # 500 of 1000 rpm more or less: ramps are the same
    assert cold.duration_s == pytest.approx(2.0 * warm_s, rel=0.15)
    # 60 deg at 1000 rpm are 10.2 s, the positioner says it itself
    begun = cared.run(cared.client.goto(None, 10.0, 110.0))
    assert begun.ok.all()
    told_s = max(r.values[1] for r in begun.values()) / 2000
    assert told_s == pytest.approx(60.0 * 1024 / 6000 + 0.25, rel=0.01)
    assert cared.sent.count(Command.SET_SPEED) == cared.sent.count(Command.SET_HOLDING_CURRENT) == 1


def test_the_wanted_state_is_set_again_after_a_power_cut():
    cared = Cared(cold=COLD, **SCALE)
    for _ in range(3):
        cared.run(cared.care.refresh())
    assert cared.sent.count(Command.SET_SPEED) == cared.sent.count(Command.SET_HOLDING_CURRENT) == 3


def test_a_plan_beyond_the_supply_is_made_slower_and_one_far_beyond_is_refused():
    motors = {"motor_friction_A": [0.01, 0.01], "motor_speed_A": [0.1, 0.1]}
    fast = Cared(supply_A=100.0, **motors)
    at_full = fast.plan()
    full_A, _ = peak_current_A(fast.plane.instrument, at_full)
    # all betas turn at once, and some alphas beside them for their approach
    motor_A = 0.01 + 0.975 * 0.1
    assert 0.99 * N * motor_A < full_A < 2 * N * motor_A
    slow = Cared(supply_A=0.7 * full_A, **motors)
    slower = slow.plan()
    assert peak_current_A(slow.plane.instrument, slower)[0] <= 0.7 * full_A
    # friction does not go down with the speed: less than 70 % of it, and nothing of the supply is given away
    assert 1.4 * at_full.duration_s < slower.duration_s < 1.7 * at_full.duration_s
    assert peak_current_A(slow.plane.instrument, slower)[0] > 0.65 * full_A
    with pytest.raises(InputError, match=r"0\.\d+ A after .* care.supply_A is 0\.025.* fewer positioners"):
        Cared(supply_A=0.025, **motors).plan()


def test_a_move_waits_until_each_of_its_positioners_may_begin():
    cared = Cared(moves_max=2, moves_window_s=100.0)
    ids = [int(i) for i in cared.plane.positioner_id]
    said = []

    async def moves():
        times = []
        for some in (ids, ids[:3], ids[3:], ids[:1], ids[:1]):
            await cared.care.begin(some, said.append)
            times.append(cared.client.time_s)
            await cared.client.sleep(10.0)
        return np.diff(times)

    # the first three have moved at 0 and 10, the fourth at 0 and 20; two a window: wait for 100, then for 110
    np.testing.assert_allclose(cared.run(moves()), [10.0, 10.0, 80.0, 10.0], atol=0.1)
    assert len(said) == 1
    assert "waiting 70 s" in said[0]


def test_the_host_watch_of_the_instrument_is_what_units_are_told():
    assert not draw_units(cared_plane(), SEED).firmware["host_timeout_ms"].any()
    assert (draw_units(cared_plane(host_timeout_s=5.0), SEED).firmware["host_timeout_ms"] == 5000.0).all()


def test_a_field_moves_within_all_limits_at_once():
    plane = cared_plane(
        cold=COLD, moves_max=1, moves_window_s=60.0, supply_A=0.5, motor_friction_A=[0.01, 0.01],
        motor_speed_A=[0.1, 0.1], **SCALE,
    )  # fmt: skip
    units = draw_units(plane, SEED)
    goals = [Goals.without_targets(plane, plane.park_deg - [0.0, way]) for way in (20.0, 40.0)]

    async def whole():
        bench = bench_hardware(plane, units, SEED)
        client = Client(bench.transport)
        await client.discover()
        found = await calibrate_transmission(client, bench.camera, plane, SweepSettings(40), seed=SEED)
        motion = FieldMotion(plane, found.maps, field_hardware(plane, units, SEED), NoRecord())
        await motion.connect()
        begun_s = []
        for goal in goals:
            await motion.go(goal)
            begun_s.append(motion.client.time_s - motion.moves[-1].plan.duration_s)
        return motion, begun_s

    motion, begun_s = asyncio.run(whole())
    assert begun_s[1] - begun_s[0] >= 59.0
    for move in motion.moves:
        assert peak_current_A(plane.instrument, move.plan)[0] <= 0.5
        assert not move.interrupted
