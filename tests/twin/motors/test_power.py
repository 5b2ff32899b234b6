"""Current, power and heat of the twin's motors: books that balance, closed forms, MuJoCo's motor."""

import numpy as np
import pytest
from mujoco_motor import MICRO, mujoco_with_dcmotor

from fiberloom._core import twin as core
from fiberloom.bus.identifier import encode
from fiberloom.bus.protocol import Command
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.motors.power import power_of_duties, power_of_scope, power_of_torque
from fiberloom.twin.motors.sets import with_motor
from fiberloom.twin.units import PLANT_DTYPE, defaults
from fiberloom.units import COUNTS_PER_DEG, GEAR

PAPER = defaults(core.PLANT_PARAMS, PLANT_DTYPE)
OPEN_LOOP = {0: Command.ALPHA_OPEN_LOOP_COLLISION_DETECTION, 1: Command.BETA_OPEN_LOOP_COLLISION_DETECTION}


def closed_loop(share, angle_rad, lead_rad=0.0):
    """Duties (M, 3) by Eq. 18 and 20: the field a quarter turn and `lead_rad` ahead of the rotor."""
    field = angle_rad + 0.5 * np.pi + lead_rad
    phases = field[:, None] + np.array([2.0, -2.0, 0.0]) * np.pi / 3.0
    return 0.5 * share * (1.0 + np.cos(phases))


def k_M2(plant):
    return float(1.5 * plant["flux_linkage"] ** 2 / plant["coil_resistance"])


def torque_per_volt(plant):
    return float(1.5 * np.sqrt(0.75) * plant["flux_linkage"] / plant["coil_resistance"])


@pytest.mark.parametrize("name", ["paper", "10mm", "13mm"])
def test_in_closed_loop_heat_is_torque_squared_over_k_m_squared(name):
    """P_copper = T^2/K_M^2, P_supply = T' T/K_M^2 with T' = T + K_M^2 omega, at any angle of the rotor."""
    plant = with_motor(PAPER, 0, name, "here")
    angle, speed, share = np.linspace(0.0, 7.0, 50), np.full(50, 150.0), 0.6
    found = power_of_duties(closed_loop(share, angle), angle, speed, plant)
    driving = torque_per_volt(plant) * share * float(plant["supply"])
    torque = driving - k_M2(plant) * speed
    np.testing.assert_allclose(found.copper_W, torque**2 / k_M2(plant), rtol=1e-9)
    np.testing.assert_allclose(found.supply_W, driving * torque / k_M2(plant), rtol=1e-9)
    planned = power_of_torque(torque, speed, plant, found.period_s)
    np.testing.assert_allclose(planned.supply_W, found.supply_W, rtol=1e-9)
    np.testing.assert_allclose(planned.copper_W, found.copper_W, rtol=1e-9)


def test_blocked_at_full_voltage_the_paper_s_motor_takes_half_a_watt():
    """1.5 (3/4) u_dc^2/R = 0.51 W and 42 mA of the supply at 12 V, all of it heat."""
    angle = np.linspace(0.0, 6.0, 20)
    found = power_of_duties(closed_loop(1.0, angle), angle, np.zeros(20), PAPER)
    assert found.copper_W == pytest.approx(np.full(20, 1.5 * 0.75 * 144.0 / 319.0))
    assert found.copper_W[0] == pytest.approx(0.51, abs=0.005)
    assert found.current_A == pytest.approx((0.0423, 0.0423), abs=2e-4)
    assert found.supply_J == pytest.approx(found.copper_J)


def test_a_shorted_motor_heats_itself_and_takes_nothing():
    speed = np.array([100.0, 400.0])
    found = power_of_duties(np.zeros((2, 3)), np.array([0.3, 2.0]), speed, PAPER)
    np.testing.assert_allclose(found.supply_W, 0.0, atol=1e-15)
    np.testing.assert_allclose(found.copper_W, k_M2(PAPER) * speed**2)
    np.testing.assert_allclose(found.shaft_W, -found.copper_W)


