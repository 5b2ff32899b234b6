"""Settings and files of calibrations that cannot work: value and rule."""

import numpy as np
import pytest

from fiberloom.calibration.bench.acceptance import AcceptanceSettings
from fiberloom.calibration.bench.arms import ArmsSettings
from fiberloom.calibration.bench.coast import CoastSettings
from fiberloom.calibration.bench.friction import FrictionSettings
from fiberloom.calibration.bench.stiffness import StiffnessSettings
from fiberloom.calibration.transmission.maps import Provenance, TransmissionMaps, identity, load, polyline
from fiberloom.errors import InputError

IDS = np.array([4, 9])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ArmsSettings(n_points=7), "n_points = 7: a circle needs at least 8"),
        (lambda: FrictionSettings(n_angles=1), "n_angles = 1: the spring's rate needs at least 2"),
        (lambda: FrictionSettings(run_rpm=(31.0,)), "run_rpm = .*: drag needs a speed well above 30"),
        (lambda: CoastSettings(repeats=0), "repeats = 0: a coast in each direction and state"),
        (lambda: CoastSettings(voltages=(0.9, -0.2)), "voltages = .*: shares of the full one"),
        (lambda: StiffnessSettings(repeats=2), "repeats = 2: the scatter needs at least"),
        (lambda: AcceptanceSettings(n_targets=0), "0 targets, 5 moves: at least 1 of each"),
        (lambda: AcceptanceSettings(n_moves=0), "20 targets, 0 moves: at least 1 of each"),
    ],
)
def test_settings_that_cannot_identify_anything(make, words):
    with pytest.raises(InputError, match=words):
        make()


def knots(n=2, k=3):
    return np.broadcast_to(np.linspace(0.0, 180.0, k), (n, 2, 2, k)).copy()


def test_maps_of_another_shape_are_refused():
    with pytest.raises(InputError, match=r"wire_deg has the shape \(1, 2, 2, 3\), 2 positioners need"):
        TransmissionMaps(IDS, knots(1), knots())
    with pytest.raises(InputError, match="output_deg has the shape"):
        TransmissionMaps(IDS, knots(), knots(k=1))
    with pytest.raises(InputError, match="differ in shape"):
        TransmissionMaps(IDS, knots(), knots(k=4))


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_a_knot_that_does_not_rise_is_named(value):
    bad = knots()
    bad[1, 0, 1, 1] = value
    words = r"positioner 9, alpha, positive contact: wire_deg does not rise from knot 0 to 1"
    with pytest.raises(InputError, match=words):
        TransmissionMaps(IDS, bad, knots())


def test_a_positioner_without_a_map_and_a_direction_that_is_none():
    maps = identity(IDS)
    with pytest.raises(InputError, match=r"no transmission map for positioner 5 \(2 missing\): calibrate"):
        maps.rows_of([4, 5, 6])
    assert maps.rows_of([9, 4]).tolist() == [1, 0]
    with pytest.raises(ValueError, match=r"direction 0: -1 for negative contact, \+1 for positive"):
        maps.to_wire(10.0, direction=0)


def test_maps_survive_their_file_and_other_files_are_refused(tmp_path):
    path = tmp_path / "new" / "maps.npz"
    maps = TransmissionMaps(IDS, knots() + 0.25, knots(), Provenance("abc", 3, 1000.0, note="n"))
    maps.save(path)
    again = load(path)
    np.testing.assert_array_equal(again.wire_deg, maps.wire_deg)
    assert again.provenance == maps.provenance
    assert [p.name for p in path.parent.iterdir()] == ["maps.npz"]

    with pytest.raises(InputError, match="make one with 'fiberloom calibrate transmission'"):
        load(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(InputError, match="not a file of transmission maps, or broken"):
        load(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(InputError, match="not a file of transmission maps"):
        load(tmp_path / "other.npz")
    with pytest.raises(InputError, match="cannot be written"):
        maps.save(path / "below.npz")


def test_a_file_of_another_format_says_what_this_version_reads(tmp_path):
    path = tmp_path / "maps.npz"
    identity(IDS).save(path)
    with np.load(path) as file:
        parts = dict(file)
    parts["meta"] = np.array(str(parts["meta"]).replace('"format_version": 1', '"format_version": 9'))
    np.savez(path, **parts)
    with pytest.raises(InputError, match="transmission maps of format 9; this version reads 1: calibrate"):
        load(path)
    parts["meta"] = np.array(str(parts["meta"]).replace("fiberloom transmission maps", "x"))
    np.savez(path, **parts)
    with pytest.raises(InputError, match=r"not a file of transmission maps \(KeyError\('format'\)\)"):
        load(path)


def test_a_file_whose_knots_do_not_rise_names_the_file(tmp_path):
    path = tmp_path / "maps.npz"
    identity(IDS).save(path)
    with np.load(path) as file:
        parts = dict(file)
    parts["wire_deg"] = -parts["wire_deg"]
    np.savez(path, **parts)
    with pytest.raises(InputError, match=r"maps\.npz: transmission map of positioner 4, alpha, negative"):
        load(path)


def test_a_polyline_is_exact_at_its_knots_and_straight_beyond():
    x, y = np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0, 3.0])
    np.testing.assert_array_equal(polyline(x, y, x), y)
    np.testing.assert_allclose(polyline(x, y, [-1.0, 0.5, 2.0, 5.0]), [-2.0, 1.0, 2.5, 4.0])
