"""What a plan tells of approaches is verified, and kept in files."""

import json
from dataclasses import replace

import numpy as np
import pytest
from made import LEAST_DEG, USUAL_DEG, bare, facing

from fiberloom.errors import InputError
from fiberloom.planning import Approach, MotionLimits, Plan, Trajectory, plan, verify

FREE = bare(2).select([0])
ANY = MotionLimits(speed_deg_s=1e9, acceleration_deg_s2=1e12)
ALPHA_FIRST = [
    (0.0, 50.0, 60.0),
    (1.0, 50.4, 60.0),  # alpha up, beta stays
    (2.0, 50.0, 60.4),  # alpha down, beta up
    (3.0, 50.0, 60.0),  # beta down
]
SAID = Approach((0.4, 0.4), (1.0, 2.0), (2.0, 3.0))


def told(own: Approach | None, points=ALPHA_FIRST) -> Plan:
    table = np.array(points).T
    return Plan("sdssv", 2.0, (Trajectory(int(FREE.positioner_id[0]), *table, own),))


def kinds(made: Plan, **asked) -> set[str]:
    return {v.kind for v in verify(FREE, made, limits=ANY, **asked).violations}


def test_an_approach_is_what_the_plan_says():
    assert kinds(told(SAID), approach_deg=USUAL_DEG) == set()
    assert kinds(told(SAID)) == set()
    assert kinds(told(None), approach_deg=LEAST_DEG) == {"approach"}  # both axes together are the rule


@pytest.mark.parametrize(
    "said",
    [
        replace(SAID, height_deg=(0.41, 0.4)),
        replace(SAID, height_deg=(0.4, 0.39)),
        replace(SAID, begin_s=(0.5, 2.0)),  # still rising
        replace(SAID, begin_s=(1.0, 1.5)),
        replace(SAID, end_s=(1.5, 3.0)),  # not there yet
        replace(SAID, end_s=(2.0, 3.5)),  # after the end of the motion
        replace(SAID, begin_s=(-1.0, 2.0)),
        replace(SAID, height_deg=(np.nan, 0.4)),
        replace(SAID, begin_s=(1.0, np.nan)),
    ],
)
def test_what_is_not_so_is_found_whether_or_not_the_caller_asks(said):
    assert kinds(told(said)) == {"approach"}
    assert kinds(told(said), approach_deg=USUAL_DEG) == {"approach"}


def test_who_rises_after_its_last_leg_has_begun_is_found():
    bumpy = [*ALPHA_FIRST[:3], (2.5, 50.0, 60.1), (2.7, 50.0, 60.2), (3.0, 50.0, 60.0)]
    assert kinds(told(SAID, bumpy)) == {"approach"}


def test_what_does_not_close_the_backlash_is_found_where_the_approach_is_asked_for():
    low = [(t, 50.0 + (a - 50.0) * 0.7, 60.0 + (b - 60.0) * 0.7) for t, a, b in ALPHA_FIRST]
    said = replace(SAID, height_deg=(0.28, 0.28))
    assert kinds(told(said, low)) == set()
    assert kinds(told(said, low), approach_deg=USUAL_DEG) == {"approach"}
    assert kinds(told(said, low), approach_deg=0.27) == set()  # the caller's own figure is lower
    found = verify(
        FREE, told(said, low), approach_deg=USUAL_DEG, limits=replace(ANY, least_approach_deg=0.27)
    )
    assert found.ok


def test_a_file_keeps_what_the_plan_tells():
    made = plan(bare(2), bare(2).park_deg, facing(1)[3])
    assert made.approaches
    again = Plan.from_json(made.to_json())
    assert again.approaches == made.approaches
    assert again.to_json() == made.to_json()
    for entry, robot in zip(made.to_dict()["robots"], made.robots, strict=True):
        assert ("approach" in entry) == (robot.approach is not None)
    number, own = next(iter(made.approaches.items()))
    assert str(own).startswith(f"alpha from {own.height_deg[0]:.3g} deg at ")
    assert made.to_dict()["robots"][bare(2).index_of([number])[0]]["approach"] == {
        "height_deg": list(own.height_deg),
        "begin_s": list(own.begin_s),
        "end_s": list(own.end_s),
    }


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({}, "no 'height_deg'"),
        ([], "a JSON object is expected"),
        ({"height_deg": [1.0], "begin_s": [0, 0], "end_s": [1, 1]}, "two numbers each"),
        ({"height_deg": [1.0, "a"], "begin_s": [0, 0], "end_s": [1, 1]}, "list of numbers"),
        ({"height_deg": [1.0, 1e9], "begin_s": [0, 0], "end_s": [1, 1]}, "is sound"),
    ],
)
def test_a_damaged_approach_is_refused(entry, words):
    document = json.loads(told(SAID).to_json())
    document["robots"][0]["approach"] = entry
    with pytest.raises(InputError, match="approach") as caught:
        Plan.from_dict(document)
    assert words in str(caught.value)
