"""Fifty random units of the twin, identified over bus and camera alone: right, and honest about it."""

import numpy as np
import pytest
import recovery
from recovery import SMALL, covered, errors, recover

# Fifty draws tell a coverage to 3 percent, two hundred to 1.5: quantities are pooled by what they lean on.
GROUPS = {
    "weights": ("torque at full voltage", "stiffness"),
    "motor": ("Coulomb friction", "spring at 0 deg", "spring rate", "cogging", "cogging phase", "drag",
              "inertia"),
    "coast": ("back-EMF drag over inertia", "viscous friction over inertia", "Coulomb friction over inertia",
              "back-EMF drag", "viscous friction"),
    "camera": ("centre x", "centre y", "l_alpha", "l_beta", "angular repeatability"),
}  # fmt: skip


@pytest.fixture(scope="module")
def found():
    return recover(50, 0, SMALL)


def test_everybody_is_identified(found):
    estimates, truth = found
    assert len(estimates) == 34
    assert set(estimates) <= set(truth)
    for e in estimates.values():
        assert e.ok.all(), e.reason


def test_the_bias_is_below_the_standard_error(found):
    estimates, truth = found
    for name, e in estimates.items():
        off = errors(e, truth[name])
        own = e.standard_error
        assert abs(off.mean()) < own.mean(), name
        # and of the mean over the units: 34 quantities, one in a thousand each
        assert abs((off / own).mean()) < 3.3 / np.sqrt(len(off)), name


@pytest.mark.parametrize("group", GROUPS)
def test_intervals_hold_the_truth_as_often_as_they_say(found, group):
    estimates, truth = found
    wanted = GROUPS[group]
    chosen = [n for n in estimates if n in wanted or n.partition(" ")[2] in wanted]
    held = np.concatenate([covered(estimates[n], truth[n]) for n in chosen])
    assert len(held) >= 200
    assert 0.90 <= held.mean() <= 0.99, (group, held.mean())


def test_the_errors_are_small_enough_to_be_of_use(found):
    """Relative standard errors, median over the units."""
    estimates, _ = found
    for name, most in {
        "alpha torque at full voltage": 0.004,
        "alpha Coulomb friction": 0.005,
        "alpha drag": 0.005,
        "alpha inertia": 0.005,
        "beta inertia": 0.005,
        "alpha back-EMF drag over inertia": 0.01,
        "beta back-EMF drag": 0.01,
        "alpha stiffness": 0.02,
        "beta stiffness": 0.02,
        "l_alpha": 4e-5,
        "l_beta": 4e-5,
    }.items():
        e = estimates[name]
        assert np.median(e.standard_error / np.abs(e.value)) < most, name


def test_the_table_has_a_line_for_each(found):
    assert len(recovery.table(*found).splitlines()) == 34
