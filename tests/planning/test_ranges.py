"""Settings with which no plan can be made are told before anything is planned."""

import math

import pytest
from fields import field

from fiberloom.errors import InputError
from fiberloom.planning import PlanSettings, plan, random_configuration, verify
from fiberloom.planning.planner import RANGES

NUMBERS_OF_OTHER_KINDS = {"late_s", "progress"}  # has its own check; is no number


def test_each_number_has_a_range():
    assert RANGES.keys() | NUMBERS_OF_OTHER_KINDS == PlanSettings.__dataclass_fields__.keys()


@pytest.mark.parametrize("name", RANGES)
@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_a_number_out_of_its_range_is_named(name, value):
    plane = field(7)
    start = random_configuration(plane, 1)
    with pytest.raises(InputError, match=f"^{name} {value:g}: must be a finite number"):
        plan(plane, start, plane.park_deg, settings=PlanSettings(**{name: value}))


def test_what_is_allowed_is_told():
    plane = field(7)
    for settings, told in (
        (PlanSettings(grid_deg=0.25), "grid_deg 0.25: must be a finite number from 2 to 30 deg"),
        (PlanSettings(speed_deg_s=0.0), "speed_deg_s 0: must be a finite number above 0 deg/s"),
        (PlanSettings(first_deadline=0.5), "first_deadline 0.5: must be a finite number from 1 on"),
    ):
        with pytest.raises(InputError) as error:
            settings.of(plane)
        assert str(error.value) == told


@pytest.mark.parametrize("grid_deg", [RANGES["grid_deg"].least, RANGES["grid_deg"].most])
def test_the_widest_and_the_narrowest_step_make_plans(grid_deg):
    plane = field(7)
    start, goal = (random_configuration(plane, seed) for seed in (1, 2))
    made = plan(plane, start, goal, seed=0, settings=PlanSettings(grid_deg=grid_deg))
    assert made.refused == {}
    assert verify(plane, made, start_deg=start, goal_deg=goal).ok
