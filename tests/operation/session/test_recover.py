"""After a collision: the array is locked, `recover` says what touches and takes it apart."""

import asyncio
from dataclasses import replace

import numpy as np
import pytest
from arrays import BUS, Spied, TwinArray, done, layout, session

from fiberloom.bus.client import Client
from fiberloom.bus.identifier import decode
from fiberloom.bus.protocol import Command, Status
from fiberloom.errors import InputError
from fiberloom.operation.motion import UnsafePlanError
from fiberloom.operation.session.array_lock import ArrayLock
from fiberloom.operation.session.motion import SessionMotion
from fiberloom.operation.session.recover import Recovery
from fiberloom.operation.session.session import HeldArray
from fiberloom.planning import random_configuration
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.transport import TwinTransport

PLANE = layout(7)
TANGLED_DEG = np.where(np.arange(7)[:, None] == 0, [60.0, 90.0], PLANE.park_deg)
"""One arm 0.75 mm nearer to a neighbour than the collision buffer."""


@pytest.fixture
def store(tmp_path):
    with Store.open(tmp_path / "arrays.sqlite") as store:
        ArrayBook(store, BUS).note_stopped("collision of positioners 205, 228", "locked")
        yield store


def off_park_mm(array):
    return np.hypot(*(array.twin.fibre_xy("metrology") - PLANE.forward(*PLANE.park_deg.T)).T)


def test_a_locked_array_only_recovers(store):
    array = TwinArray.of(PLANE, TANGLED_DEG)
    for command in ("park", "home"):
        with pytest.raises(
            InputError, match=r"is locked .collision of positioners 205, 228.: .*fiberloom recover"
        ):
            done(getattr(session(array, PLANE, store), command)())
    assert ArrayBook(store, BUS).state().state == "locked"


def test_arms_are_taken_apart_and_folded(store):
    array = TwinArray.of(PLANE, TANGLED_DEG)
    looked = done(session(array, PLANE, store).recover(look_only=True))
    assert looked.touching
    assert looked.stages
    assert (looked.state, array.twin.time_s < 20.0) == ("locked", True)
    assert off_park_mm(array)[0] > 1.0  # nothing has moved
    report = done(session(array, PLANE, store).recover())
    assert report.touching == looked.touching
    assert str(PLANE.positioner_id[0]) in report.touching[0]
    assert (report.state, report.ok) == ("parked", True)
    assert off_park_mm(array).max() < 0.3
    assert [e for e in store.events(store.runs()[-1].id)["kind"] if e == "touching"]
    assert done(session(array, PLANE, store).park()).state == "parked"


def test_precise_moves_are_off_while_arms_part_and_on_again_afterwards(store):
    array = TwinArray.of(PLANE, TANGLED_DEG)
    moving = int(PLANE.positioner_id[0])

    async def told():
        return {i: a.values[0] for i, a in (await client.status(ids)).items()}

    client, ids = Client(TwinTransport(array.twin)), PLANE.positioner_id.tolist()
    done(client.command(Command.SWITCH_ON_PRECISE_MOVE_ALPHA, [moving]))
    made, seen = session(array, PLANE, store), []

    async def during(transport, frames):
        seen.extend(frame[0] for frame in frames)

    spied = Spied(array, during)
    made.known = replace(made.known, source=spied)
    assert done(made.recover()).ok
    commands = [decode(i).command for i in seen if decode(i).positioner == moving]
    off, on = Command.SWITCH_OFF_PRECISE_MOVE_ALPHA, Command.SWITCH_ON_PRECISE_MOVE_ALPHA
    assert [c for c in commands if c in (off, on)] == [off, on]
    bits = done(told())
    alpha, beta = Status.PRECISE_POSITIONING_ALPHA, Status.PRECISE_POSITIONING_BETA
    assert {i for i, b in bits.items() if b & alpha} == {moving}
    assert not any(b & beta for b in bits.values())


