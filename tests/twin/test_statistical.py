"""The statistical twin against the full physics: same units, same commands, same standstill."""

import asyncio

import numpy as np
import pytest

from fiberloom.bus import Client
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import NoiseCamera, StatisticalTwin, Twin, TwinTransport, draw_units, worn
from fiberloom.twin.gears import Gears
from fiberloom.twin.noise import UnitNoise
from fiberloom.twin.units import GEAR

PLANE = generate(load_instrument("sdssv"), seed=3, n_positioners=12)
UNITS = draw_units(PLANE, seed=3)
START_DEG = (100.0, 90.0)

LANDING_DEG = 0.35
"""Motor deg by which a unit's mean landing may differ, rms: the counter is set at power-up by one
noisy reading of the sensors, 0.11 in either fidelity, and servos leave as much of wrong friction
(settle_tolerance is 0.5). 3.4e-4 deg of the arm, 0.1 um."""


def walk(rng, moves, most=12.0):
    """Wire positions that stay near the start, so that the physics need not run for long."""
    return np.asarray(START_DEG) + rng.uniform(-most, most, (moves, 2))


def full(units, wires, precise=True, prepare=None, speed_rpm=4000.0, watch=True):
    """Output angles (N, 2, moves) by firmware and physics."""
    twin = Twin(PLANE, units, seed=5, threads=1, neighbours=False, start_deg=START_DEG)
    client = Client(TwinTransport(twin))

    async def run():
        ids = await client.discover()
        await client.set_precise_moves(ids, on=precise)
        await client.set_speed(ids, speed_rpm, speed_rpm)
        await client.set_loop(ids, closed=True, collision_detection=watch)
        if prepare is not None:
            prepare(twin)
        out = []
        for alpha, beta in wires:
            begun = await client.goto(ids, float(alpha), float(beta))
            await client.wait_until_done(begun.ok_ids, timeout_s=60.0, stop_on_collision=False)
            out.append(twin.truth())
        return np.stack(out, axis=-1)

    return asyncio.run(run())


def without_seat(units):
    quiet = units.select(np.arange(len(units)))
    quiet.plant["seat_rms"] = 0.0
    return quiet


def motor_deg(units, theta_deg):
    """T-: which gear angle an output angle belongs to."""
    return np.rad2deg(Gears(units).gear_of(np.deg2rad(theta_deg)))


def statistical(units, wires, **options):
    """Output angles (N, 2, moves), one move after the other."""
    twin = StatisticalTwin(PLANE, units, seed=9, start_deg=START_DEG)
    for name, value in options.items():
        if name != "precise":
            setattr(twin, name, value)
    precise = options.get("precise", True)
    return np.stack([twin.move(np.broadcast_to(w, (len(PLANE), 2)), precise=precise) for w in wires], axis=-1)


@pytest.mark.parametrize("spectrum", ["stages", "family"])
def test_tables_are_the_gear(spectrum):
    units = worn(draw_units(PLANE, seed=UNITS.seed, gears=spectrum), 100.0)
    gears = Gears(units)
    theta = np.linspace(-4.0, 364.0, 3001)
    for row, axis in ((0, 0), (3, 1)):
        wire, backlash = units.transmission(row, axis, theta)
        at = np.zeros((len(units), 2, len(theta)))
        at[row, axis] = np.deg2rad(theta)
        found = gears.gear_of(at)
        np.testing.assert_allclose(np.rad2deg(found[row, axis]), wire * GEAR, atol=1e-9)
        pushed = gears.pushed_up(found + np.deg2rad(backlash))  # B as a cell has it: linear in the gear
        np.testing.assert_allclose(pushed[row, axis], found[row, axis], atol=1e-7)
        np.testing.assert_allclose(gears.output_of(found), at, atol=1e-13)


