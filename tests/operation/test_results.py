"""What an observation tells of itself, against figures worked out by hand."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u
from astropy.table import Table

import fiberloom as fl
from fiberloom.errors import InputError
from fiberloom.health.status import FibreFlag, FibreStatus
from fiberloom.targets import random_targets

N = 7


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """Seven positioners on the twin after the blind move and one correction."""
    plane = fl.FocalPlane.of("sdssv", n=N)
    targets = random_targets(plane, 60, 3)
    return fl.Field.twin(plane, camera="noise", seed=3).run.observe(targets, corrections=1)


def with_errors(seen, errors_um, status=None):
    """The observation with a last move that ended `errors_um` beside the targets in x."""
    beside_mm = np.stack([np.asarray(errors_um) / 1000, np.zeros(N)], axis=1)
    status = [FibreStatus.ON_TARGET] * N if status is None else status
    last = replace(
        seen.moves[-1],
        true_mm=seen.target_mm() + beside_mm,
        measured_error_um=2.0 * np.asarray(errors_um),
        status=status,
    )
    return replace(seen, moves=[*seen.moves[:-1], last])


def test_the_figures_of_a_move(seen):
    errors_um = np.array([3.0, 4.0, 0.0, 4.9, 0.0, 6.0, -10.0])
    observed = with_errors(seen, errors_um)
    summary = observed.summary()
    last = summary["moves"][-1]
    assert (summary["n_positioners"], summary["n_assigned"], summary["n_targets"]) == (N, N, 60)
    # the requirement of the instrument is 5 um
    assert summary["n_within_requirement"] == last["n_within_requirement"] == 5
    assert last["true_rms_um"] == pytest.approx(np.sqrt(185.01 / 7.0))
    assert last["measured_rms_um"] == pytest.approx(2.0 * np.sqrt(185.01 / 7.0))
    # of 0 0 3 4 4.9 6 10: the 95th percentile lies 0.7 of the way from the sixth to the seventh
    assert last["p95_um"] == pytest.approx(6.0 + 0.7 * 4.0)
    assert last["max_um"] == pytest.approx(10.0)
    healthy = last["healthy"]
    assert (healthy["n"], healthy["share_within_requirement"]) == (N, pytest.approx(5.0 / 7.0))
    assert (healthy["rms_um"], healthy["p95_um"]) == (last["true_rms_um"], last["p95_um"])
    assert healthy["p99_um"] == pytest.approx(6.0 + 0.94 * 4.0)
    assert last["not_healthy"]["n"] == 0
    assert [move["move"] for move in summary["moves"]] == [1, 2]
    assert summary["motion_s"] == pytest.approx(sum(move.motion_s for move in seen.moves))


def test_units_with_a_fault_are_told_apart(seen):
    status = [FibreStatus.ON_TARGET] * (N - 2) + [FibreStatus.DEAD, FibreStatus.ASTRAY]
    errors_um = np.array([3.0, 4.0, 0.0, 0.0, 5.1, 300.0, 400.0])
    last = with_errors(seen, errors_um, status).summary()["moves"][-1]
    assert last["healthy"]["n"] == 5
    assert last["healthy"]["rms_um"] == pytest.approx(np.sqrt((9.0 + 16.0 + 5.1**2) / 5.0))
    assert last["healthy"]["share_within_requirement"] == pytest.approx(0.8)
    others = last["not_healthy"]
    assert (others["n"], others["share_within_requirement"]) == (2, 0.0)
    assert others["rms_um"] == pytest.approx(np.sqrt(125000.0))


def test_the_science_fibre_is_not_where_the_camera_s_fibre_says():
    """What the camera sees comes to its goal; the arm's other fibre does not, and only the truth says so."""
    plane = fl.FocalPlane.of("sdssv", n=N)
    field = fl.Field.twin(plane, camera="noise", seed=3, errors="fibre")
    observed = field.run.observe(random_targets(plane, 60, 3), corrections=1)
    last = observed.summary()["moves"][-1]
    off_um = np.concatenate([1e3 * np.hypot(*mm.T) for mm in field.source.units.fibre_offset_mm.values()])
    assert max(last["measured_rms_um"], last["true_metrology_rms_um"]) < 3.0
    assert 0.5 * off_um.min() < last["true_rms_um"] < off_um.max()
    assert last["true_rms_um"] > 2.0 * last["true_metrology_rms_um"]
    told = observed.summary()["put_in"]["science fibres against the metrology fibre"]
    assert "BOSS 9 along and 8.3 um across" in told


