"""What stops in a blind move is gone round, as often as the settings say."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

from fiberloom.operation import motion as operation

N = 4


GOALS = SimpleNamespace(angles_deg=np.full((N, 2), 90.0), approach_deg=None)


class Field:
    """Stands in for a motion whose moves are interrupted as many times as asked."""

    def __init__(self, interrupted_times):
        self.interrupted_times = interrupted_times
        self.labels, self.events = [], []
        self.state = SimpleNamespace(
            mobile=np.ones(N, dtype=bool),
            here_deg=np.zeros((N, 2)),
            obstacles=lambda: None,
            book_blocked=lambda planned: None,
        )
        self.recorder = SimpleNamespace(event=lambda kind, text, *which: self.events.append((kind, text)))

        self.drive, self.asked = SimpleNamespace(prepare=self.prepare), []

    wanted, _prepared = operation.FieldMotion.wanted, operation.FieldMotion._prepared
    ahead = None

    async def prepare(self, wanted):
        self.asked.append(wanted)
        return SimpleNamespace(plan=wanted.seed)

    def progress(self, label):
        pass

    async def move(self, number, label, planned, goals):
        self.labels.append((number, label, planned.plan))
        return np.arange(N) < (2 if len(self.labels) <= self.interrupted_times else 0)


@pytest.mark.parametrize(
    ("recoveries", "interrupted_times", "n_moves", "n_events"),
    [(0, 0, 1, 0), (0, 9, 1, 1), (2, 0, 1, 0), (2, 1, 2, 1), (2, 2, 3, 2), (2, 9, 3, 3)],
)
def test_an_interrupted_move_is_planned_again(recoveries, interrupted_times, n_moves, n_events):
    field = Field(interrupted_times)
    asyncio.run(operation.FieldMotion.go(field, GOALS, seed=7, recoveries=recoveries))
    labels = ["blind", *(f"{operation.ROUND_FAULTS} {i}" for i in range(1, n_moves))]
    # each plan has a seed of its own, and all of it is move 1
    assert field.labels == [(1, label, 7 + i) for i, label in enumerate(labels)]
    assert field.events == [("recovery", "2 positioners interrupted")] * n_events


def test_what_cannot_move_is_planned_to_stay():
    field = Field(0)
    field.state.mobile[1] = False
    asyncio.run(operation.FieldMotion.go(field, GOALS, recoveries=0))
    np.testing.assert_array_equal(field.asked[0].goal_deg[:, 0], [90.0, 0.0, 90.0, 90.0])
