"""Ailments: each shows as it does in the full physics, is labelled, and spans what DESI has seen."""

import asyncio
import csv
import gzip
from itertools import pairwise

import numpy as np
import pytest

from fiberloom.bus import Client
from fiberloom.studies.years import Years
from fiberloom.twin import AilmentKind, AilmentModel, Twin, TwinTransport, bench_units, draw_ailments
from fiberloom.twin.faults.ailments import HALL_STALLS, KINDS, NEVER, excess_torque_Nm
from fiberloom.twin.noise import UnitNoise

PLANE, UNITS = bench_units("sdssv", 6, range(16))


def only(kind, **model):
    """Ailments of one kind, in everybody, on alpha, from move 5 on."""
    made = draw_ailments(UNITS, 3, AilmentModel(weights={kind: 1.0}, **model))
    made.table["onset"], made.table["axis"] = 5, 0
    return made


def visits(ailments, count=40, seed=2, commands=None, refresh_moves=500):
    years = Years(PLANE, UNITS, seed=2, ailments=ailments, start_deg=(100.0, 90.0))
    years.refresh_moves = refresh_moves
    noise = UnitNoise(seed, 0, UNITS.number)
    if commands is None:
        commands = noise.uniform(2, count) * np.array([300.0, 120.0])[:, None] + 30.0
    return [years.visit(commands[..., i]) for i in range(commands.shape[-1])], commands


def misses_deg(kind, **options):
    """(N, 2, moves) true angle with the ailment less that without."""
    ill, _ = visits(only(kind, **options.pop("model", {})), **options)
    well, _ = visits(only(kind, rate_per_year=0.0), **options)
    return np.stack([i.true_deg - w.true_deg for i, w in zip(ill, well, strict=True)], axis=-1), ill


def test_nothing_happens_before_the_onset_and_labels_tell_when():
    for kind in KINDS:
        off, ill = misses_deg(kind, count=8)
        assert np.abs(off[..., :5]).max() == 0.0, kind
        assert [set(v.label) for v in ill] == [{""}] * 5 + [{str(kind)}] * 3


def test_stuck():
    _, ill = misses_deg(AilmentKind.STUCK)
    assert not any(v.done.any() for v in ill[5:])
    assert all(np.array_equal(v.true_deg, ill[4].true_deg) for v in ill[5:])
    assert all(np.array_equal(v.reported_wire_deg, ill[4].reported_wire_deg) for v in ill[5:])


def test_silent_non_moves():
    _, ill = misses_deg(AilmentKind.NON_MOVES, model={"non_moves": (0.3, 0.3)}, count=200)
    assert all(v.done.all() for v in ill)
    stood = np.mean([v.true_deg[:, 0] == u.true_deg[:, 0] for u, v in pairwise(ill[4:])])
    assert stood == pytest.approx(0.3, abs=4 * np.sqrt(0.21 / 195 / 16))
    assert not any((v.true_deg[:, 1] == u.true_deg[:, 1]).any() for u, v in pairwise(ill))


def test_a_broken_tooth_is_a_jump_over_one_pairing():
    made = only(AilmentKind.BROKEN_TOOTH)
    made.table["tooth"][:, 0] = np.deg2rad(90.0)
    commands = np.full((16, 2, 60), 90.0)
    commands[:, 0, 10:] = np.linspace(80, 100, 50)
    ill, _ = visits(made, commands=commands)
    well, _ = visits(only(AilmentKind.BROKEN_TOOTH, rate_per_year=0.0), commands=commands)
    off = np.stack([i.true_deg - w.true_deg for i, w in zip(ill, well, strict=True)], axis=-1)[:, 0, 10:]
    height = np.rad2deg(made.table["tooth"][:, 2])
    largest = np.take_along_axis(off, np.abs(off).argmax(axis=1)[:, None], axis=1)[:, 0]
    np.testing.assert_allclose(largest, -height, rtol=0.25)  # the gear's own slopes tilt it
    assert np.abs(off[:, [0, 1, -2, -1]]).max() < 0.01


