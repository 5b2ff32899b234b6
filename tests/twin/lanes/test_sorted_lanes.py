"""From START on positioners whose ways end about together are stepped together; nobody can tell."""

import struct

import numpy as np
import pytest
from wire import END, NEW, POINT, POSITION, STATUS, counts, goto, start

from fiberloom.bus.identifier import encode
from fiberloom.instruments import generate, load_instrument
from fiberloom.instruments.pointing import Pointing
from fiberloom.twin import Fault, Twin, draw_units
from fiberloom.twin.errors.sizes import TwinErrors
from fiberloom.twin.faults.kinds import FaultKind
from fiberloom.twin.twin import ADAPTIVE
from fiberloom.units import TICK_S

PLANE = generate(load_instrument("sdssv"), seed=4, n_positioners=91)
"""Three groups of lanes, the last one not full."""
UNITS = draw_units(PLANE, seed=6, errors=TwinErrors.of(PLANE.instrument, "gravity,torque"))
IDS = [int(i) for i in PLANE.positioner_id]
SET_ACTUAL_POSITION = 33
OUT = (20.0, 70.0)
"""Where arms begin, deg: apart, but within each other's reach."""


def wire_deg(twin, row):
    return [UNITS.transmission(row, k, x)[0][0] for k, x in enumerate(twin.truth()[row])]


def send_away(twin, duration_s, speeds_deg_s):
    """Each along a straight way, (N,) s and (N, 2) deg/s, through others. One that has collided refuses."""
    for row, number in enumerate(IDS):
        ends = np.array([0.0, duration_s[row]])
        frames = [(encode(number, NEW, 1), struct.pack("<II", 2, 2))]
        for at_deg, speed_deg_s in zip(wire_deg(twin, row), speeds_deg_s[row], strict=True):
            frames += [
                (
                    encode(number, POINT, 2),
                    struct.pack("<iI", counts(at_deg + speed_deg_s * t), round(t / TICK_S)),
                )
                for t in ends
            ]
        twin.send([*frames, (encode(number, END, 3), b"")])
    start(twin)


def position(twin, row):
    """Tells one where it is, which reads its hall sensors between two ticks; where it says to be then."""
    here, number = struct.pack("<ii", *map(counts, wire_deg(twin, row))), IDS[row]
    twin.send([(encode(number, SET_ACTUAL_POSITION, 9), here), (encode(number, POSITION, 10), b"")])
    return twin.run(0.0035)


def night(**options):
    """All that a twin tells of moves of all lengths, contacts, faults, questions and scopes; and its work."""
    at_stop_deg = np.rad2deg(UNITS.plant["stop_min"][:, 0]) + 0.001
    start_deg = np.where(np.arange(len(IDS)) % 5 == 0, at_stop_deg, OUT[0])
    twin = Twin(
        PLANE, UNITS, seed=1, start_deg=np.column_stack([start_deg, np.full(len(IDS), OUT[1])]), **options
    )
    twin.point(Pointing(40.0, 70.0))
    for number in IDS[::9]:
        twin.slip(number, "beta", up=0.7, down=0.9)
    rng, told = np.random.default_rng(5), []
    scopes = [twin.scope(row, axis) for row, axis in ((3, 0), (40, 1), (90, 0))]
    for longest_s in (6.0, 0.6, 5.0, 6.5, 4.5):
        twin.send([(encode(0, STATUS), b"")])  # answered in the tick of START
        send_away(twin, rng.uniform(0.3, longest_s, len(IDS)), rng.uniform(-10.0, 10.0, (len(IDS), 2)))
        told += twin.run(0.1055)
        for row in range(5, len(IDS), 6):  # on their way: where they are is a guess then
            twin.power_cycle(IDS[row])
        twin.inject(Fault(FaultKind.BLOCKED, IDS[int(longest_s * 10)]))
        twin.set_external_torque(3, 1, 0.02 * longest_s)
        goto(twin, IDS[7], 30.0, 100.0)  # refused by one that moves
        told += twin.run(1.2)
        if longest_s > 6.0:  # those that have come to rest; others are on their way, and refuse
            send_away(twin, rng.uniform(0.3, 2.0, len(IDS)), rng.uniform(-10.0, 10.0, (len(IDS), 2)))
        told += twin.run(0.3)
        told += [position(twin, row) for row in range(5, len(IDS), 6)]
        told += twin.run(0.01)
        twin.send([(encode(0, STATUS), b"")])
        told += twin.run(longest_s)
        goto(twin, IDS[8], 30.0 + longest_s, 100.0)
        told += twin.run(0.5)
        told.append(twin.truth().tobytes())
    told += [scope.take().tobytes() for scope in scopes]
    return told, twin.touches(), twin._core.group_ticks


@pytest.mark.parametrize("steps", [10, ADAPTIVE])
def test_sorted_or_not_the_same_bytes(steps):
    told, touches, unsorted = night(threads=1, sort_lanes=False, substeps=steps)
    assert len(touches) >= 3
    work = {}
    for threads in (1, 2, 3):
        again, touches_again, work[threads] = night(threads=threads, substeps=steps)
        assert touches_again == touches
        assert again == told
    assert work[1] < 0.95 * unsorted
    assert work[3] == unsorted  # a group for each thread


@pytest.mark.parametrize("knob", ["skip_resting", "side_by_side"])
def test_however_the_rest_is_computed(knob):
    told, touches, _ = night(threads=2)
    again, touches_again, _ = night(threads=2, **{knob: False})
    assert touches_again == touches
    assert again == told


def waits(sort_lanes):
    """Ticks of groups in a field in which one in eight is under way for long."""
    twin = Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False, start_deg=OUT, sort_lanes=sort_lanes)
    duration_s = np.where(np.arange(len(IDS)) % 8 == 0, 10.0, 1.0)
    send_away(twin, duration_s, np.full((len(IDS), 2), (1.0, -1.0)))
    twin.run(12.0)
    return twin._core.group_ticks


def test_groups_rest_when_all_of_them_rest():
    """Twelve that move for 10 s are one group's, not three's."""
    assert waits(True) < 0.5 * waits(False)
