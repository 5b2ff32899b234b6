"""Every calibration leaves rows: what, which file, its digest, whose."""

import hashlib

import pytest

from fiberloom.cli.app import app_of
from fiberloom.cli.calibrate.transmission import TransmissionOptions, transmission
from fiberloom.errors import InputError
from fiberloom.store import Store
from fiberloom.store.calibrations import STORE, record_calibration
from fiberloom.store.listing import runs_below

STAMP = {"instrument": "sdssv", "config_hash": "abc", "seed": 7}

TESTED = {
    "transmission",
    "focal-plane",
    "friction",
    "inertia",
    "coast",
    "stiffness",
    "arms",
    "repeatability",
    "fibres",
    "gravity",
    "steppers",
}
"""Here, in test_learning.py, test_bench_commands.py, test_calibrate_fibres.py, test_calibrate_gravity.py,
test_kept_units.py."""
LOOK_BACK = {"history", "undo"}


def test_no_calibration_command_is_without_a_test_of_its_rows():
    (calibrate,) = (group.typer_instance for group in app_of(["calibrate"]).registered_groups)
    names = {c.name for c in calibrate.registered_commands}
    assert names == TESTED | LOOK_BACK


def test_a_row_for_each_axis_says_what_which_file_and_whose(tmp_path):
    file = tmp_path / "friction.json"
    file.write_bytes(b"found")
    record_calibration(file, "friction", [4, 9], STAMP, "fiberloom calibrate friction")
    with Store.open(tmp_path / STORE, create=False) as store:
        (run,) = store.runs()
        rows = store.calibrations(run.id)
        assert store.calibrated(run.id) == {"friction": 2}
    assert (run.status, run.config_hash, run.seed) == ("finished", "abc", 7)
    assert rows["positioner_id"].tolist() == [4, 9, 4, 9]
    assert rows["axis"].tolist() == ["alpha", "alpha", "beta", "beta"]
    assert set(rows["file"]) == {str(file)}
    assert set(rows["hash"]) == {hashlib.sha256(b"found").hexdigest()[:16]}


def test_what_a_run_has_measured_is_booked_to_that_run(tmp_path):
    file = tmp_path / "arms.ecsv"
    file.write_bytes(b"arms")
    with pytest.raises(InputError, match="no run in it"):
        record_calibration(file, "focal-plane", [1], STAMP, "x", same_run=True)
    with Store.open(tmp_path / STORE) as store, store.start_run(command_line="x", instrument="sdssv"):
        pass
    record_calibration(file, "focal-plane", [1, 2, 3], STAMP, "x", same_run=True)
    (row,) = runs_below(str(tmp_path))
    assert row["calibrations"] == "focal-plane 3"


def test_calibrate_transmission_leaves_rows_of_those_that_it_calibrated(tmp_path):
    transmission(TransmissionOptions(seed=1, positioners=2, points=12, out=tmp_path, as_json=True))
    (row,) = runs_below(str(tmp_path))
    assert (row["calibrations"], row["moves"], row["status"]) == ("transmission 2", 0, "finished")
