"""Dense goals on the array of Apache Point: who is refused, with the usual approach of all and with a choice.

`pytest tests/planning/approach/test_dense_fields.py -m slow -s` prints the figures of docs/planning.md.
"""

import numpy as np
import pytest
from made import SDSSV, USUAL_DEG

from fiberloom.assignment import AssignSettings, assign
from fiberloom.instruments import read_layout
from fiberloom.planning import Plan, PlanSettings, plan, random_configuration, verify
from fiberloom.targets import random_targets
from fiberloom.targets.yanny import read_yanny

AS_BEFORE = PlanSettings(approach_turns=1, least_approach_deg=USUAL_DEG)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def real(shared_sdssv):
    return read_layout(shared_sdssv / "apo_2025.12.04", SDSSV)


def kept(made: Plan) -> int:
    return sum("no way past" in why for why in made.refused.values())


def before_and_after(name: str, plane, goal_deg) -> tuple[Plan, Plan]:
    """Plans from the folded array, verified; a line of figures."""
    both = [plan(plane, plane.park_deg, goal_deg, settings=s) for s in (AS_BEFORE, PlanSettings())]
    for made in both:
        assert verify(plane, made, goal_deg=goal_deg, approach_deg=USUAL_DEG).ok
    told = [f"{len(m.refused):2d} ({kept(m)} of them no way), {m.duration_s:.2f} s" for m in both]
    own = both[1].approaches.values()
    low = sum(min(a.height_deg) < USUAL_DEG - 1e-6 for a in own)
    first = min((min(a.begin_s) for a in own), default=0.0)
    late = sum(max(a.begin_s) > first + 1e-6 for a in own)
    cpu = " and ".join(f"{m.cpu_s:.1f}" for m in both)
    print(f"\n{name}: refused {told[0]} -> {told[1]}; {low} lowered, {late} later; {cpu} CPU s", end="")
    for why in both[1].refused.values():
        print(f"\n    {why}", end="")
    return both[0], both[1]


# seed 5: one has no way at all, and 13 rounds look for it, 43 CPU s
@pytest.mark.parametrize("seed", [*range(5), pytest.param(5, marks=pytest.mark.long)])
def test_random_places_without_a_margin(real, seed):
    goal_deg = random_configuration(real, seed, margin_mm=0.0, approach_deg=0.0)
    before, after = before_and_after(f"random places, seed {seed}", real, goal_deg)
    assert len(before.refused) >= 3
    assert len(after.refused) <= 2


@pytest.mark.parametrize("seed", [0, 2, 3])
def test_targets_assigned_without_regard_to_approaches(real, seed):
    settings = AssignSettings(margin_mm=0.0)
    found = assign(real, random_targets(real, 3000, seed), approach_deg=0.0, settings=settings)
    before, after = before_and_after(f"assigned, seed {seed}", real, found.goal_deg)
    assert len(before.refused) >= 8
    assert len(after.refused) <= 2


def test_the_configuration_of_a_real_exposure(shared_sdssv):
    """Its arms overlap at two places by themselves (tests/assignment): those are refused rightly."""
    plane = read_layout(shared_sdssv / "apo_2024.04.01", SDSSV)
    rows = read_yanny(shared_sdssv / "confSummary-test.par.gz").rows["FIBERMAP"]
    placed = {
        int(r["positionerId"]): (float(r["alpha"]), float(r["beta"])) for r in rows if r["valid"] == "1"
    }
    goal_deg = plane.park_deg.copy()
    goal_deg[plane.index_of(list(placed))] = list(placed.values())
    before, after = before_and_after("a real exposure", plane, goal_deg)
    assert len(after.refused) <= len(before.refused)
    assert all("goal touches" in why or "no way past" in why for why in after.refused.values())
    assert np.isin([724, 779, 990], list(after.refused)).sum() >= 2
