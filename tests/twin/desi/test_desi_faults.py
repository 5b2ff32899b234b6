"""Half a petal without power, motors that slip, replies that are lost or wrong: flagged; the rest goes on."""

import asyncio

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.bus.motion import MotionWatch
from fiberloom.bus.outcome import Outcome
from fiberloom.bus.transport import Frame
from fiberloom.drive.desi import DesiCommand
from fiberloom.drive.desi.drive import TRIES, DesiDrive
from fiberloom.drive.port import Wanted
from fiberloom.targets.generate import random_targets
from fiberloom.twin.desi import DesiTwin
from fiberloom.twin.desi.source import buses_of
from fiberloom.twin.desi.transport import DesiTransport
from fiberloom.twin.faults.faults import Fault

N = 120
PLANE = fl.FocalPlane.of("desi", seed=0, n=N)


def fields(count, faults):
    """Summaries of fields one after another, and the source."""
    field = fl.Field.twin(PLANE, seed=0, camera="noise", faults=faults)

    async def scenario():
        return [
            (await field.observe(random_targets(PLANE, 2 * N, seed=k), corrections=1)).summary()
            for k in range(count)
        ]

    return asyncio.run(scenario()), field.source


@pytest.fixture(scope="module")
def half_a_petal():
    """Its bus and power go in the first blind move, and come back in the second field."""
    return fields(3, "busoff=1@4+20")


def test_half_a_petal_falls_silent_in_a_move_and_the_rest_goes_on(half_a_petal):
    (first, _, _), source = half_a_petal
    place = source.faults[0].place
    silent = PLANE.positioner_id[[bus == place for bus in buses_of(PLANE)]]
    dead = first["faults"]["dead"]
    assert len(dead) > 3
    assert set(dead) <= set(silent.tolist())
    assert first["contacts_true"] == 0
    assert first["moves"][-1]["true_rms_um"] < 5.0
    # all that answer and have a target are measured
    assert first["n_valid"] >= first["n_assigned"] - len(silent) - 3


def test_who_answers_again_is_believed_where_it_is_seen_and_observes_again(half_a_petal):
    (_, _, third), source = half_a_petal
    assert source.twin.deaf == set()
    assert set(third["faults"]) <= {"blocked"}
    assert third["contacts_true"] == 0
    blind, corrected = third["moves"]
    assert blind["true_rms_um"] < 75.0
    assert corrected["true_rms_um"] < 5.0


def test_a_slipping_motor_that_nobody_knows_is_found_from_images():
    """At once where its way is long; after two surprises where it is short."""
    summaries, source = fields(3, "slipping=5")
    slips = {fault.positioner_id for fault in source.faults}
    kinds = ("astray", "lying", "unsure")
    found = {k for kind in kinds for s in summaries for k in s["faults"].get(kind, [])}
    assert found == slips
    assert summaries[-1]["moves"][-1]["true_rms_um"] < 5.0
    healthy = ~np.isin(PLANE.positioner_id, list(slips))
    assert not source.hardware.drive.maps.surprises[healthy].any()


def test_replies_that_are_lost_are_asked_for_again():
    (summary,), _ = fields(1, "lost=0.05")
    assert set(summary["faults"]) <= {"blocked"}
    assert summary["moves"][-1]["true_rms_um"] < 5.0


def moved(wrong):
    """Three units by the drive, on a bus whose checksums are wrong where `wrong(number, time)` says so."""
    twin = DesiTwin(PLANE, seed=0)

    class Bus(DesiTransport):
        asked = 0

        async def receive(self, timeout_s):
            replies = await super().receive(timeout_s)
            return [self.spoilt(reply) for reply in replies]

        def spoilt(self, reply):
            if reply.id & 0xFF != DesiCommand.CHECKSUM or reply.id >> 8 != number:
                return reply
            self.asked += 1
            return Frame(reply.id, bytes(4), reply.time_s) if wrong(self.asked) else reply

    number = int(PLANE.positioner_id[1])
    bus = Bus(twin)
    drive = DesiDrive(PLANE, bus)

    async def scenario():
        await drive.connect()
        goal = PLANE.park_deg - np.where(np.arange(N)[:, None] < 3, [20.0, 10.0], 0.0)
        programme = await drive.prepare(Wanted(PLANE, PLANE.park_deg, goal, np.full(N, 3.0)))
        return await drive.run(programme, MotionWatch(), print)

    return asyncio.run(scenario()), number, bus, twin


def test_a_wrong_checksum_sends_the_table_again():
    results, _, bus, _ = moved(lambda asked: asked == 1)
    assert all(result.ok for result in results.values())
    assert bus.asked == 2


def test_a_checksum_that_stays_wrong_is_the_fault_of_its_unit_alone():
    results, number, bus, twin = moved(lambda asked: True)
    assert bus.asked == TRIES
    assert results[number].outcome is Outcome.REFUSED
    assert {r.outcome for k, r in results.items() if k != number} == {Outcome.STOPPED}
    np.testing.assert_allclose(twin.truth(), PLANE.park_deg, atol=1e-9)


def test_a_motor_without_power_stops_where_it_is_and_forgets_its_table():
    twin = DesiTwin(PLANE, seed=0, contacts=False)
    drive = DesiDrive(PLANE, DesiTransport(twin))
    number = int(PLANE.positioner_id[0])

    async def scenario():
        await drive.connect()
        goal = PLANE.park_deg.copy()
        goal[0] -= [90.0, 10.0]
        programme = await drive.prepare(Wanted(PLANE, PLANE.park_deg, goal, np.full(N, 3.0)))
        await drive._load(programme.commands.tables, [number])
        await drive._broadcast(DesiCommand.RUN, b"\x01")

    asyncio.run(scenario())
    twin.run(0.4)
    twin.inject(Fault("busoff", number))
    there = twin.truth()[0].copy()
    twin.run(5.0)
    np.testing.assert_array_equal(twin.truth()[0], there)
    assert 20.0 < PLANE.park_deg[0, 0] - there[0] < 89.0
    assert not twin.controllers[number].rows
    assert number in twin.deaf
    twin.clear(Fault("busoff", number))
    assert number not in twin.deaf
