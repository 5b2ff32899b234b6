"""The model of an instrument: what it accepts, and what it says when it does not."""

import copy
import tomllib
from importlib.resources import files

import numpy as np
import pytest
from pydantic import ValidationError

from fiberloom.errors import InputError
from fiberloom.instruments import generate, instrument_names, load_instrument, parse_instrument
from fiberloom.instruments.load import instrument_text


@pytest.fixture
def data():
    text = files("fiberloom.instruments.presets").joinpath("sdssv.toml").read_text()
    return tomllib.loads(text)


@pytest.mark.parametrize("name", instrument_names())
def test_every_preset_loads_under_its_own_name(name):
    assert load_instrument(name).name == name


def test_sdssv_is_the_instrument_of_table_1(sdssv):
    assert sdssv.positioner.l_alpha_mm == 7.4
    assert sdssv.layout.pitch_mm == 22.4
    assert sdssv.operation.requirement_um == 5.0
    assert sdssv.alpha.gear == 1024
    assert sdssv.science_fibres == ("BOSS", "APOGEE")
    inner, outer = sdssv.reach_mm
    # Kronig 2020, Section 2: l_a + l_b = pitch, to reach the centres of the neighbours
    assert outer == pytest.approx(22.37, abs=0.01)
    assert inner == pytest.approx(7.57, abs=0.01)


def test_the_tip_of_the_capsule_is_the_tip_of_the_arm(sdssv):
    # PLANNING.md: 16.2 - (sqrt(2.0^2 + 0.3^2) - 0.55)
    assert sdssv.bodies.beta_segment_mm[1] == pytest.approx(16.2 - ((4.09**0.5) - 0.55), abs=1e-4)


def test_constant_once_read(sdssv):
    with pytest.raises(ValidationError, match="frozen"):
        sdssv.positioner.l_alpha_mm = 8.0


def set_key(data, key, value):
    *path, last = key.split(".")
    for part in path:
        data = data[part]
    data[last] = value


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("positioner.l_alpha_mm", -1.0, ["positioner.l_alpha_mm = -1.0", "greater than 0"]),
        ("positioner.l_alpha_mm", float("nan"), ["positioner.l_alpha_mm", "finite number"]),
        ("positioner.l_alpha_mm", "long", ["positioner.l_alpha_mm = 'long'", "valid number"]),
        ("positioner.l_gamma_mm", 1.0, ["positioner.l_gamma_mm = 1.0", "not permitted"]),
        ("alpha.target_range_deg", [360.0, 0.0], ["alpha", "low must be below high"]),
        ("alpha.hard_stop_deg", [0.0, 360.0], ["alpha", "hard_stop_deg", "approach of 0.82"]),
        ("alpha.target_range_deg", [-400, 360], ["alpha", "hard_stop_deg"]),
        ("alpha.kind", "steam", ["alpha.kind = 'steam'", "'bldc', 'stepper' or 'piezo'"]),
        ("alpha.approach_deg", 0.1, ["approach_deg 0.1 must exceed backlash_deg 0.244"]),
        ("beta.gear", 0.0, ["beta.gear = 0.0", "greater than 0"]),
        ("positioner.park_deg", [10.0, 190.0], ["park_deg: beta 190.0 is outside"]),
        ("positioner.points.BOSS.fraction", 0.0, ["fraction = 0.0", "greater than 0"]),
        ("positioner.points.BOSS.role", "metrology", ["points.BOSS", "named 'metrology'"]),
        ("positioner.points.metrology.role", "science", ["role must be 'metrology'"]),
        ("positioner.points.metrology.fraction", 0.5, ["every positioner has it"]),
        ("metrology.sees", "SPARK", ["metrology.sees = 'SPARK'", "no such point"]),
        ("metrology.sees", "APOGEE", ["metrology.sees = 'APOGEE'", "only a part"]),
        ("metrology.present", False, ["operation.corrections_max = ", "need a camera"]),
        ("bodies.beta_segment_mm", [5.0, 5.0], ["beta_segment_mm", "from must be below to"]),
        ("layout.rings", 3, ["n_positioners 500", "3 rings have only 37 holes"]),
        ("layout.fiducial_lattice", [0, 0], ["fiducial_lattice [0, 0] is no step"]),
        ("layout.fiducial_lattice", [3, -(10**18)], ["fiducial_lattice: a step of more than 1000 holes"]),
        ("layout.outer_fiducial_directions_deg", [], ["outer_fiducial_radius_mm", "or neither"]),
        ("scatter.l_alpha_mm.min", 7.5, ["mean 7.3886 must lie between min 7.5"]),
        ("name", "SDSS V", ["name = 'SDSS V'", "match pattern"]),
    ],
)
def test_a_bad_value_is_named_with_its_rule(data, key, value, words):
    changed = copy.deepcopy(data)
    set_key(changed, key, value)
    with pytest.raises(InputError) as caught:
        parse_instrument(changed, "mine.toml")
    message = str(caught.value)
    assert message.startswith("mine.toml: ")
    assert "\n" not in message
    for word in words:
        assert word in message


