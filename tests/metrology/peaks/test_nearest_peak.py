"""Which peak counts near an expected place, and where saturated spots lie, in every type of pixels."""

import numpy as np
import pytest
from test_edges import CAMERA, HEIGHT, TYPES, WIDTH, exposed, nearest

from fiberloom._core import metrology
from fiberloom.metrology import Flag

PAIR = np.array([[100.3, 120.2], [112.1, 120.4], [240.2, 200.1], [240.4, 188.3]])
"""Two pairs of spots 12 px apart."""
HOT = [(106, 124), (236, 195)]


@pytest.mark.parametrize("name", TYPES)
def test_the_nearer_of_two_spots_is_taken_and_a_hot_pixel_never(name):
    convert, fits = TYPES[name]
    frame = exposed(PAIR, 4.0)
    for x, y in HOT:
        frame[y, x] = 9000
    middle = PAIR[[0, 2]] / 2 + PAIR[[1, 3]] / 2
    for nearer, other in ((0, 1), (1, 0)):
        # 2 px from the middle towards one of them: both lie within the radius
        towards = (PAIR[[0, 2]] - middle) * (1 if nearer == 0 else -1)
        asked = middle + 2.0 * towards / np.hypot(*towards.T)[:, None]
        table = metrology.find_expected(convert(frame), fits, CAMERA, np.zeros(0), asked, 9.0)
        np.testing.assert_allclose(table[0][:, :2], PAIR[[nearer, 2 + nearer]], atol=0.05)
        assert np.hypot(*(table[0][:, :2] - PAIR[[other, 2 + other]]).T).min() > 10.0
    alone = metrology.find_expected(convert(frame), fits, CAMERA, np.zeros(0), np.array(HOT, float), 2.0)
    assert (alone[1] & int(Flag.NOT_FOUND)).all()


@pytest.mark.parametrize("name", TYPES)
def test_saturated_spots_at_the_edge_and_a_large_one_are_marked(name):
    convert, fits = TYPES[name]
    cut = np.array([[1.0, 100.2], [WIDTH - 2.0, 180.3], [90.4, 1.0], [90.2, HEIGHT - 2.0]])
    whole = np.array([[60.2, 60.4], [60.3, 230.1], [270.2, 60.3], [270.1, 230.4]])
    faint = np.array([[60.2 + 40 * k, 30.1] for k in range(6)] + [[60.2 + 40 * k, 260.3] for k in range(6)])
    frame = exposed(np.vstack([cut, whole]), 5.0, peak=1e5).astype(float)
    frame += exposed(faint, 5.0, peak=2e4) - 400.0
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    # a lamp that fills 45 px around: more pixels than are followed
    frame[np.hypot(x - 165.0, y - 145.0) < 45.0] = 65535
    image = convert(np.minimum(frame, 65535).astype(np.uint16))
    table = metrology.find_spots(image, fits, CAMERA, np.zeros(0))
    rows, off = nearest(table, whole)
    assert off.max() < 0.3
    assert (table[1][rows] & int(Flag.SATURATED)).all()
    asked = metrology.find_expected(image, fits, CAMERA, np.zeros(0), np.vstack([whole, cut]), 4.0)
    np.testing.assert_allclose(asked[0][:4, :2], whole, atol=0.3)
    assert (asked[1][:4] & int(Flag.SATURATED)).all()
