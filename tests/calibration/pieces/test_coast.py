"""Back-EMF and friction apart: a rotor of the formula, and units of the twin over the bus alone."""

import asyncio
import dataclasses

import numpy as np
import pytest

from fiberloom._core import firmware as fw
from fiberloom.bus import Client
from fiberloom.bus.transport import Frame
from fiberloom.calibration import CoastData, CoastSettings, Estimate, identify_coast, measure_coast
from fiberloom.calibration.bench.coast import _whitened
from fiberloom.calibration.bench.inertia import summed
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Twin, TwinTransport, draw_units
from fiberloom.twin.truth import true_values

J, VISCOUS, BACK_EMF, COULOMB, SPRING, COGGING, PHASE = 3.5e-9, 3e-7, 5e-7, 2e-5, -8e-6, 1e-5, 0.7
FULL_NM, TICK_S, SPIN = 5.05e-4, 5e-4, 100
NOISE_DEG = 0.115
"""Of the hall sensors: 3 counts of 1500."""


def inertia(n, value=J, relative_error=0.003, reason=""):
    """What the pushes found."""
    ones = np.ones(n)
    return Estimate(
        "alpha inertia", "kg m^2", value * ones, relative_error * value * ones, np.full(n, 100),
        np.zeros((n, 1)), "motor deg", (reason,) * n,
    )  # fmt: skip


def one_coast(opened, voltage, start_rad, back_emf=BACK_EMF):
    """Motor deg (260,) at the starts of ticks: the formula by steps of 10 us (midpoint)."""
    theta, omega, side, dt, way = start_rad, 0.0, np.sign(voltage), TICK_S / 50, []
    for tick in range(260):
        coasts = tick >= SPIN
        drag = VISCOUS + (0.0 if coasts and opened else back_emf)
        drive = 0.0 if coasts else voltage * FULL_NM * np.sinc(omega * TICK_S / 2 / np.pi)
        way.append(theta)
        for _ in range(50):

            def rate(at, speed, drag=drag, drive=drive, side=side):
                load = drag * speed + COULOMB * side + SPRING + COGGING * np.sin(2 * at + PHASE)
                return (drive - load) / J

            middle = omega + 0.5 * dt * rate(theta, omega)
            theta, omega = (
                theta + dt * middle,
                omega + dt * rate(theta + 0.5 * dt * omega, middle),
            )
            if coasts and omega * side < 0.0:
                omega = 0.0
    return np.rad2deg(way)


