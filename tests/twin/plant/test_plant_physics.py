"""What the plant must do whatever its numbers: energy, sticking, backlash, stops, sensors."""

import numpy as np
import pytest
from drives import field
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import field_frequency
from units_of import UNITS, gear_of, nominal, plant

from fiberloom._core import twin as core
from fiberloom.twin.units import GEAR, ORDERS, plain

OFF = np.zeros((1, 1, 3))
MOTOR, MOMENTUM, GEAR_RAD, OUTPUT = range(4)


def torque_ticks(p, fraction, ticks):
    """Log (ticks, 4) of axis 0 driven at 90 degrees with this share of the supply."""
    return p.push(np.full((ticks, 1), float(fraction)))[:, 0]


def full_torque(params):
    return 1.5 * params["flux_linkage"] / params["coil_resistance"] * np.sqrt(0.75) * params["supply"]


# -- energy


def energy_books(params, log, duty):
    """Work of the drive, and where it went, J, over a log of ticks with the duties that made it.

    Inside a tick the field stands, so its work depends on the ends alone; friction on the way.
    """
    p = {k: float(params[k]) for k in params.dtype.names}
    k = p["flux_linkage"] / p["coil_resistance"] * p["supply"]
    u = np.diff(duty[:, 0, [0, 1, 2, 0]], axis=1)  # u_B - u_A, u_C - u_B, u_A - u_C
    shift = np.array([0, 2, -2]) * np.pi / 3
    theta, momentum, gear = log[:, MOTOR], log[:, MOMENTUM], log[:, GEAR_RAD]
    before, after = theta[:-1, None] + shift, theta[1:, None] + shift
    drive = k * float(np.sum(u * (np.sin(after) - np.sin(before))))
    inertia = p["inertia_motor"] + p["inertia_gear"]
    way, gear_way = np.abs(np.diff(theta)), np.abs(np.diff(gear))
    omega = momentum / inertia
    square = 5e-4 * (omega[:-1] ** 2 + omega[:-1] * omega[1:] + omega[1:] ** 2) / 3
    emf = 1.5 * p["flux_linkage"] ** 2 / p["coil_resistance"]
    moved = np.where(gear_way > 0, p["viscous_gear"], 0.0)
    n = p["gear_ratio"]
    spring = 0.5 * p["spring_rate"] * ((gear / n - p["spring_free"]) ** 2)
    cog = -0.5 * p["cogging_2"] * np.cos(2 * theta + p["cogging_2_phase"])
    cog -= 0.25 * p["cogging_4"] * np.cos(4 * theta + p["cogging_4_phase"])
    spent = {
        "kinetic": float(momentum[-1] ** 2 - momentum[0] ** 2) / 2 / inertia,
        "coulomb": p["coulomb_motor"] * way.sum() + p["coulomb_gear"] * gear_way.sum(),
        "viscous": float(np.sum((p["viscous_motor"] + moved) * square)),
        "back_emf": float(emf * square.sum()),
        "spring": float(spring[-1] - spring[0]),
        "cogging": float(cog[-1] - cog[0]),
    }
    return drive, spent


def test_energy_in_is_energy_out():
    # an open loop move of ten motor turns to and fro through the gap, from rest to nearly rest
    params = UNITS.plant[0, 0]
    angle = 2 * np.pi * 5 * (1 - np.cos(np.linspace(0, 2 * np.pi, 1200)))
    p = plant(params, UNITS.gear[0, 0], 2.0)
    start = p.state(0)
    duty = np.rint(4000 * field(1.0, angle[:, None] + start[MOTOR])) / 4000
    log = np.vstack([start, p.run(duty)[0][:, 0]])
    drive, spent = energy_books(params, log, duty)
    # the inelastic impacts at both ends of the gap take J_gear/J of the rotor's energy; the ticks
    # in which friction turns are summed by their ends: half a percent
    assert sum(spent.values()) == pytest.approx(drive, rel=0.01)
    assert spent["coulomb"] > 0.05 * drive
    assert spent["back_emf"] > 0.3 * drive


