"""`fiberloom calibrate friction|stiffness|inertia|arms|repeatability` and `fiberloom acceptance`."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fiberloom.cli.app import app
from fiberloom.errors import InputError
from fiberloom.instruments import presets
from fiberloom.store.listing import runs_below
from fiberloom.tables import read_table

PRESET = Path(presets.__path__[0]) / "sdssv.toml"
MARKS = {"version", "seed", "instrument", "config_hash", "utc", "bench"}


def run(*words):
    return CliRunner().invoke(app, list(map(str, words)))


@pytest.mark.parametrize(
    ("words", "quantities"),
    [
        (("friction", "--places", 2, "--span", 20, "--data-sheet"), {"alpha Coulomb friction", "beta drag"}),
        (("inertia", "--pushes", 2), {"alpha inertia", "beta inertia", "alpha torque at full voltage"}),
        (("coast", "--repeats", 1), {"alpha back-EMF drag", "beta viscous friction", "alpha inertia"}),
        (("stiffness", "--repeats", 3), {"alpha stiffness", "beta stiffness"}),
        (("arms", "--points", 12), {"l_alpha", "l_beta", "centre x"}),
        (("repeatability", "--visits", 5), {"alpha repeatability", "beta angular repeatability"}),
    ],
)
def test_each_identification_leaves_its_files(tmp_path, words, quantities):
    found = run("calibrate", *words, "--truth", "--out", tmp_path)
    assert found.exit_code == 0, found.output
    name = words[0]
    content = json.loads((tmp_path / f"{name}.json").read_text())
    assert content.keys() >= MARKS
    (unit,) = content["positioners"]
    assert unit["estimates"].keys() >= quantities
    for record in unit["estimates"].values():
        assert record["standard_error"] > 0
        assert record["n"] > 0
        # off by more than five standard errors: not honest
        assert abs(record.get("off_by_se", 0.0)) < 5.0
    table = read_table(tmp_path / f"{name}.ecsv")
    assert set(table.strings("quantity")) == unit["estimates"].keys()
    assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    assert "s.e." in found.output
    (row,) = runs_below(str(tmp_path))
    assert row["calibrations"] == f"{name} 1"


def test_the_same_seed_gives_the_same_numbers(tmp_path):
    words = ("calibrate", "stiffness", "--repeats", 3, "--json", "--out")
    a, b = (json.loads(run(*words, tmp_path / name).output) for name in "ab")
    assert a["positioners"] == b["positioners"]
    assert json.loads(run(*words, tmp_path / "c", "--seed", 1).output)["positioners"] != a["positioners"]


def test_a_dark_fibre_is_refused_with_the_reason(tmp_path):
    found = run("calibrate", "arms", "--points", 8, "--faults", "dark=1", "--out", tmp_path)
    assert isinstance(found.exception, InputError)
    assert "calibrate arms, positioner" in str(found.exception)
    assert "is the fibre lit?" in str(found.exception)


def test_one_of_two_refused_is_told_and_exits_1(tmp_path):
    words = ("--positioners", 2, "--points", 8, "--faults", "lying=1", "--out", tmp_path)
    found = run("calibrate", "arms", *words)
    assert found.exit_code == 1
    assert "refused: alpha did not move" in found.output
    records = json.loads((tmp_path / "arms.json").read_text())["positioners"]
    reasons = [r["estimates"]["l_alpha"].get("reason") for r in records]
    assert sorted(map(str, reasons)) == ["None", "alpha did not move"]


QUICK = ("--points", 40, "--targets", 4, "--visits", 5)


def test_acceptance_is_a_page_to_sign(tmp_path):
    found = run("acceptance", *QUICK, "--serial", "S<1>", "--out", tmp_path)
    # the tilt is a requirement, and nobody has measured it
    assert found.exit_code == 1
    assert "serial S<1>: NOT complete" in found.output, found.output
    assert "not measured: tilt of the fibre" in found.output
    (unit,) = json.loads((tmp_path / "acceptance.json").read_text())["units"]
    page = (tmp_path / unit["report"]).read_text()
    # self-contained, for a phone, escaped, with what identifies it and a place to sign
    assert not re.search(r'(?:src|href)="(?!data:)', page)
    assert page.count("data:image/png;base64,") == 3
    assert 'name="viewport"' in page
    assert "S&lt;1&gt;" in page
    for words in ("Signature", "Firmware", "04.01.21", "hysteresis, beta", "0.6 °", "SDSSV.json"):
        assert words in page, words
    by_name = {c["name"]: c for c in unit["checks"]}
    assert by_name["non-linearity, alpha"]["verdict"] == "pass"
    assert by_name["tilt of the fibre"]["verdict"] == "not measured"
    assert (tmp_path / "transmission.npz").is_file()
    assert (unit["accepted"], unit["verdict"], unit["not_measured"]) == (
        False, "not complete", ["tilt of the fibre"],
    )  # fmt: skip
    assert unit["report"] == "acceptance-S-1.html"
    assert "not complete: tilt of the fibre not measured" in page


def test_a_requirement_that_was_measured_elsewhere_is_told(tmp_path):
    for tilt, verdict in ((0.1, "accepted"), (0.9, "not accepted")):
        run("acceptance", *QUICK, "--tilt", tilt, "--out", tmp_path)
        (unit,) = json.loads((tmp_path / "acceptance.json").read_text())["units"]
        others = {c["verdict"] for c in unit["checks"] if "tilt" not in c["name"]}
        assert unit["verdict"] == (verdict if "fail" not in others else "not accepted")
        assert unit["not_measured"] == []


def test_another_serial_number_is_another_unit(tmp_path):
    found = []
    for serial in ("A1", "A2", "A1"):
        run("acceptance", *QUICK, "--serial", serial, "--out", tmp_path)
        (unit,) = json.loads((tmp_path / "acceptance.json").read_text())["units"]
        found.append([c["value"] for c in unit["checks"] if c["name"].startswith("non-linearity")])
    assert found[0] == found[2]
    assert found[0] != found[1]
    assert {p.name for p in tmp_path.glob("*.html")} == {"acceptance-A1.html", "acceptance-A2.html"}


def test_a_unit_that_misses_a_requirement_fails(tmp_path):
    path = tmp_path / "strict.toml"
    path.write_text(PRESET.read_text().replace("non_linearity_deg = 0.6", "non_linearity_deg = 0.01"))
    found = run("acceptance", *QUICK, "--instrument", path, "--out", tmp_path)
    assert found.exit_code == 1
    assert "NOT accepted" in found.output
    (unit,) = json.loads((tmp_path / "acceptance.json").read_text())["units"]
    assert {c["name"] for c in unit["checks"] if c["verdict"] == "fail"} >= {
        "non-linearity, alpha", "non-linearity, beta",
    }  # fmt: skip
    assert 'class="verdict fail"' in (tmp_path / unit["report"]).read_text()


def test_a_unit_that_cannot_be_measured_is_not_accepted(tmp_path):
    words = ("--points", 12, "--targets", 2, "--visits", 5, "--faults", "dark=1", "--out", tmp_path)
    found = run("acceptance", *words)
    assert found.exit_code == 1
    (unit,) = json.loads((tmp_path / "acceptance.json").read_text())["units"]
    assert not unit["accepted"]
    assert "usable" in unit["reason"]
    assert "Not measured" in (tmp_path / unit["report"]).read_text()


def test_one_serial_number_is_for_one_unit(tmp_path):
    found = run("acceptance", "--positioners", 2, "--serial", "7", "--out", tmp_path)
    assert "test one at a time" in str(found.exception)


def test_an_instrument_without_requirements_says_so(tmp_path):
    text = PRESET.read_text()
    path = tmp_path / "plain.toml"
    path.write_text(re.sub(r"\[acceptance\].*?\n\n", "\n", text, flags=re.DOTALL))
    found = run("acceptance", "--instrument", path, "--out", tmp_path)
    assert "add [acceptance]" in str(found.exception)


@pytest.mark.parametrize(
    ("words", "motor"),
    [
        (
            ("calibrate", "friction", "--instrument", "megara"),
            "megara: alpha is a stepper motor",
        ),
        (("calibrate", "inertia", "--instrument", "pfs"), "pfs: alpha is a piezo motor in open loop"),
        (
            ("lifetime", "--instrument", "desi", "--cycles", 2, "--positioners", 1),
            "desi: alpha is a bldc motor",
        ),
    ],
)
def test_motors_that_an_instrument_does_not_have_are_not_measured(words, motor, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=motor):
        CliRunner().invoke(app, list(map(str, words)), catch_exceptions=False)
