"""Options at their edges, and what people type for --vary."""

import json
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.design.coverage import array_coverage, broken_plane
from fiberloom.design.gear import gear_verdict, gear_window, reconfiguration
from fiberloom.design.power import PowerSettings
from fiberloom.design.sweep import MOST_DESIGNS, ranges_of
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import plan, random_pair

SDSSV = load_instrument("sdssv")


# --vary


@given(
    low=st.floats(-1e3, 1e3),
    step=st.floats(1e-3, 1e3),
    n=st.integers(0, MOST_DESIGNS - 2),
    rest=st.floats(0.0, 0.9),
)
def test_a_range_has_both_ends_and_equal_steps(low, step, n, rest):
    high = low + (n + rest) * step
    values = ranges_of(f"pitch={low!r}:{high!r}:{step!r}")["pitch"]
    # the ends are rounded to 1e-9, and so may a last value within a billionth of a step be
    assert len(values) in ({n + 1} if rest > 1e-6 or n == 0 else {n, n + 1, n + 2})
    assert values[0] == pytest.approx(low, abs=1e-9)
    assert values[-1] <= high + 1e-9 * step + 1e-9
    assert values[-1] > high - step * (1.0 + 1e-6) - 1e-9
    np.testing.assert_allclose(np.diff(values), step, rtol=1e-5, atol=2e-9)


@given(values=st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20))
def test_single_values_are_those_that_are_typed(values):
    text = ";".join(map(repr, values))
    assert ranges_of(f" pitch = {text} , gear=1") == {"pitch": values, "gear": [1.0]}


@given(text=st.text(alphabet="ab.=,:;0123456789-+einf ", max_size=30))
def test_any_text_is_ranges_or_one_clear_line(text):
    found, said = {}, ""
    try:
        found = ranges_of(text)
    except InputError as error:
        said = str(error)
    assert bool(found) != bool(said)
    assert said == "" or (said.startswith("--vary ") and "\n" not in said)
    assert all(key and values and np.isfinite(values).all() for key, values in found.items())


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("pitch=30:20:1", "holds nothing, 30 is above 20; give the lower one first"),
        ("pitch=20:30:0", "a step of 0 leads nowhere; give one above 0"),
        ("pitch=20:30:-1", "a step of -1 leads nowhere"),
        ("pitch=0:1:1e-9", "1e+09 values, 2000 at most; give a wider step"),
        ("pitch=20:30", "give key=from:to:step"),
        ("pitch=20:inf:1", "numbers must be finite"),
        ("pitch=1,pitch=2", "pitch is varied twice; give all its values at once"),
        ("=1", "give key=from:to:step"),
    ],
)
def test_a_range_that_holds_nothing_says_why(text, says):
    with pytest.raises(InputError) as caught:
        ranges_of(text)
    assert says in str(caught.value)


# gear, power, a file of many faults


def test_a_gear_outside_its_window_says_what_would_help(fl):
    assert gear_window(SDSSV, 0).advice() == "fits"
    slow = gear_window(SDSSV, 0, within_s=20.0)
    assert not slow.fits
    found = slow.advice()
    assert f"a gear of {slow.most:.0f} or less, or a motor of {slow.needed_rpm:.0f} rpm" == found
    # both do: that ratio by the same motor, that motor by the same ratio
    assert gear_window(SDSSV, 0, motor_rpm=slow.needed_rpm, within_s=20.0).most == pytest.approx(slow.ratio)
    assert slow.needed_rpm / slow.motor_rpm == pytest.approx(slow.ratio / slow.most)
    assert "a gear of 3905 or more, for 5 um" in gear_window(SDSSV, 0, motor_error_deg=50.0).advice()
    none = gear_window(SDSSV, 0, motor_rpm=100.0, within_s=20.0)
    rpm = float(none.advice().split("a motor of ")[1].split()[0])
    assert gear_window(SDSSV, 0, motor_rpm=rpm * 1.001, within_s=20.0).most > none.least
    assert gear_window(SDSSV, 0, motor_rpm=rpm * 0.999, within_s=20.0).most < none.least + 1
    code, said, _ = fl("design", "gear", "sdssv", "--within", 20)
    assert code == 1
    assert f"alpha: {found}" in said


def test_a_reconfiguration_takes_what_the_planner_needs(fl):
    found = reconfiguration(SDSSV, 7, 3, seed=5)
    plane = generate(SDSSV, 5, n_positioners=7)
    times = [plan(plane, *random_pair(plane, 5 + k), seed=5).duration_s for k in range(3)]
    assert found.motion_s == pytest.approx(np.mean(times))
    assert found.motion_error_s == pytest.approx(np.std(times, ddof=1) / math.sqrt(3))
    assert 1.0 < found.over_least < 1.2
    assert found.refused == 0.0
    code, said, _ = fl("design", "gear", "sdssv", "--planned", 7, "--fields", 3, "--seed", 5, "--json")
    told = json.loads(said)["reconfiguration"]
    assert code == 0
    assert told["reconfiguration_s"] == round(found.motion_s, 2)
    code, _, err = fl("design", "gear", "moons", "--planned", 7)
    assert code == 2
    assert "moons: alpha does not follow trajectories" in err


