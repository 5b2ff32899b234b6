"""A site file: every field is read, what is typed comes first, mistakes are named."""

import pytest
import typer
from typer.testing import CliRunner

from fiberloom.cli.app import app
from fiberloom.cli.array import doctor as doctor_command
from fiberloom.cli.array.site import BENCH, Limits, Site, load_site
from fiberloom.cli.calibrate import transmission as transmission_command
from fiberloom.errors import InputError

FULL = """
bus = "cannet://10.1.10.31"
camera = "alpaca://10.1.10.40:11111/0?exposure=5"
instrument = "sdssv"
layout = "layout"
positioners = 7
seed = 3
calibration = "maps.npz"
arms = "arms.ecsv"
store = "arrays.sqlite"
exclude = [12, 40]

[limits]
disk_mb = 2000
calibration_days = 30
clock_s = 0.5
"""


@pytest.fixture
def site(tmp_path):
    path = tmp_path / "apo.toml"
    path.write_text(FULL)
    return path


def given(path, monkeypatch, *words):
    """The options that `doctor` gets, and its exit code."""
    got = []
    monkeypatch.setattr(doctor_command.DoctorOptions, "check", lambda options: got.append(options) or 1 / 0)
    CliRunner().invoke(app, ["--site", str(path), "doctor", *words])
    return got[0]


def test_every_field_reaches_the_options(site, monkeypatch, tmp_path):
    options = given(site, monkeypatch)
    assert (options.bus, options.camera) == ("cannet://10.1.10.31", "alpaca://10.1.10.40:11111/0?exposure=5")
    assert (options.instrument, options.positioners, options.seed) == ("sdssv", 7, 3)
    assert options.layout == tmp_path / "layout"
    assert (options.calibration, options.arms) == (tmp_path / "maps.npz", tmp_path / "arms.ecsv")
    assert options.store == str(tmp_path / "arrays.sqlite")
    assert options.exclude == "12,40"
    assert (options.disk_mb, options.calibration_days, options.clock_s) == (2000.0, 30.0, 0.5)
    passed = set(load_site(site).defaults()["doctor"])
    assert passed == (set(Site.model_fields) - {"limits"}) | set(Limits.model_fields)


def test_a_site_names_the_array_that_is_calibrated(site, monkeypatch, tmp_path):
    got = []
    monkeypatch.setattr(
        transmission_command.TransmissionOptions, "check", lambda options: got.append(options) or 1 / 0
    )
    CliRunner().invoke(app, ["--site", str(site), "calibrate", "transmission"])
    (options,) = got
    assert (options.bus, options.camera) == ("cannet://10.1.10.31", "alpaca://10.1.10.40:11111/0?exposure=5")
    assert (options.positioners, options.layout, options.exclude) == (7, tmp_path / "layout", "12,40")
    assert options.store == str(tmp_path / "arrays.sqlite")


@pytest.mark.parametrize("command", ["transmission", "focal-plane"])
def test_what_a_site_says_of_an_array_are_options_of_the_calibrations_that_move_one(site, command):
    calibrate = typer.main.get_command(app).commands["calibrate"].commands[command]
    options = {option.name for option in calibrate.params}
    assert {"bus", "camera", "store", "exclude", "layout", "instrument", "positioners", "seed"} <= options
    assert set(load_site(site).defaults()["calibrate"][command]) - options <= {"calibration", "arms"}


@pytest.mark.parametrize(
    "words",
    [*(("calibrate", name) for name in BENCH), ("acceptance",), ("commission",)],
    ids=lambda words: words[-1],
)
def test_what_measures_single_units_refuses_the_bus_of_a_site(tmp_path, words):
    path = tmp_path / "apo.toml"
    path.write_text('bus = "cannet://10.1.10.31"\n')
    result = CliRunner().invoke(app, ["--site", str(path), *words, "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, InputError)
    assert "--bus cannet://10.1.10.31: single units" in str(result.exception)
    assert not (tmp_path / "out").exists()


def test_what_is_typed_comes_first(site, monkeypatch):
    options = given(site, monkeypatch, "--bus", "socketcan:can0", "--exclude", "9")
    assert (options.bus, options.exclude, options.seed) == ("socketcan:can0", "9", 3)


def test_a_field_that_is_not_there_changes_nothing(tmp_path, monkeypatch):
    path = tmp_path / "small.toml"
    path.write_text('bus = "twin:"\n')
    options = given(path, monkeypatch)
    assert (options.bus, options.camera, options.instrument, options.exclude) == ("twin:", None, "sdssv", "")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("bus = 3", "bus"),
        ('buss = "twin:"', "buss"),
        ("[limits]\ndisk_mb = -1", "limits.disk_mb = -1"),
        ("bus =", "not valid TOML"),
    ],
)
def test_mistakes_are_named(tmp_path, text, said):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        load_site(path)
    with pytest.raises(InputError, match=r"--site .*none\.toml: no such file"):
        load_site(tmp_path / "none.toml")
