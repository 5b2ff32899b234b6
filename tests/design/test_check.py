"""`design check`: each fault that a design can have is found, with numbers; sound designs pass."""

import json
import math

import pytest

from fiberloom.design.check import check
from fiberloom.errors import InputError
from fiberloom.instruments import Instrument, instrument_names, load_instrument
from fiberloom.instruments.load import instrument_text


@pytest.fixture(autouse=True)
def few_springs(monkeypatch):
    """Springs of seven units: drawing them takes most of the time."""
    monkeypatch.setattr("fiberloom.design.check.UNITS", 7)


def changed(name, n=61, **tables):
    """A preset of `n` positioners, without guide cameras' reach, with other numbers in its tables."""
    data = load_instrument(name).model_dump(exclude_none=True)
    if data["layout"].get("modules") is None:
        data["layout"]["n_positioners"] = n
    for table, values in tables.items():
        data[table] |= values
    return Instrument.model_validate(data)


def wrong(instrument, about, **asked):
    found = [one for one in check(instrument, **asked) if one.wrong]
    assert [one.about for one in found] == [about], list(map(str, found))
    return f"{found[0].says}; {found[0].helps}"


@pytest.mark.parametrize("name", instrument_names())
def test_presets_pass(name):
    assert not [str(one) for one in check(changed(name)) if one.wrong]


def test_one_correction_by_one_image_is_not_enough_for_desi():
    """As the instrument itself does it: 5 um by one image of 3 um, 6 % of the fibres cannot be within."""
    itself = changed("desi", operation={"corrections_max": 1, "images_max": 1})
    assert f"{math.exp(-25.0 / 9.0):.1%} of the fibres beyond 5 um" in wrong(itself, "camera")


def test_holes_too_small_to_count_are_told():
    notes = [str(one) for one in check(changed("desi"))]
    assert any("4.4 um out of reach" in note and "pitch_mm of 10.3923" in note for note in notes)


def test_parked_neighbours_that_touch():
    """Stretched arms of 22 mm at a pitch of 22.4 mm, capsules of 4 mm: along a row they meet."""
    text = wrong(changed("sdssv", positioner={"park_deg": [90.0, 0.0]}), "parking")
    assert "pairs touch at park_deg [90, 0]" in text
    assert "park_deg = [" in text  # another place is found


def test_a_capsule_wider_than_the_pitch():
    text = wrong(changed("sdssv", bodies={"collision_buffer_mm": 11.3}), "beta arm")
    assert "22.6 mm wide, the pitch is 22.4 mm" in text
    assert "below 11.2" in text


def test_ranges_that_leave_holes():
    """A third of a turn of alpha, short arms: the share is two thirds of what one arm alone reaches."""
    text = wrong(changed("pfs", alpha={"target_range_deg": [0.0, 120.0]}), "ranges")
    assert "of the plane has no fibre fibre, 0.00% if both axes turned freely" in text
    assert "360 deg in place of 120" in text


def test_arms_too_short_for_the_pitch():
    text = wrong(changed("lamost", layout={"pitch_mm": 33.5}), "coverage")
    far_um = 1e3 * (33.5 / math.sqrt(3.0) - 16.5)
    assert f"{far_um:.1f} um out of reach" in text
    assert "pitch_mm of 28.5788" in text  # 16.5 sqrt(3)


def test_a_camera_that_cannot_see_all():
    text = wrong(changed("sdssv", n=500, camera={"width_px": 4000}), "camera")
    assert "shows 243.0 mm from the middle" in text
    far = wrong(changed("sdssv", n=500, camera={"field_radius_mm": 250.0}), "camera")
    assert "field_radius_mm 250" in far


def test_a_camera_too_noisy_for_the_requirement():
    text = wrong(changed("sdssv", metrology={"noise_rms_um": 12.0}), "camera")
    least_um = 12.0 / math.sqrt(4 * 2)  # four images after each of two corrections
    assert f"{math.exp(-((5.0 / least_um) ** 2)):.1%} of the fibres beyond 5 um" in text


def test_gears():
    text = wrong(changed("lamost", alpha={"gear": 20.0, "kind": "bldc", "step_deg": 0.015}), "gear of alpha")
    assert "alpha.gear of 36 or more" in text
    step = wrong(changed("pfs", beta={"step_deg": 0.4}), "gear of beta")
    assert "a step is 16.6 um at 2.38 mm" in step
    play = wrong(changed("lamost", beta={"backlash_deg": 0.5}), "gear of beta")
    assert "play is 72.0 um and nothing closes it" in play


def test_a_gear_that_cannot_be_in_time():
    found = [one for one in check(changed("sdssv"), within_s=20.0) if one.wrong]
    assert [one.about for one in found] == ["gear of alpha"]  # beta has half the way
    assert "alpha.speed_deg_s of 18.36: a gear of 669" in str(found[0])
    never = [str(one) for one in check(changed("sdssv"), within_s=5.0) if one.wrong]
    assert "least time is 5.54 s" in never[0]
    with pytest.raises(InputError, match="above 0 s"):
        check(changed("sdssv"), within_s=0.0)


def test_a_spring_without_a_window():
    """A spring three times as stiff is stronger than the friction that holds the gear."""
    stiff = changed("sdssv", twin={"alpha": {"spring_rate": 3.0 * 0.9e-3}})
    assert "spring of alpha" in [one.about for one in check(stiff) if one.wrong]


def test_all_findings_come_at_once_and_the_command_ends_with_1(fl, tmp_path):
    text = instrument_text("sdssv")
    for old, new in (("collision_buffer_mm = 2.0", "collision_buffer_mm = 12.0"), ("6000", "4000")):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "mine.toml").write_text(text)
    code, said, _ = fl("design", "check", tmp_path / "mine.toml", "--within", 20, "--json")
    found = json.loads(said)
    assert code == 1
    assert {one["about"] for one in found["findings"] if one["wrong"]} == {
        "beta arm",
        "camera",
        "gear of alpha",
    }
    assert fl("design", "check", "megara")[0] == 0
