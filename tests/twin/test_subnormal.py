"""No law counts on with subnormal floats: a processor takes a hundred times as long, and twins slow down."""

import copy

import numpy as np
import pytest
from wire import start, upload

from fiberloom._core import firmware as fw
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Twin, draw_units

PLANE = generate(load_instrument("sdssv"), seed=5, n_positioners=32)
UNITS = draw_units(PLANE, seed=11)
WAY_S = np.array([0.0, 1.0, 3.0, 4.0])  # there, a wait of two seconds as in a planned field, and back


@pytest.fixture(autouse=True)
def told():
    """Nothing of what was met before."""
    if fw.subnormals_met() is None:
        pytest.skip("this processor does not tell of subnormal floats: x86-64 does")


def test_the_processor_tells_of_them():
    fw.follow(1e-40, 0.0, 0.5)
    assert fw.subnormals_met()
    assert not fw.subnormals_met()


@pytest.mark.parametrize("law", [0, 1])
@pytest.mark.parametrize("side_by_side", [True, False])
def test_arms_that_wait_on_their_way_meet_none(law, side_by_side):
    units = copy.deepcopy(UNITS)
    units.firmware["law"] = law
    twin = Twin(PLANE, units, seed=2, threads=1, neighbours=False, side_by_side=side_by_side)
    for row, number in enumerate(PLANE.positioner_id.tolist()):
        there_deg = [units.transmission(row, axis, x)[0][0] for axis, x in enumerate((10.0, 170.0))]
        upload(twin, number, WAY_S, *(at_deg + np.array([0.0, 8.0, 8.0, 0.0]) for at_deg in there_deg))
    start(twin)
    fw.subnormals_met()
    met = []
    for _ in range(10):
        twin.run(0.5)
        met.append(fw.subnormals_met())
    assert not any(met), f"by half seconds: {met}"
    assert np.ptp(twin.truth(), axis=0).max() < 2.0
