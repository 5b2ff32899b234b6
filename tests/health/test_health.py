"""Health: each ailment is found, called by its name and said in words; the healthy are left alone."""

import numpy as np
import pytest
from visits import Trouble, Visits

from fiberloom.health.monitor import ADVICE, Ailment, HealthMonitor, State
from fiberloom.instruments import generate, load_instrument

PLANE = generate(load_instrument("sdssv"), seed=0, n_positioners=19)
ILL = 3


def follow(troubles=(), fields=60, seed=1, plane=PLANE):
    """A monitor after so many fields; the passages are 3 a field."""
    monitor = HealthMonitor(plane)
    for passage in Visits(plane, seed, tuple(troubles)).run(fields):
        monitor.update(passage)
    return monitor


def test_the_healthy_are_left_alone():
    monitor = follow(fields=150)
    assert monitor.findings() == []
    assert set(monitor.states()) == {State.HEALTHY}
    assert monitor.shares().max() < 0.5


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(
    ("kind", "size", "called", "state"),
    [
        ("dark", 0.0, Ailment.DARK, State.DISABLED),
        ("stuck", 0.0, Ailment.STUCK, State.DISABLED),
        ("non_moves", 0.3, Ailment.NON_MOVES, State.DEGRADED),
        ("scale", 0.8, Ailment.SCALE, State.DEGRADED),
        ("scale", 0.98, Ailment.SCALE, State.DEGRADED),
        ("slipped", 0.5, Ailment.SLIPPED, State.DEGRADED),
        ("slipped", 0.9, Ailment.SLIPPED, State.DEGRADED),
        ("friction", 0.4, Ailment.FRICTION, State.DEGRADED),
        ("scatter", 5.0, Ailment.SCATTER, State.DEGRADED),
        ("loose_arm", 0.05, Ailment.LOOSE_ARM, State.DEGRADED),
        ("jittery_arm", 0.02, Ailment.LOOSE_ARM, State.DEGRADED),
    ],
)
def test_an_ailment_is_found_and_named(kind, size, called, state, axis):
    monitor = follow([Trouble(kind, ILL, axis, start=61, size=size)])
    findings = monitor.findings()
    assert [f.positioner_id for f in findings] == [int(PLANE.positioner_id[ILL])]
    (finding,) = findings
    assert (finding.ailment, finding.state) == (called, state), finding
    assert finding.since_move >= 61
    assert finding.evidence
    assert finding.advice == ADVICE[called]
    if finding.axis and kind not in ("loose_arm", "jittery_arm"):
        assert finding.axis == ("alpha", "beta")[axis]


def test_a_broken_tooth_is_found_where_it_is():
    # one visit in 40 fields goes there
    monitor = follow([Trouble("tooth", ILL, 1, start=1, size=0.5)], fields=250)
    (finding,) = monitor.findings()
    assert finding.ailment is Ailment.TOOTH
    assert "between 80 and 90 deg" in finding.evidence


def test_a_repair_clears_the_record():
    monitor = follow([Trouble("dark", ILL, 0, start=61)])
    monitor.forget(int(PLANE.positioner_id[ILL]))
    assert monitor.findings() == []


def test_what_is_said_of_one_does_not_depend_on_the_others():
    part = PLANE.select(np.arange(5))
    trouble = Trouble("scale", ILL, 0, start=31, size=0.9)
    whole, alone = HealthMonitor(PLANE), HealthMonitor(part)
    for passage in Visits(PLANE, 2, (trouble,)).run(20):
        whole.update(_without_effort(passage))
        alone.update(_without_effort(passage, 5))
    assert [f.evidence for f in whole.findings()] == [f.evidence for f in alone.findings()]
    np.testing.assert_allclose(whole.shares()[:5], alone.shares())


def _without_effort(passage, n=None):
    """Torques are compared with everybody's on purpose."""
    rows = slice(n)
    return type(passage)(
        passage.before_deg[rows],
        passage.believed_deg[rows],
        passage.seen_mm[rows],
        passage.asked[rows],
        passage.arrived[rows],
    )
