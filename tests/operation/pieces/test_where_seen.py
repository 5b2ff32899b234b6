"""Where an arm is that is not where it reports: by its fibre, also folded, where the inverse is mute."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fiberloom.instruments import generate, load_instrument
from fiberloom.operation.safety.seen import where_seen

PLANE = generate(load_instrument("sdssv"), 0, n_positioners=7)
ROW = np.array([3])


def seen_from(true_deg, reported_deg, noise_mm=(0.0, 0.0)):
    """Angles by the image and whether they are known; how far elbow and fibre are from the truth, mm."""
    true = np.array([true_deg], dtype=float)
    fibre_mm = PLANE.forward(*true.T, index=ROW)
    found_deg, known = where_seen(PLANE, ROW, fibre_mm + noise_mm, np.array([reported_deg], dtype=float))
    elbow = PLANE.elbows_mm(found_deg[:, 0], index=ROW) - PLANE.elbows_mm(true[:, 0], index=ROW)
    fibre = PLANE.forward(*found_deg.T, index=ROW) - fibre_mm
    return found_deg[0], bool(known[0]), max(np.hypot(*elbow[0]), np.hypot(*fibre[0]))


@settings(max_examples=200, deadline=None)
@given(
    alpha_deg=st.floats(0.0, 360.0),
    beta_deg=st.floats(0.0, 180.0),
    reported_deg=st.floats(0.0, 360.0),
    noise_um=st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)),
)
@example(354.3, 179.12, 330.11, (-10.0, 10.0))
@example(10.0, 0.2, 200.0, (15.0, 15.0))
def test_an_arm_with_a_wrong_alpha_is_where_it_is(alpha_deg, beta_deg, reported_deg, noise_um):
    """Seed 465 of the fault campaign: the gear of alpha turned, the arm did not, and beta was at 179 deg."""
    noise_mm = np.array(noise_um) / 1000.0
    _, known, off_mm = seen_from((alpha_deg, beta_deg), (reported_deg, beta_deg), noise_mm)
    assert known
    # the fibre is at least 6.9 mm from the axis: 20 um are 0.3 deg of alpha at most, 0.1 mm of the fibre
    assert off_mm < 0.12


def test_an_arm_with_a_wrong_beta_is_where_it_is():
    _, known, off_mm = seen_from((40.0, 120.0), (40.0, 60.0))
    assert known
    assert off_mm < 1e-6


@pytest.mark.parametrize("reported_deg", [(40.0, 60.0), (200.0, 90.0)])
def test_a_fibre_inside_of_the_reach_tells_nothing_where_beta_is_wrong_too(reported_deg):
    """Folded: 60 um inwards of where the arms can put it."""
    inwards = PLANE.centres_mm[ROW] - PLANE.forward(40.0, 180.0, index=ROW)
    noise_mm = 0.06 * inwards[0] / np.hypot(*inwards[0])
    angles_deg, known, _ = seen_from((40.0, 180.0), reported_deg, noise_mm)
    assert not known
    assert tuple(angles_deg) == reported_deg


@pytest.mark.parametrize(
    ("true_deg", "reported_deg"), [(362.0, 361.0), (2.0, 1.0), (359.5, 363.5), (-2.0, 1.0)]
)
def test_of_two_turns_within_the_stops_the_nearer_one_counts(true_deg, reported_deg):
    """The stops are 368 deg apart: near them a fibre alone does not tell on which side alpha is."""
    angles_deg, known, _ = seen_from((true_deg, 179.5), (reported_deg, 179.5))
    assert known
    assert angles_deg[0] == pytest.approx(true_deg, abs=1e-6)


def test_what_only_one_turn_within_the_stops_allows_is_there():
    """200 deg from what is reported: 160 deg the other way would be beyond a stop."""
    angles_deg, known, _ = seen_from((10.0, 179.5), (210.0, 179.5))
    assert known
    assert angles_deg[0] == pytest.approx(10.0, abs=1e-6)
