"""A rotor that coasts: without current there is no back-EMF, in a closed bridge there always is."""

import numpy as np
import pytest
from units_of import gear_of, nominal, plant

TICK_S = 5e-4
MOTOR, MOMENTUM = 0, 1
OFF = np.zeros((1, 1, 3))


def alone(speed_rad_s, **changes):
    """The rotor in the middle of a gap that it does not cross, turning; and its parameters."""
    params = nominal(**changes)
    ours = plant(params, gear_of(60000.0), 1.0)
    ours.set_state(0, 500.0, speed_rad_s * float(params["inertia_motor"]), 0.0)
    return ours, params


def coast(ours, ticks, *, open_, duty=OFF):
    """Momenta (ticks,) at the ends of ticks; the bridge is told each time, as the firmware does."""
    out = []
    for _ in range(ticks):
        ours.set_open(0, open_)
        out.append(float(ours.run(duty)[0][0, 0, MOMENTUM]))
    return np.array(out)


BARE = {"coulomb_motor": 0.0, "viscous_motor": 0.0, "cogging_2": 0.0, "cogging_4": 0.0}


def back_emf(params):
    """(3/2) lambda^2/R, Nm s/rad."""
    return float(1.5 * params["flux_linkage"] ** 2 / params["coil_resistance"])


def test_nothing_slows_a_rotor_without_friction_whose_bridge_is_open():
    ours, params = alone(500.0, **BARE)
    start = 500.0 * params["inertia_motor"]
    # momenta are kept in single precision
    np.testing.assert_allclose(coast(ours, 60, open_=True), start, rtol=1e-6)
    # shorted it decays by (3/2) lambda^2/(R J) = 147 /s
    rate = back_emf(params) / params["inertia_motor"]
    expected = start * np.exp(-rate * TICK_S * np.arange(1, 61))
    np.testing.assert_allclose(coast(ours, 60, open_=False), expected, rtol=1e-4)


def test_duties_drive_nothing_through_an_open_bridge():
    ours, params = alone(300.0, **BARE)
    full = np.array([[[1.0, 0.0, 0.5]]])
    start = 300.0 * params["inertia_motor"]
    np.testing.assert_allclose(coast(ours, 20, open_=True, duty=full), start, rtol=1e-6)
    assert abs(coast(ours, 20, open_=False, duty=full)[-1] / start - 1.0) > 0.01


def test_viscous_and_coulomb_friction_are_what_is_left():
    """p' = -c - (d/J) p in closed form."""
    ours, params = alone(400.0, cogging_2=0.0, cogging_4=0.0, viscous_motor=3e-7, coulomb_motor=5e-6)
    c, rate = 5e-6, 3e-7 / params["inertia_motor"]
    start = 400.0 * params["inertia_motor"]
    t = TICK_S * np.arange(1, 41)
    expected = (start + c / rate) * np.exp(-rate * t) - c / rate
    np.testing.assert_allclose(coast(ours, 40, open_=True), expected, rtol=1e-4)


@pytest.mark.parametrize(("share_of_supply", "floats"), [(0.98, True), (1.02, False)])
def test_above_the_supply_the_diodes_conduct(share_of_supply, floats):
    """Line EMF lambda omega against u_dc: beyond it an open bridge brakes as a closed one."""
    params = nominal()
    speed = share_of_supply * float(params["supply"] / params["flux_linkage"])
    first, other = (alone(speed, **BARE)[0] for _ in range(2))
    one, closed = coast(first, 1, open_=True)[0], coast(other, 1, open_=False)[0]
    start = speed * params["inertia_motor"]
    assert (one == pytest.approx(start, rel=1e-6)) == floats
    assert (one == closed) != floats


def test_no_rotor_that_sines_drive_comes_near_the_supply():
    """Without any friction, at full voltage for 0.2 s: lambda omega ends below (sqrt(3)/2) u_dc."""
    ours, params = alone(0.0, **BARE)
    momentum = ours.push(np.ones((400, 1)))[-1, 0, MOMENTUM]
    emf_V = params["flux_linkage"] * momentum / params["inertia_motor"]
    assert 0.8 * params["supply"] < emf_V <= np.sqrt(0.75) * params["supply"] * (1.0 + 1e-6)


def test_what_the_shorted_coils_take_is_the_back_emf():
    """Energy: from one speed, the difference of the losses is the integral of (3/2)(lambda^2/R) w^2."""
    books = []
    for open_ in (True, False):
        ours, params = alone(500.0, cogging_2=0.0, cogging_4=0.0)
        p = np.r_[500.0 * params["inertia_motor"], coast(ours, 30, open_=open_)]
        omega = p / params["inertia_motor"]
        square = TICK_S * np.sum(omega[:-1] ** 2 + omega[:-1] * omega[1:] + omega[1:] ** 2) / 3
        way = np.sum(0.5 * (omega[1:] + omega[:-1])) * TICK_S
        lost = 0.5 * params["inertia_motor"] * (omega[0] ** 2 - omega[-1] ** 2)
        rubbed = params["coulomb_motor"] * way + params["viscous_motor"] * square
        books.append((lost - rubbed) / (back_emf(params) * square))
    # straight lines through ticks: 1e-3 of a decay by 7 % a tick
    assert books == pytest.approx([0.0, 1.0], abs=2e-3)
