"""`fiberloom commission`: its files, its refusals, its exit codes."""

import json
import re
import signal
import time

import numpy as np
import pytest
from programs import start
from typer.testing import CliRunner

from fiberloom.cli.app import app
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import draw_units
from fiberloom.twin.bench import seed_of_serial

QUICK = ("--places", 2, "--span", 20, "--points", 16, "--visits", 5, "--targets", 2)
MEASUREMENTS = ("friction", "inertia", "stiffness", "arms", "repeatability")


def run(*words):
    return CliRunner().invoke(app, ["commission", *map(str, QUICK), *map(str, words)])


def units_of(folder):
    return json.loads((folder / "commissioning.json").read_text())["units"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """One unit through all of it, the acceptance too."""
    out = tmp_path_factory.mktemp("whole")
    return run("--serial", "S<1>", "--out", out), out


def test_a_unit_is_commissioned_and_handed_over_to_the_acceptance(whole):
    found, out = whole
    (unit,) = units_of(out)
    assert unit["commissioned"], found.output
    assert unit["in_force"] == "new"
    assert unit["accepted"] is not None
    assert found.exit_code == (0 if unit["accepted"] else 1)
    assert "1 of 1 commissioned, read back and saved" in " ".join(found.output.split())
    for name in MEASUREMENTS:
        assert (out / f"{name}.json").is_file(), name
    for name in ("acceptance.json", "transmission.npz", f"parameters-{unit['positioner_id']}.json"):
        assert (out / name).is_file(), name


def test_what_was_found_is_the_unit_within_its_errors(whole):
    _, out = whole
    (unit,) = units_of(out)
    plane = generate(load_instrument("sdssv"), 0, n_positioners=1)
    true = draw_units(plane, seed_of_serial(0, "S<1>"), firmware="true").firmware[0]
    checked = 0
    for p in unit["parameters"]:
        if p["origin"] == "measured" and p["parameter"] != "torque_per_volt":
            axis = ("alpha", "beta").index(p["axis"])
            off = p["value"] - float(true[axis][p["parameter"]])
            assert abs(off) < 5.0 * p["standard_error"], p
            checked += 1
    assert checked == 14
    # the factory's are farther off: commissioning had something to do
    inertia = next(p for p in unit["parameters"] if p["parameter"] == "cogging_phase")
    assert abs(inertia["factory"] - float(true[0]["cogging_phase"])) > 100 * inertia["standard_error"]


def test_the_page_is_self_contained_escaped_and_to_sign(whole):
    _, out = whole
    (unit,) = units_of(out)
    page = (out / unit["report"]).read_text()
    assert not re.search(r'(?:src|href)="(?!data:)', page)
    assert "S&lt;1&gt;" in page
    assert 'class="verdict pass"' in page
    for words in ("Signature", "alpha inertia", "Eq. 12", "Kept from the factory", "stiffness", "l_alpha"):
        assert words in page, words


def test_the_parameter_file_holds_what_was_written(whole):
    _, out = whole
    (unit,) = units_of(out)
    content = json.loads((out / f"parameters-{unit['positioner_id']}.json").read_text())
    for p in unit["parameters"]:
        assert content["parameters"][p["axis"]][p["parameter"]] == np.float32(p["value"]), p


def test_earlier_results_are_taken_and_what_is_missing_is_measured(whole, tmp_path):
    _, out = whole
    earlier = tmp_path / "earlier"
    earlier.mkdir()
    for name in ("friction", "inertia"):
        (earlier / f"{name}.json").write_text((out / f"{name}.json").read_text())
    found = run("--from", earlier, "--no-acceptance", "--out", tmp_path / "out")
    assert found.exit_code == 0, found.output
    (first,), (second,) = units_of(out), units_of(tmp_path / "out")
    for a, b in zip(first["parameters"], second["parameters"], strict=True):
        if a["origin"] in ("measured", "derived"):
            assert a["value"] == b["value"]
    assert not (tmp_path / "out" / "friction.json").exists()
    assert (tmp_path / "out" / "stiffness.json").exists()
    assert second["accepted"] is None


def test_results_of_other_units_are_refused(whole, tmp_path):
    _, out = whole
    found = run("--from", out, "--seed", 1, "--no-acceptance", "--out", tmp_path)
    assert isinstance(found.exception, InputError)
    assert "it was measured on other units" in str(found.exception)


def test_files_only_writes_nothing_over_the_bus(whole, tmp_path):
    _, out = whole
    found = run("--from", out, "--file", "--no-acceptance", "--out", tmp_path)
    assert found.exit_code == 0, found.output
    (unit,) = units_of(tmp_path)
    assert unit["in_force"] == "old"
    assert "nothing written" in " ".join(found.output.split())
    assert (tmp_path / f"parameters-{unit['positioner_id']}.json").is_file()


def test_a_unit_whose_arm_does_not_follow_is_refused_and_the_other_is_not(tmp_path):
    found = run("--positioners", 2, "--faults", "lying=1", "--no-acceptance", "--out", tmp_path)
    assert found.exit_code == 1
    units = units_of(tmp_path)
    assert sorted(u["commissioned"] for u in units) == [False, True]
    (bad,) = [u for u in units if not u["commissioned"]]
    assert any("alpha did not move" in reason for reason in bad["reasons"])
    assert bad["in_force"] == "old"
    assert not (tmp_path / f"parameters-{bad['positioner_id']}.json").exists()
    assert "alpha did not move" in " ".join(found.output.split())
    assert 'class="verdict fail"' in (tmp_path / bad["report"]).read_text()


def test_json_for_machines(whole, tmp_path):
    _, out = whole
    found = run("--from", out, "--no-acceptance", "--json", "--out", tmp_path)
    assert json.loads(found.output)["units"][0]["commissioned"] is True


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--positioners", 2, "--serial", "7"), "commission one at a time"),
        (("--from", "no-such-folder"), "no such folder"),
    ],
)
def test_bad_input_is_told_before_anything_is_measured(words, told, tmp_path):
    found = run(*words, "--out", tmp_path)
    assert told in str(found.exception)
    assert isinstance(found.exception, InputError)


def test_a_file_that_is_none_of_ours_is_named(whole, tmp_path):
    (tmp_path / "friction.json").write_text("[1, 2]")
    found = run("--from", tmp_path, "--no-acceptance", "--out", tmp_path / "out")
    assert "friction.json: not a result of `fiberloom calibrate`" in str(found.exception)


@pytest.mark.slow
def test_ctrl_c_keeps_what_was_measured(tmp_path):
    words = [*map(str, QUICK), "--visits", "3000", "--out", str(tmp_path)]
    process = start("commission", *words)
    end = time.monotonic() + 240.0
    while not (tmp_path / "arms.json").exists():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < end, "arms were never measured"
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert stderr.strip().splitlines()[-1].startswith("fiberloom: interrupted")
    assert "Traceback" not in stderr
    for name in ("friction", "inertia", "stiffness"):
        assert json.loads((tmp_path / f"{name}.json").read_text())["positioners"]
