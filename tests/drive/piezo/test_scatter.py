"""What a motor scatters: learned from its moves and from all of its kind; tubes with heavy tails."""

import numpy as np
import pytest

from fiberloom.drive.piezo.scatter import ScatterBelief

N = 3000
WAY = np.full(N, 20.0)
OTHER = np.full(N, 0.25)


def drawn(rng, median, log_sd):
    return np.minimum(median * np.exp(log_sd * rng.standard_normal(N)), 0.9)


def moved(belief, sigma, rng, moves):
    for _ in range(moves):
        off = WAY * sigma * rng.standard_normal(N) + np.sqrt(OTHER) * rng.standard_normal(N)
        belief.learn(off, WAY, OTHER)


def test_how_often_which_scatter_occurs_is_learned_from_all():
    """Motors twice as quiet as was thought: after three moves the mean over all is right to 15 %."""
    rng, belief = np.random.default_rng(0), ScatterBelief(np.zeros(N, dtype=int))
    sigma = drawn(rng, 0.06, 0.4)
    first = belief.variance.mean()
    moved(belief, sigma, rng, 3)
    assert first > 4.0 * np.mean(sigma**2)
    assert belief.variance.mean() == pytest.approx(np.mean(sigma**2), rel=0.3)


def test_kinds_do_not_mix():
    rng, belief = np.random.default_rng(1), ScatterBelief(np.arange(N) % 2)
    sigma = np.where(np.arange(N) % 2, 0.3, 0.05)
    moved(belief, sigma, rng, 4)
    assert np.sqrt(belief.variance[0::2].mean()) < 0.08
    assert np.sqrt(belief.variance[1::2].mean()) == pytest.approx(0.3, rel=0.2)


@pytest.mark.parametrize("moves", [0, 1, 5])
def test_tubes_hold_as_often_as_they_say(moves):
    """Of motors that scatter as is believed, 2 sigma hold but for 4.55 %, whatever is known of each."""
    rng, belief = np.random.default_rng(2), ScatterBelief(np.zeros(N, dtype=int))
    sigma = rng.choice(np.geomspace(0.03, 0.9, 10), N, p=belief.weight[0])
    moved(belief, sigma, rng, moves)
    tube = belief.tube(WAY, OTHER, 2.0)
    off = WAY * sigma * rng.standard_normal((40, N)) + np.sqrt(OTHER) * rng.standard_normal((40, N))
    assert np.mean(np.abs(off) > tube) == pytest.approx(0.0455, rel=0.12)


def test_a_tube_without_scatter_is_that_of_a_normal_error():
    belief = ScatterBelief(np.zeros(2, dtype=int))
    tube = belief.tube(np.zeros(2), np.array([4.0, 0.0]), 3.0)
    assert tube == pytest.approx([6.0, 0.0], abs=1e-5)


def test_a_measured_scatter_is_taken():
    belief = ScatterBelief(np.zeros(3, dtype=int))
    belief.measured(np.array([0.05, 0.4, np.nan]), np.array([True, True, False]), 20.0)
    assert np.sqrt(belief.variance[:2]) == pytest.approx([0.05, 0.4], rel=0.25)


def test_a_spot_of_another_fibre_tells_no_more_than_a_bound():
    belief = ScatterBelief(np.zeros(1, dtype=int))
    belief.learn(np.array([1e6]), np.array([20.0]), np.array([0.25]))
    assert np.isfinite(belief.weight).all()
    assert belief.variance[0] < 0.9**2


def test_a_move_of_no_way_tells_nothing_and_one_of_a_degree_does():
    belief = ScatterBelief(np.zeros(N, dtype=int))
    first = belief.variance.copy()
    belief.learn(np.full(N, 3.0), np.zeros(N), OTHER)
    assert belief.variance == pytest.approx(first, rel=1e-9)
    belief.learn(np.zeros(N), np.ones(N), np.full(N, 1e-6))
    assert (belief.variance < first).all()
