"""The model of an instrument: what it accepts, and what it says when it does not."""

import copy
import tomllib
from importlib.resources import files

import pytest
from pydantic import ValidationError

from fiberloom.errors import InputError
from fiberloom.instruments import instrument_names, load_instrument, parse_instrument


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


def test_more_problems_are_counted(data):
    data["positioner"]["l_alpha_mm"] = -1
    data["bodies"]["collision_buffer_mm"] = 0
    with pytest.raises(InputError, match=r"\(and 1 more\)"):
        parse_instrument(data, "mine.toml")


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
    spoken = {"desi": "desi", "pfs": "pfs", "sdssv": "sdssv"}
    assert named == {name: spoken.get(name, "none") for name in named}