@pytest.mark.slow
def test_a_wrong_table_of_fiducials_does_not_slow_the_corrections():
    """It is the same in every image: weighed as noise, it would keep them from their goals as measured."""
    plane = fl.FocalPlane.of("sdssv", n=61)
    field = fl.Field.twin(plane, seed=0, errors="fiducial=2")
    last = field.run.observe(random_targets(plane, 500, 3), corrections=2).summary()["moves"][-1]
    assert last["measured_rms_um"] < 2.0
    assert last["true_metrology_rms_um"] > 2.0 * last["measured_rms_um"]


def test_a_comparison_is_no_move_of_the_observation(seen):
    compared = replace(seen.moves[-1], number=3, comparison=True)
    observed = replace(seen, moves=[*seen.moves, compared])
    assert observed.final is observed.moves[1]
    assert observed.summary()["motion_s"] == pytest.approx(seen.summary()["motion_s"])
    assert "7 with a target, 2 moves, " in repr(observed)


def test_what_is_faulty_or_parked_does_not_count(seen):
    status = [FibreStatus.ON_TARGET] * N
    status[1], status[2], status[3] = FibreStatus.DEAD, FibreStatus.PARKED, FibreStatus.BLOCKED
    observed = with_errors(seen, [1.0, 99.0, 99.0, 99.0, 1.0, 1.0, 7.0], status)
    summary = observed.summary()
    assert (summary["n_valid"], summary["n_within_requirement"]) == (4, 3)
    named = [int(i) for i in seen.plane.positioner_id]
    assert summary["faults"] == {"dead": [named[1]], "blocked": [named[3]]}
    # the last one is on target as measured, and 7 um off in truth
    assert summary["not_on_target"] == {"dead": 1, "parked": 1, "blocked": 1, "truly_off_target": 1}
    assert summary["share_within_requirement"] == pytest.approx(3 / 7)
    last = summary["moves"][-1]
    assert (last["healthy"]["n"], last["not_healthy"]["n"]) == (4, 3)
    assert last["healthy"]["rms_um"] == pytest.approx(np.sqrt((3 * 1.0 + 49.0) / 4))
    assert last["not_healthy"]["rms_um"] == pytest.approx(99.0)
    assert last["healthy"]["share_within_requirement"] == pytest.approx(3 / 4)
    assert repr(observed).endswith("2 moves, 3 within 5 um)")
    title = observed.plot().get_title()
    assert title == "3 of 7 assigned fibres within 5 µm after move 2; 2 positioners flagged"


def test_the_table_has_a_row_for_every_positioner_and_move_in_units(seen):
    table = with_errors(seen, np.full(N, 2.0)).table()
    assert table["move"].tolist() == [1] * N + [2] * N
    assert table["x_target_mm"].unit == table["y_true_mm"].unit == u.mm
    assert table["alpha_deg"].unit == u.deg
    assert table["error_um"].unit == u.um
    assert table["status"].unit is None
    last = table[N:]
    np.testing.assert_allclose((last["x_true_mm"] - last["x_target_mm"]).to_value(u.um), 2.0, atol=1e-9)
    np.testing.assert_allclose(last["error_um"].to_value(u.um), 2.0, atol=1e-9)


