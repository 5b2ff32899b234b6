"""The firmware's laws run for many axes at once give the bits of the firmware's own tick."""

import copy
import struct

import numpy as np
import pytest
from wire import COLLISION, commands, goto, start, upload

from fiberloom._core import twin as core
from fiberloom.bus.identifier import encode
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Fault, Twin, draw_units
from fiberloom.twin.twin import ADAPTIVE

PLANE = generate(load_instrument("sdssv"), seed=5, n_positioners=40)  # a lane group and a quarter
UNITS = draw_units(PLANE, seed=11)
UNITS.firmware["host_timeout_ms"][16] = 500.0  # this one slows down on its trajectory: nobody talks to it
IDS = [int(i) for i in PLANE.positioner_id]
HOME, STOP, OPEN_LOOP_BETA, TRACE, READ_TRACE = 20, 15, 125, 240, 243
MORE_MARGIN = 111
STATUS = 3


def by_laws(laws):
    """The same units, their axes by these laws in turn."""
    units = copy.deepcopy(UNITS)
    units.firmware["law"] = np.resize(laws, units.firmware.shape)
    return units


def everything(side_by_side, kernel="", units=UNITS, **steps):
    """Moves of all kinds, collisions, faults, a homing, a stop, a silent host, a trace, open loop."""
    rng = np.random.default_rng(7)
    twin = Twin(PLANE, units, seed=2, threads=1, side_by_side=side_by_side, kernel=kernel, **steps)
    scopes = [twin.scope(row, axis) for row in (0, 5, 17) for axis in (0, 1)]
    replies = []
    for row in (16, 17):
        wire = [[UNITS.transmission(row, k, x)[0][0]] * 3 + np.arange(3) for k, x in enumerate((10, 170))]
        upload(twin, IDS[row], np.array([0.0, 0.4, 0.8]), *wire)
    twin.send([(encode(IDS[5], OPEN_LOOP_BETA, 1), b""), (encode(IDS[6], TRACE, 1), struct.pack("<H", 3))])
    for number in IDS[:16]:
        goto(twin, number, rng.uniform(60, 90), rng.uniform(100, 130))
    start(twin)
    twin.send([(encode(IDS[18], HOME, 1), b"")])
    replies += twin.run(0.9003)
    twin.inject(Fault("blocked", IDS[2], "alpha"))
    twin.inject(Fault("stuck_hall", IDS[3], "beta"))
    replies += twin.run(0.3)
    twin.send([(encode(IDS[7], STOP, 1), b"")])
    replies += twin.run(1.2)
    twin.send((encode(IDS[6], READ_TRACE + axis, 2), struct.pack("<H", 40)) for axis in (0, 1))
    replies += twin.run(0.01)
    logs = b"".join(s.take().tobytes() for s in scopes)
    return repr(replies).encode() + twin.truth().tobytes() + logs, commands(replies)


@pytest.mark.parametrize("kernel", core.KERNELS)
def test_side_by_side_is_the_firmware_to_the_bit(kernel):
    alone, seen = everything(False)
    together, _ = everything(True, kernel)
    assert COLLISION in {c[1] for c in seen}
    assert alone == together


@pytest.mark.parametrize("kernel", core.KERNELS)
@pytest.mark.parametrize("laws", [(1,), (0, 1, 1)])
def test_so_is_law_1_alone_and_among_others(kernel, laws):
    units = by_laws(laws)
    alone, seen = everything(False, units=units)
    together, _ = everything(True, kernel, units)
    assert COLLISION in {c[1] for c in seen}
    assert alone == together
    assert alone != everything(False)[0]


@pytest.mark.parametrize("kernel", core.KERNELS)
def test_so_it_is_in_even_steps_of_the_plant(kernel):
    """Other steps are other motions; unless told, an axis that pushes its gear takes longer ones."""
    alone, _ = everything(False, substeps=10)
    assert alone == everything(True, kernel, substeps=10)[0]
    assert alone != everything(False)[0] == everything(False, substeps=ADAPTIVE)[0]


def arrivals(side_by_side, kernel=""):
    """Short moves that land and settle, asked for status on the way; one is blocked, one never arrives."""
    rng = np.random.default_rng(8)
    twin = Twin(PLANE, UNITS, seed=2, threads=1, side_by_side=side_by_side, kernel=kernel)
    here, replies, states = twin.truth(), [], b""
    for way_deg in (3.0, -0.4):
        here = here + way_deg * rng.uniform(0.5, 1.0, here.shape) * (1.0, -1.0)
        for number, (alpha, beta) in zip(IDS, here, strict=True):
            goto(twin, number, alpha, beta)
        for k in range(100):
            twin.send([(encode(0, STATUS, 0), b"")] if k % 7 == 0 else [])
            replies += twin.run(0.0005 * float(rng.integers(1, 40)))
            states += twin.truth().tobytes()
            if k == 15:
                twin.inject(Fault("blocked", IDS[2], "alpha"))
                twin.inject(Fault("dead", IDS[3]))
    return repr(replies).encode() + states


@pytest.mark.parametrize("kernel", core.KERNELS)
def test_so_are_landings_and_settling(kernel):
    assert arrivals(False) == arrivals(True, kernel)


def margins(side_by_side, margin_deg):
    """Two moves of all. Before the second one, when lanes have had their laws, they get another margin."""
    twin = Twin(PLANE, UNITS, seed=4, threads=1, side_by_side=side_by_side, neighbours=False)
    for number in IDS:
        goto(twin, number, 12.0, 168.0)
    replies = twin.run(1.0)
    twin.send((encode(number, MORE_MARGIN, 1), struct.pack("<i", margin_deg)) for number in IDS)
    for number in IDS:
        goto(twin, number, 30.0, 150.0)
    replies += twin.run(0.3)
    twin.inject(Fault("blocked", IDS[2], "alpha"))
    return repr(replies + twin.run(0.7)).encode() + twin.truth().tobytes()


def test_lanes_have_the_parameters_that_came_over_the_bus():
    alone = margins(False, 120)
    assert margins(True, 120) == alone
    assert margins(False, 0) != alone


def motion(pieces, read):
    """The same moves in so many calls; `read`: the firmware is looked at between them."""
    twin = Twin(PLANE, UNITS, seed=3, threads=2)
    for number in IDS:
        goto(twin, number, 30.0 + number, 150.0)
    replies = []
    for k in range(pieces):
        replies += twin.run(1.2 / pieces)
        if read and k % 3 == 0:
            _ = twin._core.ticks_run
    return repr(replies).encode() + twin.truth().tobytes(), twin._core.ticks_run


def test_axes_may_cruise_on_from_call_to_call():
    whole = motion(1, False)
    assert motion(240, False) == whole
    assert motion(240, True) == whole, "what is read between two ticks changes nothing"