def test_a_piezo_has_no_ratio_to_be_held_against_a_window(fl):
    pfs = load_instrument("pfs")
    windows = [gear_window(pfs, axis) for axis in (0, 1)]
    assert gear_verdict(windows) == "no gear to be held against a window"
    code, said, _ = fl("design", "gear", "pfs")
    assert code == 0
    assert "no gear" in said
    assert "yes" not in said
    assert (
        gear_verdict([gear_window(SDSSV, 0, within_s=20.0), gear_window(SDSSV, 1)])
        == "alpha outside the window"
    )


def test_numbers_that_are_none_are_refused():
    for asked in ({"way_deg": (math.nan, 1.0)}, {"every_s": math.inf}, {"rest_W": math.nan}):
        with pytest.raises(InputError, match="must be finite"):
            PowerSettings(**asked)


def test_a_file_with_ten_faults_tells_all_ten(fl, tmp_path, dense):
    faults = {
        "l_alpha_mm = 5.0": "l_alpha_mm = -5.0",
        'kind = "bldc"': 'kind = "steam"',
        "gear = 1024.0": "gear = 0",
        "speed_deg_s = 12.0": 'speed_deg_s = "fast"',
        "noise_rms_um = 0.669": "noise_rms_um = -1",
        "pitch_mm = 8.0": "pitch_mm = 0",
        "rings = 20": "rings = -2",
        "corrections_max = 2": "corrections_max = -1",
        "present = true": 'present = "maybe"',
        "requirement_um = 5.0": "requirement_um = 0",
    }
    for good, bad in faults.items():
        assert good in dense
        dense = dense.replace(good, bad, 1)
    (tmp_path / "bad.toml").write_text(dense)
    code, _, said = fl("design", "check", tmp_path / "bad.toml")
    assert code == 2
    assert "bad.toml: 10 problems: " in said
    for fault in faults:
        key = fault.split(" = ")[0]
        assert key in said
    assert " ... " not in said


@pytest.fixture
def dense():
    return (Path(__file__).parents[2] / "examples" / "dense.toml").read_text()


# budget


def budget_rows(fl, *words):
    code, said, _ = fl("design", "budget", "sdssv", "--units", 7, "--fields", 1, *words, "--json")
    return code, json.loads(said)


def test_a_budget_without_corrections_is_blind_and_with_many_never_grows(fl):
    code, found = budget_rows(fl, "--corrections", 0)
    assert [row["corrections"] for row in found["moves"]] == [0]
    assert code == 1  # three of four are beyond the requirement
    code, found = budget_rows(fl, "--corrections", 20)
    rms = [row["rms_um"] for row in found["moves"]]
    assert code == 0
    assert len(rms) == 21
    assert all(later <= before + 1e-3 for before, later in pairwise(rms))
    assert fl("design", "budget", "sdssv", "--corrections", -1)[0] == 2


def test_gravity_is_largest_at_the_horizon_and_nothing_lies_below(fl):
    at = [budget_rows(fl, "--errors", "gravity", "--zenith", deg)[1] for deg in (0, 60, 90)]
    sags = [next(t["blind_um"] for t in one["terms"] if t["term"] == "gravity") for one in at]
    assert sags[0] == 0.0
    assert sags[1] / sags[2] == pytest.approx(math.sin(math.radians(60.0)), rel=0.01)
    for beyond in (90.1, -0.1, "nan"):
        code, _, said = fl("design", "budget", "sdssv", "--zenith", beyond)
        assert code == 2
        assert "0 to 90" in said


# the edge of the array


def test_points_at_the_edge_have_the_fibres_that_reach_them():
    plane = broken_plane(generate(SDSSV, 0, n_positioners=37), 3, seed=1)
    found = array_coverage(plane, "BOSS")
    far = np.hypot(*found.xy_mm.T)
    edge = np.argsort(-far)[:60]
    free = edge[~found.blocked[edge]]
    for k in free:
        rows = np.flatnonzero(~plane.offline)
        reached = plane.inverse(np.tile(found.xy_mm[k], (len(rows), 1)), "BOSS", rows).reachable
        assert found.number[k] == reached.sum()
    # an endless lattice of these arms has 3.2 fibres at a point
    assert found.number[free].mean() < 0.8 * 3.2
    assert (found.number[found.blocked] == 0).all()
    with pytest.raises(InputError, match="2 positioners enclose no area"):
        array_coverage(generate(SDSSV, 0, n_positioners=2), "BOSS")