def test_cogging_is_conservative():
    """Eq. 10: a rotor that coasts through whole turns without friction keeps its energy."""
    params = nominal(coulomb_motor=0, viscous_motor=0, flux_linkage=1e-6, coil_resistance=1e3)
    p = plant(params, gear_of(20000.0), 0.0)
    p.set_state(0, 1.0, 3.4e-9 * 200, 0.0)
    log = p.run(np.zeros((600, 1, 3)))[0][:, 0]
    theta = log[:, MOTOR]
    assert np.ptp(theta) > 8 * 2 * np.pi
    cog = -0.5 * params["cogging_2"] * np.cos(2 * theta) - 0.25 * params["cogging_4"] * np.cos(4 * theta)
    energy = log[:, MOMENTUM] ** 2 / 2 / params["inertia_motor"] + cog
    # the step's own oscillation of the energy, no drift
    assert np.ptp(energy) < 2e-3 * energy.mean()
    assert abs(energy[-50:].mean() - energy[:50].mean()) < 1e-4 * energy.mean()


def test_free_rotor_swings_in_the_field_at_root_k_over_j():
    params = nominal(
        coulomb_motor=0,
        viscous_motor=0,
        cogging_2=0,
        cogging_4=0,
        flux_linkage=1e-4,
        coil_resistance=1e-4 / 3.23e-5,
    )
    p = plant(params, gear_of(300.0), 0.0)
    p.set_state(0, 2.55, 0.0, 0.0)
    theta = p.run(field(1.0, np.full((4000, 1), 2.5)))[0][:, 0, MOTOR] - 2.5
    crossings = np.flatnonzero(np.diff(np.sign(theta)))
    fine = crossings + theta[crossings] / (theta[crossings] - theta[crossings + 1])
    omega = np.pi / np.diff(fine).mean() / 5e-4
    assert omega == pytest.approx(field_frequency(params), rel=1e-3)  # amplitude^2/16 = 2e-4


def test_stall_torque_is_eq_19():
    """Full voltage at 90 degrees, from rest: the first momentum is net torque times time."""
    params = nominal(cogging_2=0, cogging_4=0)
    p = plant(params, gear_of(), 0.0)
    p.set_state(0, 0.5, 0.0, 0.0)
    kick = torque_ticks(p, 1.0, 1)[0, MOMENTUM]
    drag = 1.5 * params["flux_linkage"] ** 2 / params["coil_resistance"] + params["viscous_motor"]
    rate = drag / params["inertia_motor"]
    net = full_torque(params) - params["coulomb_motor"]
    # the rotor turns by 0.02 rad: cos(0.02) is within 2e-4 of one
    assert kick == pytest.approx(net * (1 - np.exp(-rate * 5e-4)) / rate, rel=1e-3)


# -- friction


@given(share=st.floats(-0.95, 0.95), turn=st.floats(0.0, 6.28))
@settings(max_examples=30, deadline=None)
def test_no_creep_below_coulomb(share, turn):
    """A torque below the break-away torque moves nothing, ever: not a bit."""
    params = nominal(cogging_2=0, cogging_4=0, pwm_steps=1e6)
    p = plant(params, gear_of(0.0), 1.0)
    theta = p.state(0)[MOTOR] + turn
    p.set_state(0, theta, 0.0, theta)
    spring = params["spring_rate"] / GEAR * (params["spring_free"] - theta / GEAR)
    limit = params["coulomb_motor"] + params["coulomb_gear"] - np.copysign(spring, share)
    log = torque_ticks(p, share * limit / full_torque(params), 200)
    assert (log[:, MOTOR] == theta).all()
    assert (log[:, MOMENTUM] == 0.0).all()


@pytest.mark.parametrize("direction", [-1, 1])
def test_break_away_torque(direction):
    """Eq. 9 without cogging: Coulomb and spring, and the negative direction is the harder one."""
    params = nominal(cogging_2=0, cogging_4=0, pwm_steps=1e6)
    p = plant(params, gear_of(0.0), 0.5)
    spring = params["spring_rate"] / GEAR * (params["spring_free"] - 0.5)
    expected = params["coulomb_motor"] + params["coulomb_gear"] - direction * spring
    start = p.state(0)[MOTOR]
    for torque in np.arange(0.9, 1.1, 0.002) * expected:
        if torque_ticks(p, direction * torque / full_torque(params), 2)[-1, MOTOR] != start:
            break
    assert torque == pytest.approx(expected, rel=0.004)


