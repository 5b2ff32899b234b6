"""Transmission maps: polylines that invert, and their files."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fiberloom.calibration.transmission.cache import cache_path
from fiberloom.calibration.transmission.maps import (
    NEGATIVE,
    POSITIVE,
    Provenance,
    TransmissionMaps,
    identity,
    load,
    polyline,
)
from fiberloom.calibration.transmission.sweep import SweepSettings
from fiberloom.errors import InputError

THETA = np.linspace(-2.0, 362.0, 181)


def some_maps(n=3, seed=1):
    """Maps with the 36 tooth pairings and a backlash of 40 to 250 motor deg."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, (n, 2, 1, 3))
    turn = np.deg2rad(THETA)[:, None] * np.array([1, 2, 36])
    ripple = np.sin(turn + phase) @ np.array([0.05, 0.03, 0.02])
    delta = np.repeat(ripple[:, :, None, :], 2, axis=2)
    backlash = 145.0 + 100.0 * np.sin(np.deg2rad(THETA) + phase[..., 0])
    delta[:, :, 1] += backlash / 1024.0
    return TransmissionMaps(
        np.array([7, 3, 12])[:n],
        THETA + delta,
        np.broadcast_to(THETA, delta.shape).copy(),
        Provenance("abc", seed=5),
    )


steps = arrays(np.float64, 12, elements=st.floats(0.01, 5.0))


@given(steps, steps, st.floats(-20.0, 80.0))
def test_a_polyline_is_undone_by_its_inverse(dx, dy, x):
    x_knots, y_knots = np.cumsum(dx), np.cumsum(dy)
    back = polyline(y_knots, x_knots, polyline(x_knots, y_knots, x))
    # rounding of y, seen through the steepest segment
    steepest = np.max(dx / dy)
    assert abs(back - x) <= 8 * np.spacing(max(1.0, abs(x))) + steepest * 1e-13


@given(steps, steps)
def test_a_polyline_is_exact_at_its_knots(dx, dy):
    x_knots, y_knots = np.cumsum(dx), np.cumsum(dy)
    np.testing.assert_array_equal(polyline(x_knots, y_knots, x_knots), y_knots)


