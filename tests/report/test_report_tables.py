"""Tables at the terminal and records in files: columns, units, and what is said where there is no value."""

import numpy as np
import pytest
from rich.console import Console

from fiberloom.calibration.bench.estimate import Fitted, Residuals, estimate
from fiberloom.errors import InputError
from fiberloom.instruments import load_instrument
from fiberloom.report.estimates import estimate_records, estimate_rows
from fiberloom.report.folder import prepare_file, prepare_folder
from fiberloom.report.outputs import marks
from fiberloom.report.tables import (
    observation_table,
    overview,
    print_estimates,
    print_report,
    shortfall,
    spread_table,
)

MOVE = {
    "label": "blind",
    "interrupted": False,
    "measured_rms_um": 41.237,
    "true_metrology_rms_um": None,
    "guided_rms_um": None,
    "true_rms_um": None,
    "p95_um": 80.0,
    "max_um": 99.999,
    "n_within_requirement": 3,
    "n_fibres": 37,
}
SUMMARY = {"n_within_requirement": 36, "n_assigned": 37, "requirement_um": 5.0, "moves": [MOVE]}


def printed(table, width=160):
    console = Console(width=width, color_system=None)
    with console.capture() as capture:
        console.print(table)
    return capture.get()


def cells(table):
    """Rows of texts."""
    return list(zip(*(column.cells for column in table.columns), strict=True))


def test_an_observation_ends_in_one_row_a_move_with_units_in_the_heads():
    stopped = MOVE | {"label": "correction 1", "interrupted": True}
    table = observation_table(SUMMARY | {"moves": [MOVE, stopped]})
    assert [c.header for c in table.columns] == [
        "move",
        "measured\n[µm]",
        "metrology\n[µm]",
        "science\n[µm]",
        "guided\n[µm]",
        "95 %\n[µm]",
        "worst\n[µm]",
        "within\n5 µm",
    ]
    assert cells(table) == [
        ("blind", "41.24", "-", "-", "-", "80.00", "100.00", "3/37"),
        ("correction 1: stopped", "-", "-", "-", "-", "-", "-", "-"),
    ]
    assert table.title == "36 of 37 assigned fibres within 5 µm of their targets"
    assert "41.24" in printed(table)


def test_healthy_units_and_others_have_rows_of_their_own():
    good = {"n": 30, "rms_um": 2.5, "p95_um": 4.4, "p99_um": 5.6, "share_within_requirement": 0.9499}
    lost = {"n": 2, "rms_um": None, "p95_um": None, "p99_um": None, "share_within_requirement": 0.0}
    move = MOVE | {"healthy": good, "not_healthy": lost}
    table = spread_table(SUMMARY | {"moves": [move, move | {"not_healthy": lost | {"n": 0}}]})
    # no share is rounded up to what is required
    assert cells(table) == [
        ("blind", "healthy", "30", "2.50", "4.40", "5.60", "94.9 %"),
        ("blind", "others", "2", "-", "-", "-", "0.0 %"),
        ("blind", "healthy", "30", "2.50", "4.40", "5.60", "94.9 %"),
    ]
    assert "as measured" in printed(table, 80)
    assert "…" not in printed(table, 80)


def test_no_figure_is_cut_at_80_columns():
    label = {"label": "blind, round faults 2"}
    wide = MOVE | label | {"n_within_requirement": 496, "true_rms_um": 1234.5, "guided_rms_um": 1234.5}
    text = printed(observation_table(SUMMARY | {"moves": [wide, wide | {"interrupted": True}]}), 80)
    assert "…" not in text
    assert text.count("1234.50") == 2
    assert "stopped" in text
    assert "496/37" in text