def coasts(**changes):
    """Eight coasts of one rotor without noise, in a row that two positioners share."""
    how = [(k % 4 < 2, (0.97, 0.35)[k // 4] * (1, -1)[k % 2]) for k in range(8)]
    motor = np.array([one_coast(o, v, 2.4 * k, **changes) for k, (o, v) in enumerate(how)])
    voltage = np.array([[v] * SPIN + [0.0] * 160 for _, v in how])
    motor, voltage = (np.broadcast_to(a, (2, *a.shape)).copy() for a in (motor, voltage))
    return CoastData(0, np.array([o for o, _ in how]), voltage, motor, np.zeros((2, 8)), [""] * 2)


@pytest.fixture(scope="module")
def exact():
    return coasts()


def test_each_term_comes_back_from_a_rotor_of_the_formula(exact):
    found = identify_coast(exact, inertia(2))
    truths = (BACK_EMF / J, VISCOUS / J, COULOMB / J, 1e6 * BACK_EMF, 1e6 * VISCOUS)
    for e, true in zip(found.estimates, truths, strict=True):
        # the formula's own steps, and cogging as trapezes of half a ms
        np.testing.assert_allclose(e.value, true, rtol=1e-3, err_msg=e.name)


def test_ratios_need_no_inertia_and_torques_carry_its_error(exact):
    found = identify_coast(exact, inertia(2, 2.0 * J, 0.05))
    again = identify_coast(exact, inertia(2))
    np.testing.assert_array_equal(found.back_emf_rate.value, again.back_emf_rate.value)
    np.testing.assert_allclose(found.back_emf.value, 2.0 * again.back_emf.value)
    np.testing.assert_allclose(found.viscous.standard_error, 0.05 * found.viscous.value, rtol=1e-3)
    refused = identify_coast(exact, dataclasses.replace(inertia(2), reason=("", "was not pushed")))
    assert refused.back_emf.reason == ("", "was not pushed")
    assert refused.back_emf_rate.ok.all()


def test_its_errors_are_those_of_the_sensor(exact):
    rng = np.random.default_rng(4)
    rows = np.repeat(exact.motor_deg[:1], 200, axis=0)
    data = dataclasses.replace(
        exact,
        motor_deg=rows + rng.normal(0.0, NOISE_DEG, rows.shape),
        voltage=np.repeat(exact.voltage[:1], 200, axis=0),
        zero_deg=np.zeros((200, 8)),
        trouble=[""] * 200,
    )
    found = identify_coast(data, inertia(200))
    for e, true in zip(found.estimates[:3], (BACK_EMF / J, VISCOUS / J, COULOMB / J), strict=True):
        pull = (e.value - true) / e.standard_error
        # 200 draws tell a scatter to 5 percent, a mean to 0.07 of an error: three times that
        assert 0.85 < pull.std() < 1.15, e.name
        assert abs(pull.mean()) < 0.21, e.name


def test_an_error_of_the_sensor_comes_out_of_the_equation_as_it_went_in():
    """It stands there as it is and once integrated with the drag."""
    error = np.random.default_rng(2).normal(size=(1, 2, 50, 1))
    drag = np.array([[86.0, 229.0]])
    integrated = summed(error[..., 0], TICK_S)[..., None]
    found = _whitened(error + drag[..., None, None] * integrated, drag, TICK_S)
    np.testing.assert_allclose(found, error, atol=1e-12)


def without(data, which):
    """Without the coasts of which."""
    data = dataclasses.replace(data, motor_deg=data.motor_deg.copy(), voltage=data.voltage.copy())
    data.motor_deg[:, which], data.voltage[:, which] = np.nan, np.nan
    return data


STILL = {"motor_deg": np.zeros((2, 8, 260))}


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (lambda d: without(d, d.open_bridge), "did not coast both with the bridge open and shorted"),
        (lambda d: without(d, ~d.open_bridge), "did not coast both with the bridge open and shorted"),
        (lambda d: without(d, d.voltage[0, :, 0] > 0), "in one direction only"),
        (lambda d: without(d, np.abs(d.voltage[0, :, 0]) > 0.5), "coasted from|do not tell|coast both"),
        (lambda d: dataclasses.replace(d, **STILL), "did not turn when it was spun up"),
        (lambda d: dataclasses.replace(d, open_bridge=~d.open_bridge), "as much with its bridge open"),
        (lambda d: dataclasses.replace(d, trouble=["timed out"] * 2), "timed out"),
    ],
)
def test_coasts_that_tell_nothing_are_refused(exact, broken, words):
    with pytest.raises(InputError, match=words):
        identify_coast(broken(exact), inertia(2))


def test_a_board_that_stays_shorted_is_found_out():
    """It accepts the frame, and brakes: then there is no difference to see."""
    shorted = coasts()
    opened = np.flatnonzero(shorted.open_bridge)
    noise = np.random.default_rng(1).normal(0.0, NOISE_DEG, shorted.motor_deg.shape)
    shorted.motor_deg[:, opened] = shorted.motor_deg[:, opened + 2]
    with pytest.raises(InputError, match="does the board open it"):
        identify_coast(dataclasses.replace(shorted, motor_deg=shorted.motor_deg + noise), inertia(2))


# -- the twin


def measured(n, seed, transport=TwinTransport, **settings):
    """Data of both axes, the truth by name, and the true inertias as estimates."""
    plane = generate(load_instrument("sdssv"), seed=seed, n_positioners=n)
    units = draw_units(plane, seed)
    twin = Twin(plane, units, seed=seed, threads=1, neighbours=False)

    async def work():
        client = Client(transport(twin))
        await client.discover()
        return await measure_coast(client, None, plane, CoastSettings(**settings))

    return asyncio.run(work()), true_values(plane, units)


@pytest.fixture(scope="module")
def found():
    data, truth = measured(30, 7)
    # with the true inertia: what is off is the coast's own
    both = [
        identify_coast(d, inertia(30, truth[f"{axis} inertia"], 1e-6))
        for d, axis in zip(data, ("alpha", "beta"), strict=True)
    ]
    return [e for one in both for e in one.estimates], truth


def test_the_split_of_thirty_units_is_found_as_well_as_it_says(found):
    estimates, truth = found
    names = {e.name.partition(" ")[2].removesuffix(" over inertia") for e in estimates}
    assert names == {"back-EMF drag", "viscous friction", "Coulomb friction"}
    for e in estimates:
        # beta's torques come under alpha's name of the inertia; the rest by their own
        pull = (e.value - truth[e.name]) / e.standard_error
        # 30 draws tell a scatter to 13 percent: four times that
        assert 0.5 < np.sqrt(np.mean(pull**2)) < 1.5, e.name
        assert abs(pull.mean()) < 3.3 / np.sqrt(30), e.name
        assert np.abs(pull).max() < 5.0, e.name


def test_a_third_more_back_emf_is_told_from_a_third_more_grease(found):
    """Units differ by 5 percent and more: what is found goes with what is true, and with nothing else."""
    estimates, truth = found
    by_name = {e.name: e for e in estimates}
    for axis in ("alpha", "beta"):
        for what in ("back-EMF drag over inertia", "viscous friction over inertia"):
            name = f"{axis} {what}"
            assert np.corrcoef(by_name[name].value, truth[name])[0, 1] > 0.97, name
            assert np.median(by_name[name].standard_error / truth[name]) < 0.01, name


class NoOpenBridge(TwinTransport):
    """Boards without the port's open_phases: they answer UNKNOWN_COMMAND to a step that opens."""

    def __init__(self, twin):
        super().__init__(twin)
        self.answers = []

    async def send(self, frames):
        passed = []
        for frame in frames:
            positioner, command, uid, _ = fw.decode_identifier(frame[0])
            if command in (245, 246) and b"\x00\x80" in (frame[1][:2], frame[1][2:4]):
                self.answers.append(
                    Frame(fw.encode_identifier(positioner, command, uid, 13), b"", self.time_s)
                )
            else:
                passed.append(frame)
        await super().send(passed)

    async def receive(self, timeout_s):
        answers, self.answers = self.answers, []
        return answers or await super().receive(timeout_s)


def test_a_board_that_cannot_open_its_bridges_is_refused_in_words():
    data, _ = measured(2, 0, NoOpenBridge, repeats=1)
    words = r"its board cannot open the bridge of a motor: refused \(UNKNOWN_COMMAND\)"
    for one in data:
        with pytest.raises(InputError, match=words):
            identify_coast(one, inertia(2))