class Killed(BaseException):
    """The process is gone: nothing is tidied up."""


@pytest.mark.parametrize("end", ["stopped", "failed", "killed"])
def test_however_a_recovery_is_cut_short_the_array_stays_locked(store, end, monkeypatch):
    array = TwinArray.of(PLANE, TANGLED_DEG)

    async def cut_short(recovery, stage):
        told.append(ArrayBook(store, BUS).state().state)
        if end == "killed":  # as its row is left
            monkeypatch.setattr("fiberloom.store.arrays.is_alive", lambda *_: False)
            monkeypatch.setattr(ArrayLock, "release", lambda lock: lock._over.set())
            patched.setattr(HeldArray, "leave", lambda *_: None)
        raise {"stopped": asyncio.CancelledError, "failed": InputError("no image"), "killed": Killed}[end]

    told = []
    with monkeypatch.context() as patched:
        patched.setattr(Recovery, "_stage", cut_short)
        with pytest.raises((asyncio.CancelledError, InputError, Killed)):
            done(session(array, PLANE, store).recover())
    assert told == ["recovering"]
    for command in ("park", "home"):
        with pytest.raises(InputError, match=r"is locked .collision of positioners 205, 228"):
            done(getattr(session(array, PLANE, store), command)())
    text = ArrayBook(store, BUS).state().text
    assert ("not recovered" in text) == (end != "killed")
    assert done(session(array, PLANE, store).recover()).state == "parked"


def test_a_stage_that_is_proven_no_more_is_planned_anew(store, monkeypatch):
    """Seed 221 of the fault campaign: the image had put a dead one 3.5 um elsewhere."""
    array, proofs, prove = TwinArray.of(PLANE, TANGLED_DEG), [], SessionMotion._verify

    def refused_once(motion, planned):
        proofs.append(planned)
        if len(proofs) == 2:
            raise UnsafePlanError("the verifier refused the planned motion")
        prove(motion, planned)

    monkeypatch.setattr(SessionMotion, "_verify", refused_once)
    report = done(session(array, PLANE, store).recover())
    assert (report.state, report.ok) == ("parked", True)
    assert len(proofs) >= 3
    texts = store.events(store.runs()[-1].id)["text"]
    assert [t for t in texts if "another way is looked for" in t]


def test_ways_in_vain_leave_it_locked(store, monkeypatch):
    array = TwinArray.of(PLANE, TANGLED_DEG)

    async def in_vain(*_):
        return False

    monkeypatch.setattr(Recovery, "_follow", in_vain)
    report = done(session(array, PLANE, store).recover())
    assert report.state == "locked"
    assert ArrayBook(store, BUS).state().text == f"touching: {', '.join(report.touching)}"


def test_nothing_to_recover_from_unlocks(store):
    report = done(session(TwinArray.of(PLANE), PLANE, store).recover())
    assert (report.touching, report.state) == ([], "parked")
    # at rest it is always possible: those that are not certain to be anywhere are looked for
    again = done(session(TwinArray.of(PLANE), PLANE, store).recover())
    assert (again.touching, again.found, again.state) == ([], [], "parked")


@pytest.mark.parametrize("rows", [[3], [0, 1, 4, 6]])
def test_those_that_do_not_move_are_gone_round_and_the_array_is_unlocked(store, rows):
    """Each is found by a collision of its own; four of them are more than the ways that are tried in vain."""
    array = TwinArray.of(PLANE, random_configuration(PLANE, 2))
    stuck = PLANE.positioner_id[rows].tolist()
    for positioner in stuck:
        array.twin.inject(Fault("stuck_hall", positioner))
    report = done(session(array, PLANE, store).recover())
    assert report.state == "parked"  # all that move
    assert {p for p, why in report.left_out.items() if why == "dead"} == set(stuck)
    assert array.twin.touches() == []
    assert done(session(array, PLANE, store).park()).state != "locked"