@given(steps, steps, st.floats(0.01, 50.0))
def test_beyond_the_ends_it_goes_straight_on(dx, dy, beyond):
    x_knots, y_knots = np.cumsum(dx), np.cumsum(dy)
    high = y_knots[-1] + beyond * (y_knots[-1] - y_knots[-2]) / (x_knots[-1] - x_knots[-2])
    low = y_knots[0] - beyond * (y_knots[1] - y_knots[0]) / (x_knots[1] - x_knots[0])
    got = polyline(x_knots, y_knots, [x_knots[-1] + beyond, x_knots[0] - beyond])
    np.testing.assert_allclose(got, [high, low], rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("direction", [NEGATIVE, POSITIVE])
def test_wire_and_output_are_inverse_to_machine_precision(direction):
    maps = some_maps()
    theta = np.random.default_rng(0).uniform(-4, 364, (3, 2, 500))
    back = maps.to_output(maps.to_wire(theta, direction=direction), direction=direction)
    # a few units in the last place of 360 deg
    np.testing.assert_allclose(back, theta, rtol=0, atol=2.5e-13)


def test_rows_can_be_picked():
    maps = some_maps()
    theta = np.array([[10.0, 20.0], [30.0, 40.0], [50.0, 60.0]])
    every = maps.to_wire(theta)
    np.testing.assert_array_equal(maps.to_wire(theta[[2, 0]], index=[2, 0]), every[[2, 0]])
    np.testing.assert_array_equal(maps.select([2, 0]).to_wire(theta[[2, 0]]), every[[2, 0]])
    np.testing.assert_array_equal(maps.rows_of([12, 7]), [2, 0])
    path = np.column_stack([np.linspace(0, 90, 7), np.linspace(180, 20, 7)])
    repeated = maps.to_wire(path, index=np.full(7, 1), direction=POSITIVE)
    np.testing.assert_array_equal(maps.path_to_wire(1, path, POSITIVE), repeated)
    assert maps.to_wire(np.zeros((0, 2)), index=[]).shape == (0, 2)  # none has answered
    with pytest.raises(InputError, match="positioner 99"):
        maps.rows_of([7, 99])


def test_paths_of_many_are_as_each_alone():
    maps, rng = some_maps(), np.random.default_rng(4)
    rows = [1, 0, 1, 2]
    beyond = np.array([[-20.0, 400.0], [400.0, -20.0]])  # the knots
    paths = [*(rng.uniform(0.0, 360.0, (count, 2)) for count in (1, 7, 3)), beyond]
    for direction in (NEGATIVE, POSITIVE):
        together = maps.paths_to_wire(rows, paths, direction)
        for row, path, found in zip(rows, paths, together, strict=True):
            np.testing.assert_array_equal(found, maps.to_wire(path.T[None], [row], direction)[0].T)
    assert maps.paths_to_wire([], []) == []


@pytest.mark.parametrize("shape", [(3, 2), (3, 2, 41)])
def test_all_rows_in_one_go_are_the_polyline_of_each_to_the_last_bit(shape):
    maps = some_maps()
    theta = np.random.default_rng(2).uniform(-9.0, 371.0, shape)  # beyond both ends, too
    for direction, side in ((NEGATIVE, 0), (POSITIVE, 1)):
        got = maps.to_wire(theta, direction=direction)
        for row, axis in np.ndindex(3, 2):
            knots = maps.output_deg[row, axis, side], maps.wire_deg[row, axis, side]
            np.testing.assert_array_equal(got[row, axis], polyline(*knots, theta[row, axis]))


def test_delta_and_backlash_are_those_of_eq_7():
    maps = some_maps(1)
    at = THETA[[20, 75]]
    np.testing.assert_allclose(maps.delta_deg(at)[0, 1], maps.wire_deg[0, 1, 0, [20, 75]] - at, atol=1e-12)
    backlash = maps.backlash_motor_deg(THETA)
    assert 40.0 < backlash.min() < 60.0
    assert 230.0 < backlash.max() < 250.0
    # the arm stands at a smaller angle when it came from below
    wire = np.array([[100.0, 100.0]])
    assert (maps.to_output(wire, direction=POSITIVE) < maps.to_output(wire)).all()


def test_linear_keeps_the_ratio_and_the_mean():
    maps = some_maps()
    plain = maps.linear()
    slope = np.diff(plain.wire_deg, axis=-1) / np.diff(plain.output_deg, axis=-1)
    np.testing.assert_allclose(slope, 1.0, atol=1e-12)
    rest = maps.delta_deg(THETA) - plain.delta_deg(THETA)
    np.testing.assert_allclose(rest.mean(axis=-1), 0.0, atol=1e-12)


def test_identity_changes_nothing():
    theta = np.array([[-3.0, 361.0], [12.5, 90.0]])
    np.testing.assert_array_equal(identity([1, 2]).to_wire(theta), theta)


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_a_map_that_does_not_rise_is_refused_by_name(value):
    maps = some_maps()
    wire = maps.wire_deg.copy()
    wire[1, 1, 0, 40] = value
    with pytest.raises(InputError, match=r"positioner 3, beta, negative contact.* knot 39 to 40"):
        TransmissionMaps(maps.positioner_id, wire, maps.output_deg)


def test_a_file_brings_everything_back(tmp_path):
    maps = some_maps()
    maps.save(tmp_path / "new" / "maps.npz")
    back = load(tmp_path / "new" / "maps.npz")
    for name in ("positioner_id", "wire_deg", "output_deg"):
        np.testing.assert_array_equal(getattr(back, name), getattr(maps, name))
    assert back.provenance == maps.provenance
    assert back.provenance.seed == 5


def test_broken_and_foreign_files_are_told_apart_from_maps(tmp_path):
    good = tmp_path / "good.npz"
    some_maps().save(good)
    half = tmp_path / "half.npz"
    half.write_bytes(good.read_bytes()[:2000])
    text = tmp_path / "text.npz"
    text.write_text("hello")
    foreign = tmp_path / "foreign.npz"
    np.savez(foreign, a=np.zeros(3))
    newer = tmp_path / "newer.npz"
    meta = json.dumps({"format": "fiberloom transmission maps", "format_version": 99})
    np.savez(newer, meta=np.array(meta))
    for path in (half, text, foreign, newer, tmp_path / "missing.npz", tmp_path):
        with pytest.raises(InputError, match=path.name):
            load(path)
    with pytest.raises(InputError, match="format 99"):
        load(newer)


def test_a_file_whose_map_does_not_rise_names_file_and_positioner(tmp_path):
    path = tmp_path / "bent.npz"
    some_maps().save(path)
    with np.load(path) as file:
        parts = dict(file)
    parts["wire_deg"][0, 0, 0, 5] = 0.0
    np.savez(path, **parts)
    with pytest.raises(InputError, match=r"bent.npz: .*positioner 7, alpha"):
        load(path)


def test_a_place_that_cannot_be_written_is_an_input_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        some_maps().save(tmp_path / "file" / "maps.npz")


def test_the_cache_is_the_users_unless_the_environment_names_one(monkeypatch, tmp_path):
    monkeypatch.setenv("FIBERLOOM_CACHE", str(tmp_path / "here"))
    assert cache_path("a", 0, SweepSettings()).parent == tmp_path / "here" / "calibration"
    monkeypatch.delenv("FIBERLOOM_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    assert cache_path("a", 0, SweepSettings()).is_relative_to(tmp_path / "home" / "fiberloom")


def test_the_cache_key_changes_with_every_input(tmp_path):
    paths = {
        cache_path("a", 0, SweepSettings(), tmp_path),
        cache_path("b", 0, SweepSettings(), tmp_path),
        cache_path("a", 1, SweepSettings(), tmp_path),
        cache_path("a", 0, SweepSettings(n_points=201), tmp_path),
    }
    assert len(paths) == 4
    assert cache_path("a", 0, SweepSettings(), tmp_path) in paths
