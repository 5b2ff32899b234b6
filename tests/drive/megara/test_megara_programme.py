"""Programmes of moves and the signs of steps, by hand and there and back."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fiberloom as fl
from fiberloom.drive.megara import MoveProgramme, read_programme
from fiberloom.drive.steppers import AxisSteps
from fiberloom.errors import InputError

FIRST = "\tgroup_1 {\n\trp1 r1 40685\n\trp1 r2 -0\n\t}\n"
SAMPLE = f"pos_0 {{\n{FIRST}\tgroup_2 {{\n\trp1 r1 44346\n\trp1 r2 -1159\n\t}}\n}}"
goals = st.tuples(st.integers(0, 2**31 - 1), st.integers(-(2**31) + 1, 0))
groups = st.dictionaries(st.integers(1, 92), goals, max_size=4)
programmes = st.builds(MoveProgramme, st.lists(groups, max_size=4).map(tuple), st.integers(0, 99))


def test_a_programme_by_hand():
    read = read_programme(SAMPLE)
    assert read.groups == ({1: (40685, 0)}, {1: (44346, -1159)})
    assert read.ends() == {1: (44346, -1159)}
    assert read.steps_of(np.array([2, 1]))[:, 1].tolist() == [[0, 0], [40685, 0], [44346, -1159]]
    assert read.back().groups == ({1: (40685, 0)}, {1: (0, 0)})
    assert read.text() == SAMPLE


@given(programmes)
def test_what_is_written_is_read(programme):
    assert read_programme(programme.text()) == programme


@given(programmes)
def test_the_way_back_stands_where_the_way_out_stood(programme):
    robots = np.array(programme.robots, dtype=np.int64)
    out, back = programme.steps_of(robots), programme.back().steps_of(robots)
    for k in range(1, len(out)):
        moved = [robot in programme.groups[-k] for robot in robots.tolist()]
        np.testing.assert_array_equal(back[k][moved], out[-1 - k][moved])
    assert set(programme.back().ends().values()) <= {(0, 0)}


@given(st.text(alphabet="pos_0group1 {}\nr12-\t", max_size=80) | st.text(max_size=40))
def test_any_text_is_read_or_refused(text):
    with contextlib.suppress(InputError):
        read_programme(text)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("pos_0 {", "pos {", "must begin"),
        ("group_2", "group_3", "line 6: .*'group_2 {' is wanted"),
        ("rp1 r2 -1159", "rp1 r1 3", "line 8: rp1 r1 has a goal"),
        ("rp1 r2 -1159\n", "\n", "line 9: rp1 needs goals of r1 and r2"),
        ("-1159", "1159", "group_2: rp1: .*r2 <= 0"),
        ("-1159\n\t}", "-1159", "not closed"),
        ("rp1 r1 44346", "rp1 r3 44346", "line 7: 'rp1 r3 44346'"),
    ],
)
def test_what_is_wrong_is_named(old, new, match):
    with pytest.raises(InputError, match=match):
        read_programme(SAMPLE.replace(old, new, 1))


def test_signs_and_steps_of_the_published_turns():
    steps = AxisSteps.of(fl.Instrument.of("megara"))
    turn = steps.of_angles(np.array([[-360.0, -180.0], [0.0, 0.0], [-90.0, -135.0]]))
    assert turn.tolist() == [[194086, 0], [0, -15360], [48522, -3840]]
    angles = np.random.default_rng(0).uniform([-362.0, -180.0], [0.0, 0.0], (50, 2))
    off = steps.angles_deg(steps.of_angles(angles)) - angles
    assert np.abs(off).max(axis=0) == pytest.approx(steps.step_deg / 2, rel=0.1)


def test_angles_beyond_the_stops_are_refused_by_name():
    plane = fl.FocalPlane.of("megara", n=3)
    angles = plane.park_deg.copy()
    angles[1, 1] = 20.0
    with pytest.raises(InputError, match=rf"robot {plane.positioner_id[1]}, rotor 2: 20 deg"):
        AxisSteps.of(plane.instrument).of_plane(plane, angles)
