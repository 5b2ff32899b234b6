"""The whole loop on DESI's twin; and what the drive does when a table is lost, or a move is stopped."""

import asyncio

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.bus.motion import MotionWatch
from fiberloom.bus.outcome import Outcome
from fiberloom.drive.desi import DesiCommand, DesiFrame
from fiberloom.drive.desi.drive import DesiDrive
from fiberloom.drive.desi.frames import STILL_ALIVE_S
from fiberloom.drive.port import Wanted
from fiberloom.errors import InputError
from fiberloom.targets.generate import random_targets
from fiberloom.twin.desi import DesiTwin
from fiberloom.twin.desi.transport import DesiTransport

N = 60


@pytest.fixture(scope="module")
def plane():
    return fl.FocalPlane.of("desi", seed=0, n=N)


def observed(plane, fields=1, **how):
    """Summaries of fields one after another, and the twin."""
    field = fl.Field.twin(plane, seed=0, camera="noise", **how)

    async def scenario():
        return [
            (await field.observe(random_targets(plane, 2 * N, seed=k), corrections=1)).summary()
            for k in range(fields)
        ]

    return asyncio.run(scenario()), field.source.twin


@pytest.fixture(scope="module")
def three_fields(plane):
    return observed(plane, 3)


def test_a_field_is_observed_without_contacts(three_fields):
    summaries, twin = three_fields
    assert twin.touches() == []
    for summary in summaries:
        blind, corrected = summary["moves"]
        assert summary["collisions_verified"] == 0
        assert 25.0 < blind["true_rms_um"] < 75.0
        assert corrected["true_rms_um"] < 5.0
        assert summary["n_valid"] > 0.9 * summary["n_assigned"]


def test_real_durations(three_fields):
    """Blind moves of the instrument take 8.1 s, corrections 3.0 s in the median."""
    summaries, _ = three_fields
    for summary in summaries:
        assert 5.0 < summary["motion_s"] < 14.0


def test_broken_units_are_found_and_the_others_arrive(plane):
    summaries, twin = observed(plane, faults="dark=2,dead=2,deaf=1")
    (summary,) = summaries
    told = summary["faults"]
    assert len(told["dark"]) == 2
    dead = plane.positioner_id[twin.units.stuck].tolist()
    assert set(told.get("lying", [])) <= set(dead)
    assert set(told["dead"]) == twin.deaf
    assert summary["moves"][-1]["true_rms_um"] < 5.0
    assert twin.touches() == []


@pytest.mark.parametrize(("faults", "told"), [("blocked=1", "blocked"), ("powercut=1", "powercut")])
def test_faults_that_this_twin_does_not_have_are_refused(plane, faults, told):
    with pytest.raises(InputError, match=told):
        fl.Field.twin(plane, faults=faults)


class Wire(DesiTransport):
    """Loses frames, or stops a move."""

    def __init__(self, twin, loses=lambda frame: False):
        super().__init__(twin)
        self.loses, self.sent = loses, []

    async def send(self, frames):
        frames = [DesiFrame(*frame[:2]) for frame in frames]
        self.sent += frames
        await super().send([frame for frame in frames if not self.loses(frame)])


def moved(plane, loses=lambda frame: False, during=None):
    """One unit of 20 deg and 10 deg by the drive; results, drive, wire, twin."""
    twin = DesiTwin(plane, seed=0)
    wire = Wire(twin, loses)
    drive = DesiDrive(plane, wire)

    async def scenario():
        await drive.connect()
        here = plane.park_deg
        goal = here - np.where(np.arange(N)[:, None] < 3, [20.0, 10.0], 0.0)
        programme = await drive.prepare(Wanted(plane, here, goal, np.full(N, 3.0)))
        if during is not None:
            during(drive)
        return await drive.run(programme, MotionWatch(), print)

    return asyncio.run(scenario()), drive, wire, twin


def test_a_move_is_counted_and_done(plane):
    results, drive, _, twin = moved(plane)
    assert [r.outcome for r in results.values()] == [Outcome.DONE] * 3
    np.testing.assert_allclose(drive.maps.believed_deg[:3], plane.park_deg[:3] - [20.0, 10.0], atol=1e-3)
    # gears that are not straight: below 2 deg
    assert np.abs(twin.truth() - drive.maps.believed_deg).max() < 2.0