def test_what_falls_short_is_told_by_count():
    told = {"n_positioners": 40, "n_targets": 100, "n_assigned": 37, "n_within_requirement": 36}
    told |= {"not_on_target": {"truly_off_target": 1}, "not_assigned": {"out of reach": 60, "collision": 3}}
    assert shortfall(told, 0.9) == []
    assert shortfall(told, 0.95)[0] == "not assigned: 60 out of reach, 3 collision"
    assert shortfall(told | {"n_targets": 38}, 1.0) == [
        "not assigned: 60 out of reach, 3 collision",
        "not on target: 1 truly off target",
        "below what is required: 36 of 37 (97.2 %) on target, at least 100 % must be",
    ]
    # nothing on target is never enough
    assert shortfall(told | {"n_within_requirement": 0}, 0.0)[-1].startswith(
        "below what is required: 0 of 37"
    )


def test_a_report_is_two_columns_a_list_of_them_one_table(capsys):
    print_report({"error_um": 1.23456, "of_which": {"x_um": 0.5, "n": 3}, "ids": [1, (2.0, "three")]})
    said = [line.split() for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert said == [
        ["error", "um", "1.235"],
        ["of", "which", "x_um:", "0.5"],
        ["n:", "3"],
        ["ids", "1"],
        ["2"],
        ["three"],
    ]
    print_report([{"row_id": 1, "off_um": 2.0}, {"row_id": 2, "off_um": 0.123456}])
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if line.strip(" ─")]
    assert lines == [["row", "id", "off", "um"], ["1", "2"], ["2", "0.1235"]]
    print_report({"not_known": None})
    assert capsys.readouterr().out.split() == ["not", "known", "-"]
    print_report([])
    assert capsys.readouterr().out == "nothing to show\n"


def two_rows(name="alpha_phase", unit="rad", value=(3.0, np.nan), reason=("", "stalled")):
    residuals = np.array([[0.3, -0.4], [np.nan, np.nan]])
    fitted = Fitted(np.array(value), np.array([0.1, 0.1]))
    return estimate(name, unit, fitted, Residuals(residuals, "rad"), reason)


@pytest.fixture(scope="module")
def pair(sdssv):
    from fiberloom.instruments import generate

    return generate(sdssv, seed=0, n_positioners=2)


def test_records_of_estimates_hold_values_truths_and_refusals(pair):
    content = estimate_records(pair, 4, [two_rows()], {"alpha_phase": np.array([-3.0, 1.0])})
    assert content["seed"] == 4
    assert content["config_hash"] == pair.config_hash()
    good, bad = (p["estimates"]["alpha_phase"] for p in content["positioners"])
    # an angle is off by the short way round: 6 rad are 0.283 rad the other way
    assert good["off_by_se"] == pytest.approx((6.0 - 2 * np.pi) / 0.1)
    assert good["residual_rms"] == pytest.approx(np.sqrt((0.09 + 0.16) / 2))
    assert good["n"] == 2
    assert bad == {"unit": "rad", "value": None, "reason": "stalled"}
    plain = estimate_records(pair, 4, [two_rows("l_alpha", "mm")], {"l_alpha": np.array([-3.0, 1.0])})
    assert plain["positioners"][0]["estimates"]["l_alpha"]["off_by_se"] == pytest.approx(60.0)


def test_rows_of_estimates_are_printed_by_positioner(pair, capsys):
    content = estimate_records(pair, 4, [two_rows()], {"alpha_phase": np.array([-3.0, 1.0])})
    rows = estimate_rows(content)
    assert [row["reason"] for row in rows] == ["", "stalled"]
    assert [row["positioner_id"] for row in rows] == pair.positioner_id.tolist()
    assert "true" not in rows[1]
    print_estimates(rows)
    out = capsys.readouterr().out
    first, second = pair.positioner_id
    assert out.index(f"positioner {first}") < out.index(f"positioner {second}")
    assert out.count("off/s.e.") == 2
    assert "-2.83" in out
    assert "refused: stalled" in out
    print_estimates([{k: v for k, v in rows[0].items() if k not in ("true", "off_by_se")}])
    assert "off/s.e." not in capsys.readouterr().out


def test_estimates_that_do_not_exist_say_why():
    one = two_rows()
    assert one.ok.tolist() == [True, False]
    assert len(one) == 2
    with pytest.raises(InputError, match="alpha_phase: stalled"):
        one.of(1)
    with pytest.raises(InputError, match=r"alpha_phase: stalled \(and 1 more, all refused\)"):
        two_rows(reason=("stalled", "not seen"))