def test_all_problems_are_told_at_once(data):
    data["positioner"]["l_alpha_mm"] = -1
    data["bodies"]["collision_buffer_mm"] = 0
    data["alpha"]["gear"] = "ten"
    data["beta"]["backlash_deg"] = 1.0
    with pytest.raises(InputError) as caught:
        parse_instrument(data, "mine.toml")
    message = str(caught.value)
    assert message.startswith("mine.toml: 4 problems: ")
    for told in (
        "positioner.l_alpha_mm = -1: Input should be greater than 0; ",
        "alpha.gear = 'ten': Input should be a valid number",
        "beta: approach_deg 0.82 must exceed backlash_deg 1.0; ",
        "bodies.collision_buffer_mm = 0: Input should be greater than 0",
    ):
        assert told in message
    assert "\n" not in message


def test_tables_that_contradict_each_other_are_all_told(data):
    data["positioner"]["park_deg"] = [-10.0, 190.0]
    data["metrology"]["sees"] = "SPARK"
    with pytest.raises(InputError) as caught:
        parse_instrument(data, "mine.toml")
    for told in ("metrology.sees = 'SPARK'", "park_deg: alpha -10.0 is", "park_deg: beta 190.0 is"):
        assert told in str(caught.value)


def test_a_file_of_another_kind_has_too_many_problems_to_tell(data):
    with pytest.raises(InputError, match=r"instrument.toml: \d+ problems: .*; and \d+ more$") as caught:
        parse_instrument(dict.fromkeys((f"key{k}" for k in range(40)), 1), "instrument.toml")
    assert len(str(caught.value)) < 1500


@pytest.mark.parametrize("left_out", ["scatter", "scatter.l_alpha_mm", "scatter.l_alpha_mm.mean"])
def test_scatter_that_is_left_out_is_none(data, left_out):
    *path, last = left_out.split(".")
    table = data
    for part in path:
        table = table[part]
    del table[last]
    if left_out == "scatter.l_alpha_mm.mean":
        table.pop("min")
        table.pop("max")
    instrument = parse_instrument(data, "x")
    assert instrument.scatter.l_alpha_mm.mean == instrument.positioner.l_alpha_mm
    plane = generate(instrument, 0, 7)
    spread = 0.0314 if "mean" in left_out else 0.0
    assert np.abs(plane.l_alpha_mm - 7.4).max() <= 4 * spread
    if left_out == "scatter":
        np.testing.assert_array_equal(plane.points["BOSS"], np.tile([14.965, -0.376], (7, 1)))


@pytest.mark.parametrize("name", instrument_names())
def test_the_text_of_a_preset_is_the_preset(name, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(instrument_text(name))
    assert load_instrument(path) == load_instrument(name)


def test_a_missing_table_is_named(data):
    del data["bodies"]
    with pytest.raises(InputError, match="bodies: Field required"):
        parse_instrument(data, "mine.toml")


def test_own_file(tmp_path):
    text = files("fiberloom.instruments.presets").joinpath("sdssv.toml").read_text()
    path = tmp_path / "mine.toml"
    path.write_text(text.replace('name = "sdssv"', 'name = "mine"'))
    assert load_instrument(path).name == "mine"


@pytest.mark.parametrize(
    ("content", "words"),
    [(None, "neither a preset"), (b"name = ", "not valid TOML"), (b"\xff", "not a text file")],
)
def test_files_that_are_no_instrument(tmp_path, content, words):
    path = tmp_path / "x.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=words):
        load_instrument(path)


def test_the_twin_may_put_what_it_likes_into_its_table(data):
    data["twin"] = {"anything": {"mean": 1.0}}
    assert parse_instrument(data, "x").twin["anything"] == {"mean": 1.0}


@pytest.mark.parametrize(
    ("key", "value", "protocol"),
    [
        ("alpha.gear", 1024.0, "sdssv"),
        ("alpha.gear", 1000.0, "none"),
        ("beta.closed_loop", False, "none"),
        ("beta.kind", "stepper", "none"),
        ("drive", {"protocol": "desi"}, "desi"),
    ],
)
def test_the_protocol_follows_from_the_motors_where_it_is_left_out(data, key, value, protocol):
    del data["drive"]
    set_key(data, key, value)
    assert parse_instrument(data, "x").drive.protocol == protocol


def test_presets_name_their_protocols():
    named = {name: load_instrument(name).drive.protocol for name in instrument_names()}
    spoken = {name: name for name in ("desi", "lamost", "megara", "moons", "pfs", "sdssv")}
    assert named == {name: spoken.get(name, "none") for name in named}
