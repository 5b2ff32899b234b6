"""What a file of trajectories says of itself is not believed: buffer, instrument, places."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import (
    Plan,
    Trajectory,
    plan,
    read_configuration,
    read_plans,
    verify,
    write_configuration,
)

N = 7
PLANE = generate(load_instrument("sdssv"), seed=0, n_positioners=N)


def standing(angles_deg, buffer_mm=2.0, instrument="sdssv"):
    """A plan in which nobody moves."""
    robots = tuple(
        Trajectory(int(p), np.zeros(1), np.array([a]), np.array([b]))
        for p, (a, b) in zip(PLANE.positioner_id, angles_deg, strict=True)
    )
    return Plan(instrument, buffer_mm, robots)


def nearer_than_two_buffers():
    """A small move of one positioner whose arm is 1 to 3 mm nearer to another than it must be."""
    for alpha_deg in np.arange(0.0, 360.0, 5.0):
        angles = np.array(PLANE.park_deg)
        angles[0] = alpha_deg, 20.0
        made = standing(angles)
        first = made.robots[0]
        step = Trajectory(
            first.positioner_id, np.array([0.0, 1.0]), np.full(2, alpha_deg), np.array([20.0, 19.99])
        )
        made = replace(made, robots=(step, *made.robots[1:]))
        if -3.0 < verify(PLANE, made).min_robot_clearance_mm < -1.0:
            return made
    raise AssertionError("no such place")


def saved(made, tmp_path):
    made.save(tmp_path / "t.json")
    return tmp_path / "t.json"


def test_arms_that_are_too_near_are_not_saved_by_the_buffer_of_the_file(fl, tmp_path):
    touching = nearer_than_two_buffers()
    assert not verify(PLANE, touching).ok
    file = saved(replace(touching, collision_buffer_mm=0.1), tmp_path)
    code, out, err = fl("verify", file, "--positioners", N)
    assert (code, out) == (2, "")
    assert "0.1 mm" in err
    assert "1.92 mm" in err
    assert "--buffer" in err
    # who asks for it gets it, and is told
    code, out, _ = fl("verify", file, "--positioners", N, "--buffer", 2.0, "--json")
    told = json.loads(out)
    assert (code, told["verified"]) == (1, False)
    assert told["checked_with_buffer_mm"] == told["buffer_of_instrument_mm"] == 2.0
    assert told["buffer_of_file_mm"] == 0.1
    assert (
        json.loads(fl("verify", file, "--positioners", N, "--buffer", 0.01, "--json")[1])["collisions"] == 0
    )


def test_a_buffer_that_a_demanded_configuration_may_have_is_taken(tmp_path):
    assert read_plans(saved(standing(PLANE.park_deg, 1.92), tmp_path), PLANE)
    with pytest.raises(InputError, match=r"collision buffer of 1\.919 mm"):
        read_plans(saved(standing(PLANE.park_deg, 1.919), tmp_path), PLANE)


@pytest.mark.parametrize("buffer", ["0", "-1", "nan", "inf"])
def test_a_buffer_is_above_0(fl, tmp_path, buffer):
    file = saved(standing(PLANE.park_deg), tmp_path)
    code, _, err = fl("verify", file, "--positioners", N, "--buffer", buffer)
    assert code == 2
    assert "--buffer" in err


def test_plans_of_another_instrument_are_refused(fl, tmp_path):
    code, _, err = fl(
        "verify", saved(standing(PLANE.park_deg, instrument="pfs"), tmp_path), "--positioners", N
    )
    assert code == 2
    assert "planned for pfs, not for sdssv" in err


def test_nothing_is_not_verified(fl, tmp_path):
    (tmp_path / "e.json").write_text('{"plans": []}')
    code, _, err = fl("verify", tmp_path / "e.json", "--positioners", N)
    assert code == 2
    assert "empty" in err


@pytest.mark.parametrize(("axis", "angle"), [(0, 900.0), (0, -9.5), (1, 369.5)])
def test_a_place_where_no_arm_can_be_is_refused(fl, tmp_path, axis, angle):
    start = np.array(PLANE.park_deg)
    start[3, axis] = angle
    with pytest.raises(InputError, match=f"start_deg: positioner {PLANE.positioner_id[3]} has .*hard stop"):
        plan(PLANE, start, PLANE.park_deg)
    found = verify(PLANE, standing(start))
    assert not found.ok
    assert [v.kind for v in found.violations if v.kind not in ("contact", "obstacle_contact")] == ["stops"]
    assert "beyond a hard stop" in str(found.violations[0])
    write_configuration(tmp_path / "s.csv", PLANE.positioner_id, start)
    with pytest.raises(InputError, match=r"s\.csv, line 5: (alpha|beta)_deg = .*hard stops at -4 and 364"):
        read_configuration(tmp_path / "s.csv", PLANE)


def test_one_a_little_beyond_a_stop_may_come_back():
    start = np.array(PLANE.park_deg)
    start[3, 0] = -8.9
    assert plan(PLANE, start, PLANE.park_deg).refused == {}
    assert verify(PLANE, standing(start)).ok