def test_slipping_makes_its_share_in_each_direction():
    made = only(AilmentKind.SLIPPING)
    made.table["follows"], made.table["non_moves"] = (0.5, 0.8), 0.0
    steps = np.array([100, 100, 100, 100, 100, 130, 160, 130.0])
    ill, _ = visits(made, commands=np.broadcast_to(steps, (16, 2, 8)))
    way = np.diff([v.true_deg[:, 0] for v in ill[4:]], axis=0)
    overshoot = 0.82 * (0.8 - 0.5)  # the approach goes up and comes down again
    # backlash takes up to 0.24 deg of the way up and of the way down, and 30 deg of the wire are so many
    # of the arm to 0.1
    np.testing.assert_allclose(way[:2], 30 * 0.8 + overshoot, atol=0.25)
    np.testing.assert_allclose(way[2], -30 * 0.5, atol=0.25)  # from above: all of it downwards
    assert all(v.done.all() for v in ill)


def test_a_weak_hall_channel_stalls():
    off, ill = misses_deg(
        AilmentKind.WEAK_HALL, model={"fading_moves": (50.0, 50.0)}, refresh_moves=1, count=60
    )
    # positions waver with the motor turn, of the axis that has it
    assert 2.0 < np.abs(off[:, 0, 15:30]).max() * 1024 < 20.0  # motor deg
    assert np.abs(off[:, 1, :30]).max() < 1e-3
    done = np.array([v.done.all() for v in ill])
    assert done[:44].all()  # exp(-38/50) = 0.47
    assert not done[46:].any()


def test_friction_shows_in_the_torque_and_ends_in_a_stall():
    _, ill = misses_deg(
        AilmentKind.FRICTION, model={"seizing_moves": (20.0, 20.0)}, refresh_moves=2, count=60
    )
    torque = np.array([v.torque_Nm[:, 0] for v in ill])
    assert (np.diff(torque[4:30:2], axis=0) > 0).all()
    np.testing.assert_array_equal(ill[0].torque_Nm, excess_torque_Nm(UNITS))
    assert all(v.done.all() for v in ill[:26])  # 2.05 times
    assert not any(v.done.any() for v in ill[55:])  # 3.5 times


def test_a_loose_arm_jitters_along_itself():
    made = only(AilmentKind.LOOSE_ARM, loose_um_per_1000=(100.0, 100.0))
    ill, commands = visits(made, count=200)
    well, _ = visits(only(AilmentKind.LOOSE_ARM, rate_per_year=0.0), commands=commands)
    off_um = 1e3 * np.array([i.true_mm - w.true_mm for i, w in zip(ill, well, strict=True)])
    late = np.sqrt(np.mean(np.sum(off_um[150:] ** 2, axis=2)))
    assert late == pytest.approx(0.1 * 170, rel=0.1)
    assert np.abs([i.true_deg - w.true_deg for i, w in zip(ill, well, strict=True)]).max() == 0.0


def test_dark():
    _, ill = misses_deg(AilmentKind.DARK, count=8)
    assert np.isfinite(ill[4].measured_mm).all()
    assert np.isnan(ill[5].measured_mm).all()
    assert np.isfinite(ill[5].true_mm).all()


@pytest.mark.parametrize(
    ("name", "factor", "moves"),
    [("coulomb_gear", 1.4, True), ("coulomb_gear", 4.0, False),
     ("hall_amplitude_b", 0.995, True), ("hall_amplitude_b", 0.3, False)],
)  # fmt: skip
def test_stalls_are_those_of_firmware_and_physics(name, factor, moves):
    """On either side of where both draw the line; between, units differ and so do versions of firmware."""
    plane, units = bench_units("sdssv", 6, range(6))
    units.plant[name][:, 0] *= factor
    if name == "coulomb_gear":
        units.plant["viscous_gear"][:, 0] *= factor
    twin = Twin(plane, units, threads=1, neighbours=False, start_deg=(100.0, 90.0))
    client = Client(TwinTransport(twin))

    async def run():
        ids = await client.discover()
        await client.set_speed(ids, 2000.0, 2000.0)
        await client.goto(ids, 108.0, 92.0)
        return await client.wait_until_done(ids, timeout_s=20.0, stop_on_collision=False)

    asyncio.run(run())
    went = np.abs(twin.truth()[:, 0] - 108.0) < 1.0
    assert went.all() if moves else not went.any(), twin.truth()[:, 0]
    ailing = draw_ailments(units, 1, AilmentModel(rate_per_year=0.0))
    if name == "coulomb_gear":
        assert (not ailing.stalled_at(units, 0).any()) == moves
    else:
        assert (factor > HALL_STALLS) == moves