def test_speed_follows_torque_linearly():
    """Fig. 12b: at constant speed the torque beyond Coulomb is drag times speed."""
    params = nominal(cogging_2=0, cogging_4=0, spring_rate=0, pwm_steps=1e6)
    drag = 1.5 * params["flux_linkage"] ** 2 / params["coil_resistance"]
    drag += params["viscous_motor"] + params["viscous_gear"]
    for fraction in (0.15, 0.3, 0.6):
        p = plant(params, gear_of(), 1.0)
        log = torque_ticks(p, fraction, 300)
        omega = np.diff(log[-21:, MOTOR]).mean() / 5e-4
        # the field stands still for a tick in which the rotor turns: mean of cos over that angle
        held = np.sin(omega * 5e-4) / (omega * 5e-4)
        torque = fraction * full_torque(params) * held
        coulomb = params["coulomb_motor"] + params["coulomb_gear"]
        assert omega == pytest.approx((torque - coulomb) / drag, rel=2e-3)


def test_acceleration_of_figure_14():
    """Kronig 2020, Fig. 14: from 600 to 5600 rpm in about 15 ms for a step from 70 to 490 uNm."""
    p = plant(nominal(), gear_of(), 1.0)
    full = full_torque(nominal())
    torque_ticks(p, 70e-6 / full, 400)
    log = torque_ticks(p, 490e-6 / full, 120)
    rpm = log[:, MOMENTUM] / 3.5e-9 * 60 / 2 / np.pi
    assert rpm[0] < 1500
    reached = np.flatnonzero(rpm > 5000)[0] * 0.5
    assert 8 < reached < 25  # ms; 5600 rpm is where the curve flattens


# -- backlash


def test_gear_stays_in_the_gap_whatever_pulls_at_it():
    p = plant(nominal(), gear_of(200.0), 1.0)
    gear = p.state(0)[GEAR_RAD]
    p.set_state(0, gear + 1.5, 0.0, gear)
    for torque in (0.015, -0.015):
        p.set_external_torque(0, torque)
        log = p.run(np.zeros((200, 1, 3)))[0][:, 0]
        assert (log[:, GEAR_RAD] == gear).all()
        # Eq. 5a: the arm gives way by T/k, and comes back
        assert log[-1, OUTPUT] - 1.0 == pytest.approx(torque / nominal()["stiffness"], rel=1e-6)
    p.set_external_torque(0, 0.0)
    assert p.state(0)[OUTPUT] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("axis", [0, 1])
def test_contact_puts_the_arm_where_t_minus_and_b_say(axis):
    """Eq. 3b, sign corrected, and Eq. 6: after moving up the rotor is B ahead of the gear."""
    row = 3
    params, gear = UNITS.plant[row, axis], UNITS.gear[row, axis]
    p = plant(params, gear, 1.0)
    for fraction in (0.3, -0.35, 0.25):
        torque_ticks(p, fraction, 800)
        theta, _, gear_rad, output = p.state(0)
        t_minus, backlash = core.transmission(plain(gear).ravel(), GEAR, np.array([output]))
        assert t_minus[0] == pytest.approx(gear_rad, abs=1e-9)
        assert theta - gear_rad == pytest.approx(backlash[0] if fraction > 0 else 0.0, abs=1e-9)


def test_the_gear_is_where_it_is_by_whatever_way():
    """Truth does not depend on history: fast, slow, past and back, the same rotor angle."""
    params, gear = UNITS.plant[1, 0], UNITS.gear[1, 0]
    target = None
    found = []
    for start in (0.8, 1.0, 1.3):
        p = plant(params, gear, start)
        if target is None:
            torque_ticks(p, 0.3, 3000)
            target = p.state(0)[MOTOR]
        p.set_state(0, target, 0.0, p.state(0)[GEAR_RAD])
        p.run(np.zeros((1, 1, 3)))  # whatever the gap was, it is closed now
        p.run(np.zeros((1, 1, 3)))
        found.append(p.state(0)[OUTPUT])
    backlash = p.backlash_rad(0) / GEAR
    # from below the arm is B/n behind where it is from above
    assert found[0] == pytest.approx(found[1], abs=1e-12)
    assert found[2] - found[0] == pytest.approx(backlash, rel=0.15)  # the slope of delta


@given(output=st.floats(-0.05, 6.3), row=st.integers(0, 6), axis=st.integers(0, 1))
def test_transmission_rises_and_is_its_own_inverse(output, row, axis):
    theta = output + np.linspace(0, 0.01, 30)
    gear, backlash = core.transmission(plain(UNITS.gear[row, axis]).ravel(), GEAR, theta)
    assert (np.diff(gear) > 0).all()
    assert (np.diff(gear + backlash) > 0).all()
    p = plant(UNITS.plant[row, axis], UNITS.gear[row, axis], np.clip(output, -0.06, 6.3))
    assert p.state(0)[OUTPUT] == pytest.approx(np.clip(output, -0.06, 6.3), abs=1e-12)


