"""Broken hardware, as seen from the bus and from the camera."""

import struct

import numpy as np
import pytest
from wire import COLLISION, POSITION, STATUS, commands, goto

from fiberloom.bus.identifier import decode, encode
from fiberloom.bus.protocol import Command, Response, Status
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Fault, FaultKind, Twin, draw_units
from fiberloom.units import COUNTS_PER_DEG

PLANE = generate(load_instrument("sdssv"), seed=8, n_positioners=3)
UNITS = draw_units(PLANE, seed=2)
IDS = [int(i) for i in PLANE.positioner_id]
VICTIM, HEALTHY = IDS[0], IDS[1]


def move(fault, alpha_deg=44.0, beta_deg=124.0, run_s=2.0):
    twin = Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False, start_deg=(40.0, 120.0))
    before = twin.truth()
    twin.inject(Fault(fault, VICTIM))
    for number in (VICTIM, HEALTHY):
        goto(twin, number, alpha_deg, beta_deg)
    replies = twin.run(run_s)
    moved = twin.truth() - before
    assert (np.abs(moved[1] - 4.0) < 0.6).all()  # the neighbour is not affected
    return twin, moved[0], commands(replies)


def status(twin, number):
    twin.send([(encode(number, STATUS, 9), b"")])
    replies = twin.run(0.001)
    return Status(int.from_bytes(replies[-1].data, "little")) if replies else None


@pytest.mark.parametrize("fault", [FaultKind.DEAD, FaultKind.BLOCKED])
def test_a_motor_that_does_not_turn_is_a_collision(fault):
    twin, moved, replies = move(fault)
    assert np.abs(moved).max() < 1e-3
    assert (VICTIM, COLLISION) in replies
    assert (HEALTHY, COLLISION) not in replies
    assert (Status.COLLISION_ALPHA | Status.COLLISION_BETA) & status(twin, VICTIM)


def test_a_lying_positioner_reports_arrival_and_has_not_moved():
    twin, moved, replies = move(FaultKind.LYING)
    assert (moved == 0.0).all()
    assert (VICTIM, COLLISION) not in replies
    assert Status.DISPLACEMENT_COMPLETED in status(twin, VICTIM)
    # repaired: it moves again, from where it stands, and is off by what it did not move
    twin.clear(Fault(FaultKind.LYING, VICTIM))
    assert twin.truth()[0] == pytest.approx([40.0, 120.0], abs=1e-9)
    goto(twin, VICTIM, 49.0, 129.0)
    twin.run(2.0)
    assert twin.truth()[0] == pytest.approx([45.0, 125.0], abs=0.7)


def test_a_stuck_hall_sensor_stops_the_axis():
    _, moved, replies = move(FaultKind.STUCK_HALL)
    assert (VICTIM, COLLISION) in replies
    assert np.abs(moved).max() < 0.5


def test_deaf_and_mute():
    _, moved, replies = move(FaultKind.DEAF)
    assert (moved == 0.0).all()
    assert VICTIM not in {r[0] for r in replies}
    twin, moved, replies = move(FaultKind.MUTE)
    assert np.abs(moved - 4.0).max() < 0.6
    assert VICTIM not in {r[0] for r in replies}
    assert status(twin, VICTIM) is None


def test_one_axis_alone():
    twin = Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False, start_deg=(40.0, 120.0))
    twin.inject(Fault("lying", VICTIM, "beta"))
    goto(twin, VICTIM, 44.0, 124.0)
    twin.run(2.0)
    alpha, beta = twin.truth()[0] - [40.0, 120.0]
    assert (abs(alpha - 4.0) < 0.6, beta) == (True, pytest.approx(0.0, abs=1e-12))


def test_offline_positioners_stand_and_keep_silent():
    plane = PLANE.with_offline([HEALTHY], [33.0, 150.0])
    twin = Twin(plane, UNITS, threads=1, neighbours=False)
    twin.send([(encode(0, STATUS), b"")])
    assert HEALTHY not in {r[0] for r in commands(twin.run(0.001))}
    assert twin.truth()[1] == pytest.approx([33.0, 150.0])


def test_after_a_power_cut_in_motion_a_positioner_finds_its_datum_again():
    """A unit comes with its datum calibrated and saved: the operator's `home` needs no bench."""
    twin = Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False, start_deg=(6.0, 174.0))
    goto(twin, VICTIM, 10.0, 170.0)
    twin.run(0.3)
    twin.power_cycle(VICTIM)
    assert Status.ESTIMATED_POSITION in status(twin, VICTIM)
    assert Status.DATUM_ALPHA_INITIALIZED not in status(twin, VICTIM)
    twin.send([(encode(VICTIM, Command.GO_TO_DATUMS, 5), b"")])
    assert [decode(reply.id).code for reply in twin.run(0.01)] == [Response.ACCEPTED]
    twin.run(150.0)
    assert Status.DATUMS_INITIALIZED in status(twin, VICTIM)
    twin.send([(encode(VICTIM, POSITION, 6), b"")])
    (reply,) = twin.run(0.001)
    reported_deg = np.array(struct.unpack("<ii", reply.data)) / COUNTS_PER_DEG
    assert reported_deg == pytest.approx(twin.truth()[0], abs=1.0)


def test_a_datum_search_finds_the_zero_that_a_unit_came_with():
    """A motor turn off would be 0.35 deg: maps that were made before `home` hold after it."""
    twin = Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False, start_deg=(6.0, 174.0))

    def at_the_same_reports_deg():
        for place_deg in ((8.0, 165.0), (10.0, 170.0)):  # from below, as before
            for number in IDS:
                goto(twin, number, *place_deg)
            twin.run(40.0)
        return twin.truth()

    before_deg = at_the_same_reports_deg()
    for number in IDS:
        twin.send([(encode(number, Command.GO_TO_DATUMS, 5), b"")])
    twin.run(150.0)
    assert np.abs(at_the_same_reports_deg() - before_deg).max() < 0.02


def test_power_cycle_ends_a_move():
    twin = Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False, start_deg=(40.0, 120.0))
    goto(twin, VICTIM, 60.0, 140.0)
    twin.run(0.5)
    twin.power_cycle(VICTIM)
    twin.run(0.2)
    here = twin.truth()[0]
    twin.run(1.0)
    assert (twin.truth()[0] == here).all()
    assert 41.0 < here[0] < 59.0