def test_without_the_truth_the_measured_error_counts(seen):
    observed = with_errors(seen, np.full(N, 1.5))
    last = replace(observed.moves[-1], true_mm=None)
    observed = replace(observed, moves=[last])
    assert observed.true_error_um(last) is None
    assert observed.summary()["moves"][0]["true_rms_um"] is None
    np.testing.assert_allclose(observed.error_um(last), 3.0)
    assert np.isnan(observed.table()["x_true_mm"].value).all()


def test_a_plot_is_drawn_where_it_is_told(seen):
    from matplotlib.figure import Figure

    axes = Figure().add_subplot()
    assert seen.plot(axes) is axes
    assert seen.plot() is not axes


def test_nothing_moved_is_nothing_to_show(seen, tmp_path):
    empty = replace(seen, moves=[])
    assert repr(empty) == f"Observation('sdssv', {N} positioners, {N} with a target, 0 moves)"
    for shown in (empty.plot, lambda: empty.save(tmp_path)):
        with pytest.raises(InputError, match="no move was made"):
            shown()


def test_every_error_of_the_file_can_be_worked_out_from_its_columns(seen, tmp_path):
    seen.save(tmp_path)
    table = Table.read(tmp_path / "fibres.ecsv")
    for place, goal, error in (
        ("measured", "metrology_goal", "measured_error_um"),
        ("true", "target", "true_error_um"),
    ):
        apart_mm = [np.asarray(table[f"{axis}_{place}_mm"] - table[f"{axis}_{goal}_mm"]) for axis in "xy"]
        np.testing.assert_allclose(1e3 * np.hypot(*apart_mm), table[error], atol=1e-6)
        assert (table[error] > 0.0).all()
    # the two fibres are 0.7 mm apart: neither place can stand for the other
    assert (
        np.hypot(*(np.asarray(table[f"{a}_target_mm"] - table[f"{a}_metrology_goal_mm"]) for a in "xy")).min()
        > 0.5
    )
    np.testing.assert_array_equal(table["error_um"], table["true_error_um"])


def test_grades_and_flags_tell_everything_that_is_known(seen):
    status = [FibreStatus.ON_TARGET] * N
    status[1], status[2], status[4] = FibreStatus.DEAD, FibreStatus.BLOCKED, FibreStatus.LYING
    observed = with_errors(seen, [4.9, 5.1, 30.1, 29.9, 1.0, np.nan, 5.0], status)
    last = observed.table()[N:]
    assert last["grade"].tolist() == ["good", "poor", "bad", "poor", "good", "unknown", "good"]
    assert last["flags"].tolist() == [0, 512 + 8, 16 + 8, 8, 32, 0, 0]
    dark = replace(observed.moves[-1].measurement, seen=np.arange(N) > 0, ambiguous=np.arange(N) == 0)
    stopped = replace(observed.moves[-1], measurement=dark, interrupted=True, comparison=True)
    flags = replace(observed, moves=[stopped]).table()["flags"]
    assert flags[0] == 2 + 4 + 2048 + 4096
    parked = replace(observed.assignment, target=np.where(np.arange(N) == 3, -1, observed.assignment.target))
    without = replace(observed, assignment=parked).table()[N:]
    assert (without["grade"][3], without["flags"][3]) == ("", 1)


def test_the_bits_are_those_of_the_manual(seen, tmp_path):
    page = (Path(__file__).resolve().parents[2] / "docs" / "files.md").read_text()
    bits = {name: int(bit) for bit, name in re.findall(r"^\| (\d+) \| `([A-Z_]+)` \|", page, re.MULTILINE)}
    assert bits == {flag.name: int(flag) for flag in FibreFlag}
    seen.save(tmp_path)
    table = Table.read(tmp_path / "fibres.ecsv")
    assert table.meta["flags"] == bits
    columns = re.findall(r"`([a-z_]+)`", page.split("## fibres.ecsv")[1].split("| bit |")[0])
    assert set(table.colnames) <= set(columns)
