"""What a session concludes from status bits, collisions and an owner that is gone."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest
from arrays import TwinArray, done, layout, session

from fiberloom.bus.outcome import Outcome, Result, Results
from fiberloom.bus.protocol import Status
from fiberloom.health.past_runs import health_report
from fiberloom.operation.session.motion import SessionMotion
from fiberloom.operation.session.session import HeldArray
from fiberloom.operation.session.states import SessionState, Step
from fiberloom.store import Store

BOTH = Status.DATUMS_INITIALIZED


class ThreePositioners:
    """Rows 0 to 2, numbers 10 to 12."""

    positioner_id = np.array([10, 11, 12])

    def __len__(self):
        return 3

    def index_of(self, positioner):
        return positioner - 10


@pytest.mark.parametrize(
    ("bits", "powered"),
    [
        (BOTH, True),
        (0, False),
        (Status.DATUM_ALPHA_INITIALIZED, False),
        (BOTH | Status.POSITION_RESTORED, False),
        (BOTH | Status.ESTIMATED_POSITION, False),
        (Status.POSITION_RESTORED, False),
    ],
)
def test_a_datum_holds_where_both_are_set_and_power_has_not_gone(bits, powered):
    async def status(ids):
        answers = Results({int(i): Result(int(i), Outcome.DONE, values=(bits,)) for i in ids})
        answers[11] = Result(11, Outcome.TIMED_OUT)
        return answers

    motion = SimpleNamespace(plane=ThreePositioners(), client=SimpleNamespace(status=status))
    found = asyncio.run(SessionMotion._powered(motion, np.array([True, True, False])))
    # the second does not answer, the third was not asked
    assert found.tolist() == [powered, False, False]


@pytest.mark.parametrize(
    ("interrupted", "collided"),
    [([], []), ([True], [4, 9]), ([True, False], []), ([False, True], [4, 9]), ([False, True, False], [])],
)
def test_a_collision_counts_where_the_last_move_did_not_end(interrupted, collided):
    reports = [SimpleNamespace(positioner=p) for p in (9, 4, 9)]
    moves = [SimpleNamespace(interrupted=i) for i in interrupted]
    motion = SimpleNamespace(client=SimpleNamespace(collisions=reports), moves=moves, has_client=True)
    assert SessionMotion.collided.fget(motion) == collided
    quiet = SimpleNamespace(client=SimpleNamespace(collisions=[]), moves=moves, has_client=True)
    assert SessionMotion.collided.fget(quiet) == []


class Lock:
    """Keeps the steps."""

    def __init__(self, lost=False):
        self.lost, self.state, self.steps = lost, SessionState.MOVING, []

    def step(self, step, text=""):
        self.steps.append((step, text))


@pytest.mark.parametrize(
    ("motion", "step", "text"),
    [
        (None, Step.LOSE, "disk full"),
        (SimpleNamespace(collided=[]), Step.LOSE, "disk full"),
        (SimpleNamespace(collided=[4]), Step.COLLIDE, "collision; disk full"),
    ],
)
def test_a_command_that_ends_with_a_collision_locks_the_array_whatever_else_went_wrong(motion, step, text):
    held = HeldArray(None, Lock(), "")
    held._motion = motion
    held.leave(Step.LOSE, "disk full")
    assert held.lock.steps == [(step, text)]
    lost = HeldArray(None, Lock(lost=True), "")
    lost._motion = motion
    lost.leave(Step.LOSE, "disk full")
    assert lost.lock.steps == []


def test_an_array_that_was_stopped_stays_so_whatever_the_reason():
    held = HeldArray(None, Lock(), "")
    held.lock.state = SessionState.STOPPED
    held.leave(Step.LOSE, "no image")
    assert held.lock.steps == []
    held._motion = SimpleNamespace(collided=[4])
    held.leave(Step.LOSE, "no image")
    assert held.lock.steps == [(Step.COLLIDE, "collision; no image")]


def test_every_run_of_a_session_is_in_the_report_of_health(tmp_path):
    plane = layout(7)
    with Store.open(tmp_path / "arrays.sqlite") as store:
        array = TwinArray.of(plane, plane.park_deg)
        moves = 0
        for number in (1, 2):
            done(session(array, plane, store).park())
            moves += store.runs()[-1].n_moves
            found = health_report(str(tmp_path), plane)
            assert (found["runs"], found["moves"]) == (number, moves)
        assert found["states"]["healthy"] == len(plane)
        # each was given back by the one before
        assert all("taken over" not in store.events(run.id)["kind"] for run in store.runs())
