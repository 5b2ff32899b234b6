"""Arms that start inside each other: forces are equal and opposite, touches are told in their order."""

import numpy as np
import pytest
from units_of import gear_of, nominal, plain

from fiberloom._core import firmware, geometry, twin

BODY_MM = (0.0, 14.7, 1.5)
PARAMS = np.array([row[4] for row in firmware.AXIS_PARAMS], dtype=np.float32)
NO_OBSTACLES = np.zeros((0, 5))


def placed(arms, start_rad, **options):
    """A twin of equal positioners with perfect gears."""
    n = len(arms)
    setup = twin.TwinSetup(
        ids=np.arange(1, n + 1, dtype=np.uint16),
        plant=plain(np.repeat(nominal(seat_rms=0.0, hall_noise=0.0), 2 * n)),
        transmission=plain(np.repeat(gear_of(), 2 * n)),
        firmware=np.repeat(PARAMS[None], 2 * n, axis=0),
        start_rad=np.ascontiguousarray(start_rad, dtype=float),
    )
    setup.place(np.ascontiguousarray(arms, dtype=float), options.pop("obstacles", NO_OBSTACLES), BODY_MM)
    for name, value in options.items():
        setattr(setup, name, value)
    return twin.Twin(setup)


def arm(x_mm, y_mm, turn_rad=0.0):
    return [x_mm, y_mm, 7.4, turn_rad, 0.0]


def bent_rad(made, ticks):
    """By how much the arms have given way after some ticks."""
    before = made.outputs_rad()
    made.run(ticks)
    return made.outputs_rad() - before


def test_arms_on_one_line_bend_alike():
    # half a turn about the middle makes one arm of the other; no point of either has a side to go to
    arms = [arm(-15.0, 4.0), arm(15.0, -4.0, np.pi)]
    made = placed(arms, [[2 * np.pi - np.arctan2(4.0, 15.0), 0.0]] * 2)
    bent = bent_rad(made, 20)
    assert made.take_touches() == [(0.0, 0, 1)]
    np.testing.assert_allclose(bent[0], bent[1], rtol=1e-6, atol=1e-9)
    # the first is pushed along x, the second back: a force on a point below a centre turns it upwards
    assert (bent > 1e-3).all()


def test_arms_that_cross_bend_as_in_a_mirror():
    beta_rad, alpha_rad = 0.6, 2 * np.pi - 0.3
    first, second = arm(-15.0, 0.0), arm(15.0, 0.0, np.pi)
    second[4] = -2 * beta_rad  # its beta arm turns the other way
    made = placed([first, second], [[alpha_rad, beta_rad], [2 * np.pi - alpha_rad, beta_rad]])
    lines = geometry.beta_segment(np.array([first, second]), *BODY_MM[:2], made.outputs_rad())
    assert geometry.segment_distance(lines[:1], lines[1:])[0] == 0.0
    bent = bent_rad(made, 20)
    assert np.abs(bent).min() > 1e-3
    # springs and cogging have no mirror: in 10 ms the rotors give way by less than 1e-4 rad of the output
    np.testing.assert_allclose(bent[0], -bent[1], atol=1e-4)


def test_arms_that_touch_at_once_are_told_pair_by_pair_in_time():
    # a row of four stretched arms, each on the next one's centre: three pairs from the start
    row = [arm(14.0 * k, 0.1 * k) for k in range(4)]
    made = placed(row, np.tile([2 * np.pi - 0.01, 0.01], (4, 1)))
    made.run(200)
    touches = made.take_touches()
    assert [t[0] for t in touches] == sorted(t[0] for t in touches)
    assert {(0, 1), (1, 2), (2, 3)} <= {t[1:] for t in touches}
    assert all(i < j for _, i, j in touches)
    assert made.take_touches() == []


@pytest.mark.parametrize("mark", range(twin.WEAR_COUNT))
def test_every_mark_of_wear_lifts_the_gear_by_a_raised_cosine(mark):
    node_rad = 2 * np.pi / twin.NODES_PER_TURN
    theta = np.arange(twin.NODES_PER_TURN // 2) * node_rad
    new, worn = gear_of(), gear_of()
    worn["wear"][mark] = centre, width, height = 1.5, 0.4, 2e-3
    ratio = float(nominal()["gear_ratio"])
    lifted, backlash = twin.transmission(plain(worn), ratio, theta)
    flat, same = twin.transmission(plain(new), ratio, theta)
    off = np.abs(theta - centre)
    expected = np.where(off < width / 2, height * 0.5 * (1 + np.cos(2 * np.pi * off / width)), 0.0)
    assert np.count_nonzero(expected) > 5
    np.testing.assert_allclose((lifted - flat) / ratio, expected, atol=1e-12)
    np.testing.assert_array_equal(backlash, same)


def bad_gear(field, order, cosine, backlash_deg=140.0):
    """A gear with one wave in one of its series."""
    gear = gear_of(backlash_deg)
    place = twin.HARMONIC_ORDERS.index(order)
    gear[field][place] = cosine, 0.0
    return gear


@pytest.mark.parametrize(
    ("gear", "message"),
    [
        # steeper than the angle itself: order times amplitude above 1
        (lambda: bad_gear("delta_rad", 3, 0.4), "delta falls faster than the angle rises"),
        (lambda: bad_gear("backlash_rad", 1, 3.0), "backlash is negative somewhere"),
        # in motor rad: 3 times 400 is more than the gear's 1024 per output rad
        (lambda: bad_gear("backlash_rad", 3, 400.0, 3e4), "backlash falls faster than the angle rises"),
    ],
)
def test_a_gear_that_would_turn_back_is_refused_and_changes_nothing(gear, message):
    made = placed([arm(0.0, 0.0)], [[1.0, 1.0]])
    before = made.backlash_rad(0, 1)
    with pytest.raises(ValueError, match=message):
        made.set_transmission(0, 1, plain(gear()))
    assert made.backlash_rad(0, 1) == before == pytest.approx(np.deg2rad(140.0))
