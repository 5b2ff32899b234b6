"""What is known of a fibre that rests: one scatter, and image after image of it."""

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.drive.desi.maps.learned import LearnedMaps
from fiberloom.drive.desi.standing import StandingPlaces

N = 400
IMAGE_UM = 2.0
"""Per coordinate."""


@pytest.fixture
def case():
    plane = fl.FocalPlane.of("desi", seed=0, n=N)
    maps = LearnedMaps(plane, np.column_stack([np.full(N, 20.0), np.full(N, 90.0)]))
    maps.covariance *= 1e-4  # well known: the scatter of the move is what is left
    rng = np.random.default_rng(1)
    axes_deg = maps.basis.scatter_deg * rng.standard_normal((N, 2))
    true_mm = maps.expected_mm() + np.einsum("nca,na->nc", plane.jacobian(*maps.believed_deg.T), axes_deg)
    return StandingPlaces(maps), true_mm, rng


def look(standing, true_mm, rng):
    standing.see(
        true_mm + 1e-3 * IMAGE_UM * rng.standard_normal((N, 2)), 1e-3 * IMAGE_UM, np.ones(N, dtype=bool)
    )


def off_um(standing, true_mm):
    return 1e3 * np.hypot(*(standing.xy_mm - true_mm).T)


def rms(values):
    return np.sqrt(np.mean(values**2))


def test_each_image_of_a_fibre_that_rests_tells_more_and_as_much_as_is_said(case):
    standing, true_mm, rng = case
    found = []
    for _ in range(9):
        look(standing, true_mm, rng)
        told = 1e3 * np.sqrt(np.einsum("ncc->n", standing.covariance_mm2))
        found.append(rms(off_um(standing, true_mm)))
        assert found[-1] == pytest.approx(rms(told), rel=0.08)  # 400 fibres, two axes: 2.5 %
    assert found[0] < 0.75 * np.sqrt(2.0) * IMAGE_UM  # the map helps the first image
    assert found[-1] < 0.6 * found[0]  # the 0.53 of the sum of both informations


def test_a_move_draws_another_scatter(case):
    standing, true_mm, rng = case
    for _ in range(9):
        look(standing, true_mm, rng)
    moved = np.arange(N) < N // 2
    standing.went(moved)
    assert not standing.arrived(true_mm, 1e6)[moved].any()  # not seen since
    look(standing, true_mm, rng)
    off = off_um(standing, true_mm)
    assert rms(off[moved]) > 1.5 * rms(off[~moved])


def test_who_rests_is_surely_within(case):
    standing, true_mm, rng = case
    goal_mm = true_mm + 1e-3 * np.column_stack([np.linspace(0.0, 8.0, N), np.zeros(N)])
    for _ in range(3):
        look(standing, true_mm, rng)
    rests = standing.arrived(goal_mm, 5.0)
    true_off = np.linspace(0.0, 8.0, N)
    assert true_off[rests].max() < 5.0
    assert rests[true_off < 1.0].mean() > 0.9
    assert not standing.arrived(goal_mm, 1e-3).any()


def test_a_fibre_where_its_map_cannot_have_it_is_where_it_is_seen(case):
    standing, true_mm, rng = case
    true_mm[7] += [0.3, 0.0]
    look(standing, true_mm, rng)
    assert off_um(standing, true_mm)[7] < 4.0 * IMAGE_UM


def test_what_no_image_has_shown_has_not_arrived(case):
    standing, true_mm, _ = case
    standing.see(np.full((N, 2), np.nan), 1e-3, np.zeros(N, dtype=bool))
    assert not standing.arrived(true_mm, 1e6).any()
