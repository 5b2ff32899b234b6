"""How many frames load a plan, and how long these take on the wires."""

import json

import numpy as np
import pytest

from fiberloom.bus.protocol import frame_s
from fiberloom.drive.sdssv.frame_budget import frame_budget
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import plan, random_pair, write_configuration

N = 12


@pytest.fixture(scope="module")
def plane():
    return generate(load_instrument("sdssv"), seed=0, n_positioners=N)


@pytest.fixture(scope="module")
def ends_deg(plane):
    return random_pair(plane, seed=0)


@pytest.fixture(scope="module")
def made(plane, ends_deg):
    start_deg, goal_deg = ends_deg
    some = np.arange(N) < 8  # the others stay where they are
    return plan(plane, start_deg, np.where(some[:, None], goal_deg, start_deg), seed=0)


def points_of(made):
    return [sum(len(r.corners(axis)) for axis in (0, 1)) for r in made.robots if r.moves]


def test_one_wire_carries_all_frames_and_their_answers(made):
    points = points_of(made)
    found = frame_budget(made, ports=1)
    assert 8 <= len(points) < N
    assert found.frames == sum(points) + 2 * len(points)
    data = (sum(points) + len(points)) * frame_s(8)  # points and their numbers; the end mark has no data
    assert found.wire_s == pytest.approx(data + len(points) * frame_s(0) + found.frames * frame_s(0))


def test_of_many_wires_the_fullest_counts(made):
    longest = max(points_of(made))
    one_each = frame_budget(made, ports=N).wire_s
    assert one_each == pytest.approx((longest + 1) * frame_s(8) + (longest + 3) * frame_s(0))
    assert frame_budget(made, ports=N - 1).wire_s > one_each  # two share one
    assert frame_budget(made, ports=1000).wire_s == one_each


def test_there_is_a_port(made):
    with pytest.raises(InputError, match="ports 0"):
        frame_budget(made, ports=0)


@pytest.fixture
def written(plane, ends_deg, tmp_path):
    for name, angles_deg in zip(("start", "goal"), ends_deg, strict=True):
        write_configuration(tmp_path / f"{name}.csv", plane.positioner_id, angles_deg)
    return tmp_path


def test_a_plan_with_more_frames_than_asked_for_is_not_written(fl, written):
    way = written / "w.json"
    ends = "--start", written / "start.csv", "--goal", written / "goal.csv"
    words = "plan", *ends, "--positioners", N, "--out", way, "--json"
    code, out, _ = fl(*words)
    frames = json.loads(out)["frames"]
    assert code == 0
    way.unlink()
    code, _, err = fl(*words, "--most-frames", frames - 1)
    assert (code, way.exists()) == (2, False)
    assert f"takes {frames} frames" in err
    code, out, _ = fl(*words, "--most-frames", frames)
    assert (code, way.exists()) == (0, True)
    assert json.loads(out)["wire_s"] > 0.0
    assert fl(*words, "--most-frames", 0)[0] == 2