def test_delta_is_recovered_by_driving_both_ways():
    """Eq. 7: rotor angles at output angles, driven slowly up and down, give delta and B."""
    params, gear = UNITS.plant[2, 0], UNITS.gear[2, 0]
    p = plant(params, gear, 1.0)
    logs = [torque_ticks(p, f, 4000) for f in (0.15, -0.18)]
    row = plain(gear).ravel()
    for log, share in zip(logs, (1.0, 0.0), strict=True):
        moving = log[500:][np.abs(np.diff(log[499:, GEAR_RAD])) > 0]
        t_minus, backlash = core.transmission(row, GEAR, np.ascontiguousarray(moving[:, OUTPUT]))
        assert len(moving) > 1000
        np.testing.assert_allclose(moving[:, MOTOR], t_minus + share * backlash, atol=1e-9)
        assert np.ptp(t_minus / GEAR - moving[:, OUTPUT]) > 1e-4  # there is something to recover


# -- stops and sensors


@pytest.mark.parametrize(("fraction", "stop"), [(1.0, "stop_max"), (-1.0, "stop_min")])
def test_hard_stop_holds_the_full_motor(fraction, stop):
    params = nominal(pwm_steps=1e6)
    p = plant(params, gear_of(100.0), params[stop] - np.sign(fraction) * 0.02)
    log = torque_ticks(p, fraction, 1500)
    pressed = (full_torque(params) - 3e-5) * GEAR
    beyond = np.sign(fraction) * (log[-1, OUTPUT] - params[stop])
    assert abs(log[-1, MOMENTUM]) < 1e-10  # 0.03 rad/s, creeping to the end
    # what the stop itself gives way under the motor; the arm is where the stop is
    assert 0.5 * pressed / params["stop_stiffness"] < beyond < 1.2 * pressed / params["stop_stiffness"]


def test_hall_channels():
    params = nominal(
        hall_offset_a=2000,
        hall_offset_b=2100,
        hall_amplitude_a=1400,
        hall_amplitude_b=1300,
        hall_phase=0.05,
        hall_noise=4.0,
    )
    p = plant(params, gear_of(3000.0), 0.0, seed=3)
    counts, angles = [], np.linspace(0, 12.0, 700)
    for theta in angles:
        p.set_state(0, theta, 0.0, 0.0)
        counts.append(p.run(OFF)[1][0, 0])
    a, b = np.array(counts, float).T
    noise_a, noise_b = a - 2000 - 1400 * np.sin(angles), b - 2100 - 1300 * np.cos(angles + 0.05)
    for noise in (noise_a, noise_b):
        assert abs(noise.mean()) < 0.6  # 4 sigma of 4 counts over 700 samples
        assert noise.std() == pytest.approx(np.hypot(4.0, 0.29), rel=0.11)
    assert abs(np.corrcoef(noise_a, noise_b)[0, 1]) < 0.15


def test_hall_counts_stay_in_twelve_bits():
    params = nominal(hall_amplitude_a=2047, hall_offset_a=3000, hall_offset_b=100, hall_noise=200)
    p = plant(params, gear_of(3000.0), 0.0)
    seen = []
    for theta in np.linspace(0, 6.28, 60):
        p.set_state(0, theta, 0.0, 0.0)
        seen.append(p.run(OFF)[1].ravel())
    assert (np.min(seen), np.max(seen)) == (0, 4095)


# -- bits


def random_run(kernel, seed=4, **steps):
    rng = np.random.default_rng(2)
    params, gears = UNITS.plant.ravel(), UNITS.gear.ravel()
    p = plant(params, gears, rng.uniform(0.1, 3.0, 14), seed=seed, kernel=kernel, **steps)
    angle = np.cumsum(rng.uniform(-0.2, 0.35, (400, 14)), axis=0)
    log, hall = p.run(field(rng.uniform(0, 1.2, (400, 14, 1)), angle))
    return log.tobytes() + hall.tobytes()


@pytest.mark.parametrize("steps", [{}, {"substeps": (10, 2)}])
def test_every_kernel_gives_the_same_bytes(steps):
    runs = {name: random_run(name, **steps) for name in core.KERNELS}
    assert len(set(runs.values())) == 1, list(runs)


def test_longer_steps_are_other_bytes_and_as_many_steps_are_none():
    assert random_run("", substeps=(10, 2)) != random_run("")
    assert random_run("", substeps=10) == random_run("")