def test_a_scaled_estimate_carries_the_error_of_its_scale():
    one = two_rows(value=(3.0, np.nan)).scaled(2.0, 0.05, unit="deg", name="other")
    value, error = one.of(0)
    assert (one.name, one.unit, value) == ("other", "deg", 6.0)
    assert error == pytest.approx(np.hypot(0.2, 0.3))
    low, high = one.interval()
    assert low[0] < 6.0 < high[0]
    # two standard errors at large freedom
    assert high[0] - 6.0 == pytest.approx(1.95996 * error, rel=1e-4)


def test_every_result_carries_the_same_marks(pair):
    made = marks(pair, 7)
    assert list(made) == ["version", "seed", "instrument", "config_hash", "utc"]
    assert (made["seed"], made["instrument"]) == (7, "sdssv")
    assert made["utc"].endswith("+00:00")


@pytest.mark.parametrize("name", ["sdssv", "desi", "pfs"])
def test_an_instrument_in_one_line(name):
    i = load_instrument(name)
    line = overview(i)
    assert (line["name"], line["positioners"]) == (name, i.layout.n_positioners)
    alpha, beta = (float(part) for part in line["arms_mm"].split(" / "))
    assert (alpha, beta) == (i.positioner.l_alpha_mm, i.positioner.points[i.seen_point].x_mm)
    assert line["requirement_um"] == i.operation.requirement_um
    assert line["images"] == ("yes" if i.camera else "no")


def test_a_folder_is_proven_to_be_writable_and_left_empty(tmp_path):
    out = tmp_path / "a" / "b"
    assert prepare_folder(out) == out
    assert list(out.iterdir()) == []
    (tmp_path / "file").write_text("kept")
    with pytest.raises(InputError, match=r"--out .*file.*: cannot write there .*; choose another folder"):
        prepare_folder(tmp_path / "file" / "below")
    with pytest.raises(InputError, match=r"^--animate .*file.*: cannot write there"):
        prepare_folder(tmp_path / "file" / "below", "--animate")


def test_a_file_is_proven_to_be_writable_and_keeps_its_content(tmp_path):
    path = tmp_path / "new" / "result.json"
    prepare_file(path)
    assert list(path.parent.iterdir()) == []  # what fails later leaves nothing empty behind
    path.write_text("kept")
    prepare_file(path)
    assert path.read_text() == "kept"
    with pytest.raises(InputError, match=r"--out .*new: cannot be written \(it is a folder\); give the name"):
        prepare_file(tmp_path / "new")
    with pytest.raises(InputError, match=r"--plot .*result.json/x: cannot write there"):
        prepare_file(path / "x", "--plot")
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "elsewhere")
    prepare_file(link)
    assert link.is_symlink()


def test_a_file_that_is_read_is_not_written(tmp_path):
    read = tmp_path / "a.csv"
    read.write_text("kept")
    (tmp_path / "b.csv").symlink_to(read)
    for path in (read, tmp_path / "." / "a.csv", tmp_path / "b.csv"):
        with pytest.raises(InputError, match=r"--out .*csv: is read by this command; give another name"):
            prepare_file(path, inputs=(None, tmp_path / "none.csv", read))
    prepare_file(tmp_path / "c.csv", inputs=(read,))


def test_a_table_for_a_file_keeps_its_headings_whole(capsys):
    row = {f"column_{k}_of_a_wide_table": f"value_{k}" for k in range(4)}
    print_report([row])
    heading, *_, values = [line.split() for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert " ".join(heading) == " ".join(row).replace("_", " ")
    assert values == list(row.values())


def test_a_narrow_terminal_folds_a_heading_and_drops_no_letter(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "24")
    monkeypatch.setenv("NO_COLOR", "1")
    print_report([{"positioners": 1, "requirement_um": 2, "images": 3}])
    out = capsys.readouterr().out
    assert "…" not in out
