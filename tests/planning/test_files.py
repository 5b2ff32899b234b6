"""Configurations and trajectories as files: exact round trips, complaints that help."""

import json

import numpy as np
import pytest
from fields import field
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.errors import InputError
from fiberloom.planning import Plan, Trajectory, read_configuration, read_plans, write_configuration

PLANE = field(7)
IDS = [int(p) for p in PLANE.positioner_id]
HEADER = "positioner_id,alpha_deg,beta_deg\n"


def rows(numbers) -> str:
    return "".join(f"{p},10.0,{170 + k}\n" for k, p in enumerate(numbers))


def test_a_configuration_comes_back_as_it_was(tmp_path):
    angles = np.random.default_rng(0).uniform(0, 180, (7, 2)).round(9)
    write_configuration(tmp_path / "a.csv", PLANE.positioner_id[::-1], angles[::-1])
    np.testing.assert_array_equal(read_configuration(tmp_path / "a.csv", PLANE), angles)


def test_offline_positioners_may_be_left_out(tmp_path):
    offline = PLANE.with_offline([IDS[2]], [[33.0, 144.0]])
    (tmp_path / "a.csv").write_text(HEADER + rows(IDS[:2] + IDS[3:]))
    np.testing.assert_array_equal(read_configuration(tmp_path / "a.csv", offline)[2], [33.0, 144.0])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("positioner_id,alpha_deg\n1,2\n", ["no column beta_deg"]),
        (HEADER, ["no rows"]),
        (HEADER + rows(IDS[:6]), [f"no row for positioner {IDS[6]}", "1 missing"]),
        (HEADER + rows([*IDS[:6], 9999]), ["line 8", "9999", "not in this focal plane"]),
        (HEADER + rows([*IDS, IDS[0]]), ["line 9", "used before"]),
        (HEADER + rows(IDS[:6]) + f"{IDS[6]},ten,170\n", ["line 8", "alpha_deg", "'ten'"]),
        (HEADER + rows(IDS[:6]) + f"{IDS[6]},nan,170\n", ["line 8", "alpha_deg", "not finite"]),
    ],
)
def test_a_bad_configuration_is_refused_with_the_place(tmp_path, text, words):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_configuration(path, PLANE)
    for word in ["bad.csv", *words]:
        assert word in str(caught.value)


number = st.floats(-400.0, 400.0)


@given(st.lists(st.lists(st.tuples(number, number, number), min_size=1, max_size=4), max_size=4))
def test_a_plan_survives_json_bit_for_bit(tables):
    robots = tuple(Trajectory(k, *np.array(table).T) for k, table in enumerate(tables))
    made = Plan("sdssv", 2.0, robots, {0: "positioner 0: why"})
    back = Plan.from_json(made.to_json())
    assert back.to_json() == made.to_json()
    assert back.refused == made.refused
    for before, after in zip(made.robots, back.robots, strict=True):
        np.testing.assert_array_equal(before.points_deg, after.points_deg)


def entry(**changes) -> dict:
    return {
        "positioner_id": IDS[0],
        "time_s": [0.0],
        "alpha_deg": [1.0],
        "beta_deg": [2.0],
    } | changes


def document(*robots, **changes) -> str:
    return json.dumps({"instrument": "sdssv", "collision_buffer_mm": 2.0, "robots": list(robots)} | changes)


def test_one_plan_or_many_may_be_in_a_file(tmp_path):
    path = tmp_path / "t.json"
    path.write_text(document(entry()))
    assert len(read_plans(path, PLANE)) == 1
    path.write_text(json.dumps({"plans": [json.loads(document(entry()))] * 3, "seed": 1}))
    assert [plan.robots[0].positioner_id for plan in read_plans(path, PLANE)] == [IDS[0]] * 3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", ["line 1", "not JSON"]),
        ("[]", ["JSON object"]),
        ("{}", ["no 'robots'"]),
        (document(entry(), entry()), [f"positioner {IDS[0]} appears twice"]),
        (document(entry(time_s=[0.0, 1.0])), ["robots[0]", "2 times, 1 alphas"]),
        (document(entry(alpha_deg=[])), ["0 alphas"]),
        (document(entry(alpha_deg=["x"])), ["alpha_deg", "numbers"]),
        (document(entry(alpha_deg=[None])), ["alpha_deg"]),
        (document(entry(alpha_deg=[float("nan")])), ["alpha_deg", "finite"]),
        (document(entry(positioner_id="a")), ["'positioner_id' has the wrong type"]),
        (document(entry(), collision_buffer_mm=-1.0), ["collision_buffer_mm"]),
        (document(entry(positioner_id=9999)), ["9999", "not in this focal plane"]),
    ],
)
def test_bad_trajectories_are_refused_with_the_place(tmp_path, text, words):
    path = tmp_path / "bad.json"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_plans(path, PLANE)
    for word in words:
        assert word in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.json"):
        read_plans(tmp_path / "none.json", PLANE)