def driven(companions, kernel, **steps):
    """16 positioners, the even ones driven up and down with ramps and stops, the odd ones as told."""
    ticks = np.arange(1200)
    speed = 0.1 * np.clip(np.sin(2 * np.pi * ticks / 400) * 3, -1, 1)
    ways = {"alike": np.cumsum(speed), "to and fro": 3.0 * np.sin(ticks / 9), "at rest": np.zeros(1200)}
    angle = np.repeat(np.stack([np.cumsum(speed), ways[companions]], axis=1), 2, axis=1)
    rows = np.arange(16) % len(UNITS)
    params, gears = UNITS.plant[rows].ravel(), UNITS.gear[rows].ravel()
    axes = plant(params, gears, np.full(32, 1.0), seed=3, kernel=kernel, **steps)
    log, hall = axes.run(field(1.0, np.tile(angle, 8)))
    even = np.arange(32) % 4 < 2
    return log[:, even], hall[:, even]


@pytest.mark.parametrize("kernel", core.KERNELS)
@pytest.mark.parametrize("steps", [{}, {"substeps": (10, 2)}])
def test_what_an_axis_does_is_its_own(kernel, steps):
    """Axes that push their gears are stepped by shorter code, or in longer steps, than any that has to find
    contacts."""
    log, hall = driven("alike", kernel, **steps)
    assert np.ptp(log[..., GEAR_RAD], axis=0).min() > 5.0
    for companions in ("to and fro", "at rest"):
        other, other_hall = driven(companions, kernel, **steps)
        assert (other == log).all()
        assert (other_hall == hall).all()


def waiting(companions, kernel, **steps):
    """16 positioners: the odd ones push a way, then wait in a field that hardly changes, and push again."""
    ticks = np.arange(1200)
    ways = {"push": 0.1 * ticks, "to and fro": 3.0 * np.sin(ticks / 9)}
    waits = 0.1 * np.cumsum(ticks % 400 < 150)
    angle = np.repeat(np.stack([ways[companions], waits], axis=1), 2, axis=1)
    strength = np.repeat(np.stack([np.ones(1200), 1.0 + 0.01 * np.sin(ticks)], axis=1), 2, axis=1)
    rows = np.arange(16) % len(UNITS)
    params, gears = UNITS.plant[rows].ravel(), UNITS.gear[rows].ravel()
    axes = plant(params, gears, np.full(32, 1.0), seed=3, kernel=kernel, **steps)
    log, hall = axes.run(field(np.tile(strength, 8)[..., None], np.tile(angle, 8)))
    odd = np.arange(32) % 4 >= 2
    return log[:, odd], hall[:, odd]


@pytest.mark.parametrize("kernel", core.KERNELS)
@pytest.mark.parametrize("steps", [{}, {"substeps": (10, 2)}])
def test_an_axis_that_friction_holds_is_where_every_kick_would_leave_it(kernel, steps):
    """Among axes that push their gears it is not looked for in every step, among others it is."""
    log, hall = waiting("push", kernel, **steps)
    at_rest = np.diff(log[..., MOTOR], axis=0) == 0.0
    assert 0.3 < at_rest.mean() < 0.9
    other, other_hall = waiting("to and fro", kernel, **steps)
    assert (other == log).all()
    assert (other_hall == hall).all()


def test_same_seed_same_bytes_other_seed_other_noise():
    assert random_run("") == random_run("")
    assert random_run("") != random_run("", seed=5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inertia_motor": 0.0}, "axis 0: inertia_motor"),
        ({"stop_min": 3.0, "stop_max": 2.0}, "stop_min must be below"),
        ({"supply": float("nan")}, "supply"),
    ],
)
def test_bad_parameters_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        plant(nominal(**change), gear_of(), 0.0)


def test_bad_gears_are_refused():
    for delta, backlash, message in ((0.02, 0.0, "falls faster"), (0.0, 9.0, "negative")):
        record = gear_of(140.0)
        record["delta_rad"][np.isin(ORDERS, (36, 204)), 0] = delta
        record["backlash_rad"][0, 0] = backlash
        with pytest.raises(ValueError, match=message):
            plant(nominal(), record, 0.0)
    with pytest.raises(ValueError, match="beyond the hard stops"):
        plant(nominal(), gear_of(), 7.0)
    with pytest.raises(ValueError, match="this machine has"):
        plant(nominal(), gear_of(), 0.0, kernel="abacus")
