"""`fiberloom calibrate steppers`, and `observe --calibration` by its file."""

import json

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.cli.calibrate.steppers import SteppersOptions, steppers
from fiberloom.drive.steppers import KnownUnits
from fiberloom.drive.steppers.kept import read_units, save_units
from fiberloom.errors import InputError
from fiberloom.store.listing import runs_below
from fiberloom.targets.generate import random_targets
from fiberloom.twin.motors.arrays import source_of

PLANE = fl.FocalPlane.of("megara", seed=0, n=12)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What the command has written."""
    out = tmp_path_factory.mktemp("units")
    options = SteppersOptions(instrument="megara", positioners=12, seed=0, out=out, as_json=True)
    assert steppers(options) == 0
    return out


def test_the_file_gives_back_what_the_bench_has_found(folder):
    known, found = read_units(folder / "units.npz", PLANE), source_of(PLANE, 0, "noise").known
    np.testing.assert_array_equal(known.error_deg, found.error_deg)
    np.testing.assert_array_equal(known.knots_deg, found.knots_deg)
    np.testing.assert_allclose(known.arms.found.arms, found.arms.found.arms)
    goal = np.tile([-100.0, -80.0], (12, 1))
    np.testing.assert_array_equal(known.counts(goal, np.ones((12, 2))), found.counts(goal, np.ones((12, 2))))
    # units are found by their numbers, in any order
    some = PLANE.select([7, 2])
    np.testing.assert_array_equal(read_units(folder / "units.npz", some).error_deg, found.error_deg[[7, 2]])


def test_every_unit_that_was_calibrated_has_its_row(folder):
    (row,) = runs_below(str(folder))
    assert (row["calibrations"], row["instrument"], row["status"]) == ("steppers 12", "megara", "finished")


def test_the_command_tells_the_sizes_that_the_twin_has_drawn(folder):
    """12 units: a deviation is known to a fifth of itself."""
    told = json.loads((folder / "units.json").read_text())
    assert told["refused"] == {}
    assert told["zero_rms_deg"] == pytest.approx([0.3, 0.3], rel=0.6)
    assert told["arm_rms_um"] == pytest.approx([10.0, 10.0], rel=0.6)
    assert told["centre_rms_um"] == pytest.approx(5.0, rel=0.6)


def test_observe_goes_by_the_file_and_not_by_a_bench_of_its_own(folder, tmp_path):
    """Zeros of the file that are off by 1 deg turn all arms by 1 deg."""
    wrong = read_units(folder / "units.npz", PLANE)
    wrong.error_deg[:, 0] += 1.0
    save_units(wrong, PLANE, tmp_path / "off.npz")
    targets = random_targets(PLANE, 40, seed=1)
    rms_um = []
    for file in (folder / "units.npz", tmp_path / "off.npz"):
        field = fl.Field(PLANE, source_of(PLANE, 0, "noise"), 0, file)
        seen = field.run.observe(targets, out=tmp_path / file.stem)
        rms_um.append(seen.summary()["moves"][-1]["true_rms_um"])
    assert rms_um[0] < 8.0
    assert 80.0 < rms_um[1] < 210.0  # 1 deg of at most 11.7 mm is 204 um


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (
            {"about": np.frombuffer(b'{"instrument": "moons", "why": {}}', np.uint8)},
            "is of moons, not of megara",
        ),
        ({"about": np.frombuffer(b"[]", np.uint8)}, "no file of units on steppers"),
        ({"positioner_id": np.arange(900, 912)}, "is not in it"),
        ({"error_deg": np.zeros((12, 2, 2, 3))}, "error_deg is not what a bench finds"),
        ({"error_deg": np.full((12, 2, 2, 25), np.nan)}, "error_deg is not what a bench finds"),
        ({"knots_deg": np.zeros((2, 25))}, "knots_deg is not what a bench finds"),
        ({"circles_mm": np.zeros((12, 3))}, "circles_mm is not what a bench finds"),
    ],
)
def test_a_file_that_does_not_fit_is_refused(folder, tmp_path, change, why):
    with np.load(folder / "units.npz") as file:
        arrays = dict(file)
    np.savez(tmp_path / "bad.npz", **(arrays | change))
    with pytest.raises(InputError, match=why):
        read_units(tmp_path / "bad.npz", PLANE)


def test_no_file_and_other_motors_are_refused_in_one_line(tmp_path):
    (tmp_path / "text.npz").write_text("x")
    for file, why in (("none.npz", "No such file"), ("text.npz", "no file of units on steppers")):
        with pytest.raises(InputError, match=why):
            source_of(PLANE, 0, "noise").know(tmp_path / file)
    with pytest.raises(InputError, match="its motors are no steppers"):
        steppers(SteppersOptions(instrument="pfs", positioners=3, out=tmp_path / "out"))


def test_a_unit_that_the_bench_refuses_is_left_out_by_the_file(tmp_path):
    known = source_of(PLANE, 0, "noise").known
    bent = KnownUnits(known.steps, known.knots_deg, known.error_deg, {3: "bent"})
    save_units(bent, PLANE, tmp_path / "u.npz")
    again = read_units(tmp_path / "u.npz", PLANE)
    assert again.why == {3: "bent"}
    assert again.arms is None