@pytest.mark.parametrize("cycles", [0.0, 100.0])
def test_standstill_is_that_of_the_physics(cycles):
    units = without_seat(worn(UNITS, cycles))
    wires = walk(np.random.default_rng(1), 40)
    physics = motor_deg(units, full(units, wires))
    rest = StatisticalTwin(PLANE, units, seed=9)
    ours = motor_deg(units, rest.stand(np.broadcast_to(wires.T, (len(PLANE), 2, len(wires)))))
    off = ours - physics
    assert np.abs(off.mean(axis=2)).max() < 2 * LANDING_DEG
    assert np.sqrt(np.mean(off.mean(axis=2) ** 2)) < LANDING_DEG
    # beyond its mean: two landings of 0.065
    assert np.sqrt(np.mean(off.var(axis=2))) < 0.15
    # and it is no tautology: new gears put the arms of worn ones elsewhere, by many motor degrees
    if cycles:
        new = motor_deg(units, StatisticalTwin(PLANE, without_seat(UNITS), seed=9).stand(
            np.broadcast_to(wires.T, (len(PLANE), 2, len(wires)))
        ))  # fmt: skip
        assert np.sqrt(np.mean((new - physics) ** 2)) > 5.0


def test_scatter_is_that_of_the_physics():
    """The seat of the teeth: 16 and 5 urad (Fig. 17), drawn anew by every approach."""
    wires = np.tile([[101.3, 92.2], [103.1, 94.6]], (40, 1))
    theirs = full(UNITS, wires)[..., 1::2]
    ours = statistical(UNITS, wires)[..., 1::2]
    pooled = [np.sqrt(t.var(axis=2, ddof=1).mean(axis=0)) for t in (theirs, ours)]
    # 12 x 39 degrees of freedom each: 3.3 % of a standard deviation; three times that, and the difference
    np.testing.assert_allclose(pooled[1], pooled[0], rtol=0.14)
    # means differ by their standard errors and by what a servo leaves
    allowed = np.sqrt(2 / 40) * pooled[0] + LANDING_DEG / GEAR
    assert (np.sqrt(np.mean((ours - theirs).mean(axis=2) ** 2, axis=0)) < allowed).all()


def test_the_last_contact_decides_where_moves_are_not_precise():
    units = without_seat(UNITS)
    wires = walk(np.random.default_rng(2), 30)
    physics = motor_deg(units, full(units, wires, precise=False))
    ours = motor_deg(units, statistical(units, wires, precise=False))
    upward = np.diff(wires[:, 0]) > 1.0
    gap = (wires[1:, 0] * GEAR - physics[:, 0, 1:])[:, upward]
    assert gap.min() > 30.0  # upward moves end a backlash short of where the motor stands: Fig. 10
    assert np.sqrt(np.mean((ours - physics) ** 2)) < 3 * LANDING_DEG
    # a way shorter than the backlash in the other direction moves no arm, in either fidelity
    back = np.array([[100.0, 90.0], [105.0, 95.0], [104.98, 94.98]])
    for angles in (full(units, back, precise=False), statistical(units, back, precise=False)):
        # 20 motor deg of way; a start kicks a gear by a few in the physics
        assert np.abs(np.diff(angles, axis=2)[..., 1]).max() * GEAR < 5.0


def test_a_weak_hall_channel_puts_the_arm_elsewhere():
    """One channel at 0.7 of its amplitude: up to 10 motor deg, twice a motor turn. Its wavering is taken
    for contact, so collision detection is off; below 0.6 the motor no longer turns."""
    units = without_seat(UNITS)
    units.plant["hall_amplitude_a"][:, 0] *= 0.7
    wires = walk(np.random.default_rng(3), 16)
    physics = motor_deg(units, full(units, wires, speed_rpm=1000.0, watch=False))
    ours = motor_deg(units, statistical(units, wires))
    miss = physics - (wires.T * GEAR)
    assert 5.0 < np.sqrt(np.mean(miss[:, 0] ** 2)) < 15.0
    assert np.sqrt(np.mean((ours - physics)[:, 0] ** 2)) < 1.5


