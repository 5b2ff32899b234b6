"""Who owns which spot, on arrays like SDSS-V's, DESI's and PFS's: right, or not said."""

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.metrology.matching import MatchSettings, MatchStatus, match_spots

ARRAYS = {
    "sdssv": (22.4, 7.4, 14.314, 500),
    "desi": (10.4, 3.0, 3.065, 2000),
    "pfs": (8.0, 2.375, 2.375, 2394),
}


def hexagon(pitch, n):
    side = np.arange(-60, 61)
    i, j = np.meshgrid(side, side)
    xy = np.column_stack([(pitch * (i + 0.5 * j)).ravel(), (pitch * np.sqrt(0.75) * j).ravel()])
    return xy[np.argsort(np.hypot(*xy.T), kind="stable")[:n]]


class Field:
    """Positioners with random arms, some astray, some dark, and spots of nobody."""

    def __init__(self, kind, seed, astray=0.05, dark=0.03, stray=60, dark_side=0.0):
        self.rng = np.random.default_rng([seed, 5])
        pitch, self.l1, self.l2, n = ARRAYS[kind]
        self.centres = hexagon(pitch, n)
        self.reach = [abs(self.l1 - self.l2), self.l1 + self.l2]
        self.expected = self.place()
        self.true = self.expected + self.rng.normal(0, 0.05, (n, 2))
        gone = self.rng.random(n) < astray
        self.true[gone] = self.place()[gone]
        self.dark = self.rng.random(n) < dark
        if dark_side:
            self.dark |= self.centres[:, 0] > np.quantile(self.centres[:, 0], 1 - dark_side)
        self.make_spots(stray)

    def place(self):
        a = self.rng.uniform(0, 2 * np.pi, len(self.centres))
        b = a + self.rng.uniform(0, np.pi, len(self.centres))
        arm = self.l1 * np.array([np.cos(a), np.sin(a)]) + self.l2 * np.array([np.cos(b), np.sin(b)])
        return self.centres + arm.T

    def make_spots(self, stray):
        radius = np.hypot(*self.centres.T).max() * np.sqrt(self.rng.random(stray))
        angle = self.rng.uniform(0, 2 * np.pi, stray)
        nobody = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        self.spots = np.vstack([self.true[~self.dark], nobody])
        self.owner = np.concatenate([np.flatnonzero(~self.dark), np.full(stray, -1)])
        order = self.rng.permutation(len(self.spots))
        self.spots, self.owner = self.spots[order], self.owner[order]

    def match(self, **changes):
        return match_spots(self.spots, self.expected, self.centres, self.reach, **changes)

    def wrong(self, match):
        """Wrong pairs, but not a spot of somebody else just where a dark fibre should be: 0.3 mm are less
        than four standard deviations, and no picture tells. One such pair in 36 of these fields."""
        rows = np.flatnonzero(match.spot >= 0)
        bad = rows[self.owner[match.spot[rows]] != rows]
        off = np.hypot(*(self.spots[match.spot[bad]] - self.expected[bad]).T)
        return int((~self.dark[bad] | (off > 0.3)).sum())


@pytest.mark.parametrize("kind", ARRAYS)
@pytest.mark.parametrize("seed", range(3))
def test_no_wrong_pair_with_some_astray_some_dark_and_many_strays(kind, seed):
    field = Field(kind, seed)
    match = field.match()
    assert field.wrong(match) == 0
    usual = np.hypot(*(field.true - field.expected).T) < 0.4
    lost = usual & ~field.dark & ~match.matched
    assert lost.mean() < 0.012


@pytest.mark.parametrize("kind", ARRAYS)
def test_a_fifth_dark_on_one_side_gets_nobodys_spots(kind):
    field = Field(kind, 1, dark_side=0.2)
    match = field.match()
    assert field.wrong(match) == 0
    assert match.matched.sum() > 0.9 * (~field.dark).sum() * 0.93


def test_without_strays_those_astray_are_found():
    field = Field("desi", 2, stray=0, dark=0.0)
    match = field.match()
    assert field.wrong(match) == 0
    assert match.matched.mean() > 0.97


def test_a_dark_one_is_dark_when_its_reach_is_empty():
    centres = hexagon(22.4, 7)
    expected = centres + np.array([10.0, 0.0])
    match = match_spots(expected[1:], expected, centres, [6.9, 21.7])
    assert match.status.tolist() == [MatchStatus.DARK] + [MatchStatus.MATCHED] * 6
    assert match.spot.tolist() == [-1, *range(6)]
    assert len(match.stray) == 0


def test_two_free_spots_for_two_positioners_are_not_guessed():
    centres = np.array([[0.0, 0.0], [22.4, 0.0]])
    expected = centres + np.array([0.0, 12.0])
    spots = np.array([[9.0, -5.0], [13.0, 6.0]])  # both in reach of both, near nothing expected
    match = match_spots(spots, expected, centres, [6.9, 21.7])
    assert match.status.tolist() == [MatchStatus.AMBIGUOUS] * 2
    assert match.stray.tolist() == [0, 1]


def test_one_that_stayed_is_known_by_where_it_was():
    centres = hexagon(22.4, 61)
    rng = np.random.default_rng(0)
    turn = rng.uniform(0, 2 * np.pi, 61)
    was = centres + 12.0 * np.column_stack([np.cos(turn), np.sin(turn)])
    expected = centres + 15.0 * np.column_stack([np.sin(turn), -np.cos(turn)])
    spots = expected.copy()
    spots[30] = was[30]
    match = match_spots(spots, expected, centres, [6.9, 21.7], previous_mm=was)
    assert match.matched.all()
    np.testing.assert_array_equal(match.spot, np.arange(61))


def test_a_crossed_pair_is_ambiguous_rather_than_swapped():
    centres = np.array([[0.0, 0.0], [22.4, 0.0]])
    expected = np.array([[11.0, 0.05], [11.0, -0.05]])
    match = match_spots([[11.05, 0.01], [10.95, -0.01]], expected, centres, [6.9, 21.7])
    assert not match.matched.any()


def test_order_of_spots_does_not_matter():
    field = Field("sdssv", 4)
    first = field.match()
    order = np.random.default_rng(1).permutation(len(field.spots))
    field.spots = field.spots[order]
    again = field.match()
    back = np.where(again.spot >= 0, order[again.spot], -1)
    np.testing.assert_array_equal(back, first.spot)


def test_more_trust_means_fewer_lost():
    field = Field("sdssv", 5)
    few = field.match(settings=MatchSettings(wrong_pairs=1e-6)).matched.sum()
    many = field.match(settings=MatchSettings(wrong_pairs=5.0)).matched.sum()
    assert few < many


def test_no_spots_at_all():
    field = Field("sdssv", 0)
    match = match_spots(np.zeros((0, 2)), field.expected, field.centres, field.reach)
    assert (match.status == MatchStatus.DARK).all()


def test_shapes_are_checked():
    with pytest.raises(InputError, match="matching"):
        match_spots(np.zeros((3, 2)), np.zeros((4, 2)), np.zeros((5, 2)), [1, 2])