def test_no_table_runs_where_one_was_lost(plane):
    lost = int(plane.positioner_id[1])
    results, drive, wire, twin = moved(plane, lambda f: f.can_id == lost and f.command == DesiCommand.ROW)
    assert results[lost].outcome is Outcome.REFUSED  # it answers, and has no table
    assert [r.outcome for i, r in results.items() if i != lost] == [Outcome.STOPPED] * 2
    assert DesiCommand.RUN not in [frame.command for frame in wire.sent]
    np.testing.assert_array_equal(drive.maps.believed_deg, plane.park_deg)
    np.testing.assert_allclose(twin.truth(), plane.park_deg, atol=1e-9)


def test_a_lost_row_is_sent_again(plane):
    once = []

    def loses(frame):
        first = frame.command == DesiCommand.ROW and not once
        once.extend([1] if first else [])
        return first

    results, *_ = moved(plane, loses)
    assert all(r.ok for r in results.values())


def test_tables_of_the_last_move_do_not_run_again(plane):
    twin = DesiTwin(plane, seed=0)
    drive = DesiDrive(plane, DesiTransport(twin))

    async def scenario():
        await drive.connect()
        here = plane.park_deg
        for rows in (slice(0, 3), slice(3, 6)):
            goal = here.copy()
            goal[rows] -= [15.0, 5.0]
            programme = await drive.prepare(Wanted(plane, here, goal, np.full(N, 3.0)))
            await drive.run(programme, MotionWatch(), print)
            here = drive.maps.believed_deg.copy()

    asyncio.run(scenario())
    assert np.abs(twin.truth() - drive.maps.believed_deg).max() < 2.0


def test_a_stopped_move_is_counted_as_far_as_it_went(plane):
    twin = DesiTwin(plane, seed=0)
    drive = DesiDrive(plane, DesiTransport(twin))

    async def scenario():
        await drive.connect()
        here = plane.park_deg
        goal = here - np.where(np.arange(N)[:, None] < 3, [90.0, 10.0], 0.0)
        programme = await drive.prepare(Wanted(plane, here, goal, np.full(N, 3.0)))
        sleep = drive.sleep

        async def interrupted(duration_s):
            await sleep(0.4)
            raise KeyboardInterrupt

        drive.sleep = interrupted
        with pytest.raises(KeyboardInterrupt):
            await drive.run(programme, MotionWatch(), print)
        drive.sleep = sleep
        return await drive.stop()

    answered = asyncio.run(scenario())
    assert answered == sorted(plane.positioner_id.tolist())
    gone = plane.park_deg[:3] - drive.maps.believed_deg[:3]
    assert np.all((gone[:, 0] > 20.0) & (gone[:, 0] < 88.0))
    # the play and the gear: 2.2 and 2 deg
    assert np.abs(twin.truth() - drive.maps.believed_deg).max() < 4.5


def test_trajectories_made_elsewhere_are_refused(plane):
    drive = DesiDrive(plane, DesiTransport(DesiTwin(plane, seed=0)))
    made = fl.plan(plane, plane.park_deg, plane.park_deg - [10.0, 5.0])
    with pytest.raises(InputError, match="run tables"):
        asyncio.run(drive.compile(made))


def test_nobody_on_the_bus_is_told(plane):
    drive = DesiDrive(plane, Wire(DesiTwin(plane, seed=0), lambda frame: True))
    with pytest.raises(InputError, match="none of the 60 positioners"):
        asyncio.run(drive.connect())


def test_units_that_heard_nothing_for_long_are_woken_before_they_run(plane):
    """Units in standby take a table and answer for it, but run nothing: plans may take longer."""
    twin = DesiTwin(plane, seed=0)

    async def scenario():
        drive = DesiDrive(plane, DesiTransport(twin))
        await drive.connect()
        twin.run(STILL_ALIVE_S + 1.0)
        goal = plane.park_deg - np.where(np.arange(N)[:, None] < 3, [20.0, 10.0], 0.0)
        programme = await drive.prepare(Wanted(plane, plane.park_deg, goal, np.full(N, 3.0)))
        results = await drive.run(programme, MotionWatch(), print)
        return results, drive.maps.believed_deg

    results, believed = asyncio.run(scenario())
    assert len(results) == 3
    np.testing.assert_allclose(believed[:3], plane.park_deg[:3] - [20.0, 10.0], atol=1e-3)
    # no more than gears and play make of it
    assert np.abs(twin.truth() - believed).max() < 2.5
