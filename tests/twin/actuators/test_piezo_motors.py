"""The piezo motors of the twin: scatter as it is set, stops, stuck cobras, and the published convergence."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from fiberloom.twin.actuators import PiezoErrors, PiezoMotors, drawn_maps

START_DEG = 90.0
PERFECT = PiezoErrors(0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.9, 0.0, 0.0, 0.0, 0.0)


def motors_of(errors, cobras=2000, angle_deg=START_DEG, seed=3):
    maps = drawn_maps(cobras, 1)
    stops = np.tile([380.0, 186.0], cobras)
    return PiezoMotors(maps, stops, np.full(maps.motors, angle_deg), errors, seed)


def test_without_errors_a_move_is_that_of_the_map():
    motors = motors_of(PERFECT)
    steps = np.where(np.arange(motors.maps.motors) % 3 == 0, -40, 40)
    expected = motors.maps.way_deg(motors.angle_deg, steps.astype(float))
    direction = (steps < 0).astype(int)
    motors.run(steps, motors.maps.pulse_us[np.arange(len(steps)), direction])
    np.testing.assert_allclose(motors.angle_deg - START_DEG, expected, atol=1e-9)


def test_the_scatter_of_steps_is_as_set():
    errors = PiezoErrors(0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.9, 0.6, 0.0, 0.0, 0.0)
    motors = motors_of(errors)
    told = motors.maps.way_deg(motors.angle_deg, np.full(motors.maps.motors, 50.0))
    motors.run(np.full(motors.maps.motors, 50), motors.maps.pulse_us[:, 0])
    off_steps = (motors.angle_deg - START_DEG - told) / (told / 50)
    assert off_steps.std() == pytest.approx(0.6 * np.sqrt(50), rel=0.04)


def test_lasting_errors_last_and_fresh_ones_do_not():
    errors = PiezoErrors(step=0.0, stuck_share=0.0)
    gains = []
    motors = motors_of(errors)
    maps = drawn_maps(2000, 1)
    for _ in range(2):
        motors.angle_deg[:] = START_DEG
        told = maps.way_deg(motors.angle_deg, np.full(maps.motors, 100.0))
        motors.run(np.full(maps.motors, 100), maps.pulse_us[:, 0])
        gains.append((motors.angle_deg - START_DEG) / told)
    assert np.median(gains[0]) == pytest.approx(0.95, abs=0.01)
    assert 0.5 < np.corrcoef(*np.clip(gains, 0.3, 1.6))[0, 1] < 0.95
    assert not np.any(gains[0] == gains[1])


def test_hard_stops_hold():
    motors = motors_of(PiezoErrors(stuck_share=0.0), cobras=50)
    for steps in (20_000, -40_000):
        motors.run(np.full(100, steps), motors.maps.pulse_us[:, 0])
        np.testing.assert_array_equal(motors.angle_deg, motors.stops_deg if steps > 0 else 0.0)


def test_stuck_cobras_and_too_short_pulses_do_not_move():
    motors = motors_of(PiezoErrors(stuck_share=0.3), cobras=200)
    assert 80 < motors.stuck.sum() < 160
    assert np.all(motors.stuck[0::2] == motors.stuck[1::2])
    motors.run(np.full(400, 100), motors.maps.pulse_us[:, 0])
    np.testing.assert_array_equal(motors.angle_deg == START_DEG, motors.stuck)
    before = motors.angle_deg.copy()
    motors.run(np.full(400, 100), np.full(400, 5.0))
    np.testing.assert_allclose(motors.angle_deg, before, atol=1e-12)


def test_drawn_maps_are_distributed_as_the_published_ones():
    maps = drawn_maps(2394, 0)
    mean = maps.step_deg.mean(axis=2)
    assert np.median(mean[0::2]) == pytest.approx(0.0717, rel=0.03)
    assert np.median(mean[1::2]) == pytest.approx(0.0705, rel=0.05)
    shape = maps.step_deg / mean[..., None]
    assert 0.20 < np.median(shape.std(axis=2)) < 0.26
    flat = shape - 1.0
    for bins, low, high in ((1, 0.93, 0.98), (2, 0.78, 0.90), (4, 0.45, 0.75), (8, 0.05, 0.4)):
        told = np.mean(flat[..., bins:] * flat[..., :-bins]) / np.mean(flat**2)
        assert low < told < high, (bins, told)


PUBLISHED_UM = {2: 38.2, 3: 9.7, 4: 6.0, 6: 5.1, 8: 5.0}


def converged(monkeypatch, *words):
    from benchmarks import convergence

    got = {}
    monkeypatch.setattr(convergence, "table", lambda found: got.update(found) or [])
    monkeypatch.setattr(sys, "argv", ["convergence", *words])
    assert convergence.main() == 0
    return SimpleNamespace(**got)


def test_the_published_law_converges_as_published(monkeypatch):
    found = converged(monkeypatch, "--law", "peer", "--seed", "4")
    for move, median_um in PUBLISHED_UM.items():
        assert np.median(found.measured_um[:, move - 1]) == pytest.approx(median_um, rel=0.2)
    assert np.mean(found.measured_um[:, 7] < 10.0) == pytest.approx(0.93, abs=0.03)


def test_the_learning_law_needs_fewer_moves_than_the_published_one(monkeypatch):
    peer, ours = (
        converged(monkeypatch, "--law", law, "--tolerance-um", um, "--seed", "4")
        for law, um in (("peer", "5"), ("ours", "2.5"))
    )
    within = [np.mean(f.error_um[f.healthy] < 5.0, axis=0) for f in (peer, ours)]
    assert within[1][7] > 0.97 > 0.95 > within[0][7]
    assert within[1][5] > within[0][7]
    assert ours.gain.shape == (len(ours.unit), 7)
