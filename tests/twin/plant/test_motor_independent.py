"""The motor model against scipy, with what it leaves out; the order of the integrator; energy of a move."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_plant_physics import MOMENTUM, MOTOR, energy_books, field, plant
from units_of import gear_of, nominal
from wire import goto

from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Twin, draw_units

TICK_S = 5e-4
SHIFT = np.array([0.0, 2.0, -2.0]) * np.pi / 3
INDUCTANCE_H = 1e-3
"""Of a coil: an ironless winding of some hundred ohms; L/R = 3 us. Assumed, the twin has none."""


def coil_by_coil(params, share, ticks, inductance_H):
    """Speed of a free rotor at tick ends, Eq. 14 to 16 with self-inductance, three currents as states."""
    p = {name: float(params[name]) for name in params.dtype.names}
    drag = p["viscous_motor"]

    def slope(t, y, volts):
        theta, omega, *current = y
        emf = p["flux_linkage"] * omega * np.cos(theta + SHIFT)
        current = np.array(current)
        torque = p["flux_linkage"] * current @ np.cos(theta + SHIFT)
        net = torque - drag * omega - p["coulomb_motor"]  # it turns upward all the time
        return [
            omega,
            net / p["inertia_motor"],
            *((volts - p["coil_resistance"] * current - emf) / inductance_H),
        ]

    state, out = np.array([0.5, 0.0, 0.0, 0.0, 0.0]), []
    for _ in range(ticks):
        a, b, c = p["supply"] * field(share, np.array([state[0] + np.pi / 2]))[0]
        volts = np.array([b - a, c - b, a - c])
        found = solve_ivp(slope, (0.0, TICK_S), state, "Radau", args=(volts,), rtol=1e-8, atol=1e-10)
        state = found.y[:, -1]
        out.append(state[1])
    return np.array(out)


def without_cogging(**more):
    return nominal(cogging_2=0.0, cogging_4=0.0, pwm_steps=1e6, **more)


def free_rotor(params, share, ticks, substeps=10):
    ours = plant(params, gear_of(30000.0), 0.0, substeps=substeps)
    ours.set_state(0, 0.5, 0.0, 0.0)
    return ours.push(np.full((ticks, 1), share))[:, 0, MOMENTUM] / float(params["inertia_motor"])


def test_neglecting_the_inductance():
    """Eq. 17: the speed of a motor with L/R = 3 us lags the twin's by about that, 1e-3 of the rise."""
    params = without_cogging()
    mine, theirs = free_rotor(params, 0.8, 14), coil_by_coil(params, 0.8, 14, INDUCTANCE_H)
    assert mine[-1] > 300.0
    lag_s = (mine[4:12] - theirs[4:12]) / np.gradient(mine, TICK_S)[4:12]
    assert (np.abs(lag_s) < 2.0 * INDUCTANCE_H / params["coil_resistance"] + 2e-6).all()
    # a current that lags by 3 us turns by 0.1 deg less than the rotor at 600 rad/s: nothing in the end
    assert mine[-1] == pytest.approx(theirs[-1], rel=2e-3)


def test_without_inductance_the_coils_are_the_twins():
    """The same equations with L -> 0 (a fiftieth): only the integrator is left."""
    params = without_cogging()
    mine, theirs = free_rotor(params, 0.6, 8), coil_by_coil(params, 0.6, 8, INDUCTANCE_H / 50)
    np.testing.assert_allclose(mine, theirs, rtol=5e-4, atol=0.05)


def test_second_order_with_drag():
    """Back-EMF and viscous drag at speed: half the step, a quarter of the error, against the exact curve."""
    params = without_cogging(coulomb_motor=0.0)
    p = {name: float(params[name]) for name in params.dtype.names}
    drag = 1.5 * p["flux_linkage"] ** 2 / p["coil_resistance"] + p["viscous_motor"]
    rate, omega = drag / p["inertia_motor"], 500.0
    errors = []
    for substeps in (1, 2, 4):  # finer steps end at the rounding of single precision
        ours = plant(params, gear_of(30000.0), 0.0, substeps=substeps)
        ours.set_state(0, 0.5, omega * p["inertia_motor"], 0.0)
        log = ours.run(np.zeros((8, 1, 3)))[0][:, 0, MOMENTUM] / p["inertia_motor"]
        exact = omega * np.exp(-rate * TICK_S * np.arange(1, 9))
        errors.append(np.abs(log - exact).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    assert ((ratios > 3.6) & (ratios < 4.4)).all(), errors


def test_energy_of_a_move_of_the_firmware():
    """A go-to of 40 motor turns and back: what the bridges gave is heat, springs, cogging and motion."""
    plane = generate(load_instrument("sdssv"), seed=2, n_positioners=1)
    units = draw_units(plane, 3)
    units.plant["seat_rms"] = 0.0
    twin = Twin(plane, units, seed=1, threads=1, neighbours=False, start_deg=(60.0, 60.0))
    home = [units.transmission(0, axis, 60.0)[0][0] for axis in (0, 1)]
    number = int(plane.positioner_id[0])
    with twin.scope(0, 0) as scope:
        for target_deg in (74.0, 60.0):
            goto(twin, number, home[0] + target_deg - 60.0, home[1])
            twin.run(2.5)
        log = scope.take()
    params = units.plant[0, 0]
    inertia = float(params["inertia_motor"] + params["inertia_gear"])
    states = np.column_stack([log["motor_rad"], log["speed_rad_s"] * inertia, log["gear_rad"]])
    duty = np.column_stack([log["duty_a"], log["duty_b"], log["duty_c"]])
    steps = float(params["pwm_steps"])
    applied = np.rint(steps * np.clip(duty, 0.0, 1.0)) / steps
    drive, spent = energy_books(params, states, applied[:-1, None])
    # ticks in which friction turns are summed by their ends, impacts take J_gear/J of the rotor's energy
    assert sum(spent.values()) == pytest.approx(drive, rel=0.01)
    assert abs(spent["kinetic"]) < 1e-3 * drive  # from rest to rest
    assert abs(spent["spring"]) < 0.01 * drive  # there and back again
    assert spent["back_emf"] > 0.3 * drive
    assert np.ptp(states[:, MOTOR]) > 2 * np.pi * 39