def test_a_slipping_coupling_loses_the_same_way():
    units = without_seat(UNITS)
    wires = walk(np.random.default_rng(4), 8)

    def prepare(twin):
        for row in range(len(PLANE)):
            twin.slip(int(PLANE.positioner_id[row]), "alpha", up=0.8, down=0.6)

    physics = full(units, wires, prepare=prepare)
    follows = np.ones((len(PLANE), 2, 2))
    follows[:, 0] = 0.6, 0.8
    ours = statistical(units, wires, follows=follows)
    alone = statistical(units, wires)
    assert np.abs(alone - ours)[:, 0].max() > 1.0
    # a tick's way is counted between ticks, and landings differ: a few motor degrees in all
    np.testing.assert_allclose(ours, physics, atol=5.0 / GEAR)


def test_camera_and_arms():
    units = worn(UNITS, 80.0)
    twin = StatisticalTwin(PLANE, units, seed=1, start_deg=START_DEG)
    twin.dark[4] = True
    full_twin = Twin(PLANE, units, threads=1, neighbours=False, start_deg=START_DEG)
    np.testing.assert_allclose(twin.fibre_xy("BOSS"), full_twin.fibre_xy("BOSS"), atol=1e-9)
    many = np.repeat(twin.truth()[..., None], 3, axis=2)
    np.testing.assert_array_equal(twin.fibre_xy("BOSS", many)[..., 2], twin.fibre_xy("BOSS"))
    seen = NoiseCamera(twin, 0.1, seed=2).measure()
    assert not seen.seen[4]
    assert np.abs(seen.xy_mm - twin.fibre_xy())[seen.seen].max() < 1e-3
    with pytest.raises(InputError, match="11 units for 12 positioners"):
        StatisticalTwin(PLANE, UNITS.select(np.arange(11)))


def test_a_units_numbers_do_not_depend_on_company():
    rows = np.array([7, 2])
    wires = np.random.default_rng(5).uniform(20, 160, (len(PLANE), 2, 50))
    whole = StatisticalTwin(PLANE, UNITS, seed=4)
    part = StatisticalTwin(PLANE.select(rows), UNITS.select(rows), seed=4)
    np.testing.assert_array_equal(whole.stand(wires)[rows], part.stand(wires[rows]))
    np.testing.assert_array_equal(whole.move(wires[..., 0])[rows], part.move(wires[rows, :, 0]))


def test_who_does_not_move_stays():
    twin = StatisticalTwin(PLANE, UNITS, seed=4, start_deg=START_DEG)
    twin.still[3, 0] = True
    before = twin.truth()
    wire = np.full((len(PLANE), 2), 120.0)
    wire[5] = np.nan
    after = twin.move(wire)
    np.testing.assert_array_equal(after[5], before[5])
    assert after[3, 0] == before[3, 0]
    assert (np.abs(after - before)[[0, 1, 2]] > 10).all()


def test_noise_is_normal_and_streams_are_apart():
    first, second = UnitNoise(1, 2, [10, 11]).normal(20000)
    assert np.abs([first.mean(), second.mean()]).max() < 4 / np.sqrt(20000)
    assert np.abs(np.std([first, second], axis=1) - 1).max() < 4 / np.sqrt(40000)
    assert abs(np.corrcoef(first, second)[0, 1]) < 4 / np.sqrt(20000)
    assert abs(np.corrcoef(first[:-1], first[1:])[0, 1]) < 4 / np.sqrt(20000)
    for other in (UnitNoise(2, 2, [10]), UnitNoise(1, 3, [10])):
        assert abs(np.corrcoef(first, other.normal(20000)[0])[0, 1]) < 4 / np.sqrt(20000)
    halves = UnitNoise(1, 2, [10])
    np.testing.assert_array_equal(np.hstack([halves.normal(5), halves.normal(7)])[0], first[:12])