def test_years_do_not_depend_on_company():
    rows = [9, 2]
    made = draw_ailments(UNITS, 3, AilmentModel(rate_per_year=1.0, moves_per_year=20))
    part = Years(PLANE.select(rows), UNITS.select(rows), seed=2,
                 ailments=AilmentModel(rate_per_year=1.0, moves_per_year=20))  # fmt: skip
    whole = Years(PLANE, UNITS, seed=2, ailments=AilmentModel(rate_per_year=1.0, moves_per_year=20))
    commands = UnitNoise(1, 0, UNITS.number).uniform(2, 60) * 120 + 30
    for i in range(60):
        one, two = whole.visit(commands[..., i]), part.visit(commands[rows, :, i])
        for name in ("done", "measured_mm", "true_deg", "torque_Nm", "label"):
            assert getattr(one, name)[rows].tobytes() == getattr(two, name).tobytes(), (name, i)
    assert len(made.onsets()) > 5


def test_rates():
    _, many = bench_units("sdssv", 1, range(400))
    drawn = draw_ailments(many, 1, AilmentModel(rate_per_year=0.5, moves_per_year=1000)).table
    share = np.mean(drawn["onset"] < 1000)
    assert share == pytest.approx(1 - np.exp(-0.5), abs=4 * np.sqrt(0.24 / 400))
    counts = np.array([np.sum(drawn["kind"] == k) for k in KINDS])
    assert (np.abs(counts - 50) < 4 * np.sqrt(50)).all()
    assert (draw_ailments(many, 1, AilmentModel(rate_per_year=0.0)).table["onset"] == NEVER).all()


@pytest.mark.parametrize("kind", [AilmentKind.BROKEN_TOOTH, AilmentKind.SLIPPING, AilmentKind.DARK])
def test_the_full_physics_can_be_broken_alike(kind):
    made = only(kind)
    twin = Twin(PLANE, UNITS, threads=1, neighbours=False, start_deg=(100.0, 90.0))
    made.break_twin(twin, UNITS, move=4)
    before = twin.truth()
    assert not twin.dark.any()
    if kind is AilmentKind.BROKEN_TOOTH:
        made.table["tooth"][:, 0] = np.deg2rad(100.0)
    made.break_twin(twin, UNITS, move=5)
    moved = np.abs(twin.truth() - before)[:, 0].min()
    assert twin.dark.all() == (kind is AilmentKind.DARK)
    assert (moved > 0.1) == (kind is AilmentKind.BROKEN_TOOTH)


def quantiles(values):
    return np.nanquantile(np.array(values, dtype=float), [0.1, 0.9])


def test_slipping_spans_desis_degraded_motors(shared_sdssv):
    """Public data of desihub/fpoffline; only where it lies beside the checkout."""
    folder = shared_sdssv.parent / "desi"
    with (folder / "badmotors-results.csv").open() as file:
        rows = list(csv.DictReader(file))
    seen = {
        axis: [float(r[f"slope_{axis}"] or "nan") for r in rows if float(r[f"slope_{axis}0"]) < 1.0]
        for axis in "tp"
    }
    stuck = [float(r[f"{a}stuck_frac"] or "nan") for r in rows for a in "tp"]
    with gzip.open(folder / "calib-20260303.csv.gz", "rt") as file:
        linear = [r for r in csv.DictReader(file) if r["zeno_motor_p"] == "True"]
    apart = [float(r["sz_cw_p"]) - float(r["sz_ccw_p"]) for r in linear]
    _, many = bench_units("sdssv", 1, range(500))
    ours = draw_ailments(many, 1, AilmentModel(weights={AilmentKind.SLIPPING: 1.0})).table
    low, high = quantiles(ours["follows"])
    for slopes in seen.values():
        there = quantiles(slopes)
        assert low < there[0] + 0.05
        assert high > there[1] - 0.05
    assert np.quantile(ours["non_moves"], 0.9) > 0.6 * quantiles(stuck)[1]
    assert ours["non_moves"].max() > np.nanmedian(stuck)
    difference = np.diff(ours["follows"], axis=1)
    np.testing.assert_allclose(np.std(difference), np.std(apart), rtol=0.2)
    assert np.abs(difference).max() > 0.9 * np.quantile(np.abs(apart), 0.99)