def test_the_electrical_side_is_mujoco_s_motor():
    """Commutated at 90 degrees a delta is a DC motor of K = 2 lambda/sqrt(3) and 8 R/9 (tests/twin/plant)."""
    mujoco = mujoco_with_dcmotor()
    constant = 2.0 / np.sqrt(3.0) * float(PAPER["flux_linkage"])
    resistance = 8.0 / 9.0 * float(PAPER["coil_resistance"])
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco><worldbody><body>
          <inertial pos="0 0 0" mass="1e-3" diaginertia="1e-9 1e-9 1e-9"/>
          <joint name="rotor" type="hinge" axis="0 0 1" armature="3.5e-3"/>
        </body></worldbody><actuator><dcmotor joint="rotor" resistance="{resistance}"
          motorconst="{constant * np.sqrt(MICRO)} {constant * np.sqrt(MICRO)}"/></actuator></mujoco>""")
    data = mujoco.MjData(model)
    for share, speed in ((1.0, 0.0), (0.7, 200.0), (0.2, 500.0), (-0.5, 300.0)):
        data.ctrl[0], data.qvel[0] = share * 12.0 * np.sqrt(MICRO), speed
        mujoco.mj_forward(model, data)
        current_A = data.actuator_force[0] / MICRO / constant
        angle = np.array([0.4])
        duty = closed_loop(abs(share), angle, 0.0 if share > 0 else np.pi)
        found = power_of_duties(duty, angle, np.array([speed]), PAPER)
        assert found.copper_W[0] == pytest.approx(resistance * current_A**2, rel=1e-9)
        assert found.supply_W[0] == pytest.approx(share * 12.0 * current_A, rel=1e-9)


def moved(open_loop, way_deg=8.0):
    """Scope of alpha along a go-to of the twin, and its unit."""
    plane = generate(load_instrument("sdssv"), seed=2, n_positioners=1)
    units = draw_units(plane, 4)
    twin = Twin(plane, units, seed=4, neighbours=False, start_deg=(100.0, 90.0))
    number = int(plane.positioner_id[0])
    if open_loop:
        twin.send([(encode(number, OPEN_LOOP[0]), b"")])
        twin.run(0.01)
    scope = twin.scope(0, 0)
    goal = [round(deg * COUNTS_PER_DEG).to_bytes(4, "little", signed=True) for deg in (100.0 + way_deg, 90.0)]
    twin.send([(encode(number, Command(30)), b"".join(goal))])
    twin.run(1.6)
    return scope.take(), units.plant[0, 0]


@pytest.mark.parametrize("open_loop", [False, True])
def test_what_the_supply_gave_is_heat_friction_and_spring(open_loop):
    """Over a move from rest to rest: electric in = copper + friction + spring; nothing kinetic is left."""
    log, p = moved(open_loop)
    found = power_of_scope(log, p)
    motor, gear = log["motor_rad"], log["gear_rad"]
    turned, geared = np.diff(motor), np.diff(gear)
    rubbed = p["coulomb_motor"] * np.abs(turned).sum() + p["coulomb_gear"] * np.abs(geared).sum()
    rubbed += (p["viscous_motor"] * turned**2 + p["viscous_gear"] * geared**2).sum() / found.period_s
    angle = gear[[0, -1]] / GEAR - p["spring_free"]
    wound = 0.5 * p["spring_rate"] * np.diff(angle**2)[0]
    for order, phase in ((2, "cogging_2"), (4, "cogging_4")):
        wave = np.cos(order * motor[[0, -1]] + p[f"{phase}_phase"])
        wound -= p[phase] / order * np.diff(wave)[0]
    assert log["speed_rad_s"][-1] == 0.0
    # a rotor that turns by 6 degrees a tick is taken in the middle of each
    assert found.supply_J == pytest.approx(found.copper_J + rubbed + wound, rel=0.01)
    assert found.supply_J == pytest.approx(found.copper_J + found.shaft_W.sum() * found.period_s, rel=1e-9)
    assert rubbed > 0.005


def test_an_open_loop_costs_many_times_a_closed_one():
    closed, opened = (power_of_scope(*moved(open_loop)) for open_loop in (False, True))
    # 17 for the same way both up and down (benchmarks/motors.py); upward the spring helps
    assert 10.0 < opened.supply_J / closed.supply_J < 60.0
    assert opened.copper_J / closed.copper_J > 20.0
