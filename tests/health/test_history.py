"""What a store remembers of moves, as the monitor is told it."""

import numpy as np

from fiberloom.health.history import passages
from fiberloom.health.status import FibreStatus
from fiberloom.instruments import generate, load_instrument
from fiberloom.store.run import CUT_SHORT, START

PLANE = generate(load_instrument("sdssv"), seed=0, n_positioners=4)
STATUS = (FibreStatus.ON_TARGET, FibreStatus.DEAD, FibreStatus.DEAD, FibreStatus.BLOCKED)


class Remembered:
    """A store of one run; `cut_short`: moves that were, by their number."""

    def __init__(self, columns, cut_short=()) -> None:
        self._columns, self._cut_short = columns, list(cut_short)

    def measurements(self, run_id):
        return self._columns

    def moves(self, run_id):
        ids = np.unique(self._columns["move_id"])
        return {"id": ids, "utc": ids.astype(float)}

    def events(self, run_id):
        kinds = np.array([CUT_SHORT] * len(self._cut_short))
        return {"kind": kinds, "utc": np.array(self._cut_short, dtype=float) + 0.5}


def columns(angles_deg, kinds, status, seen):
    """Columns of moves (M, N, 2), all positioners in each; the motors are where the arms are."""
    moves, n, _ = angles_deg.shape
    alpha, beta = angles_deg.reshape(-1, 2).T
    x, y = PLANE.forward(alpha, beta, "metrology", index=np.tile(np.arange(n), moves)).T
    return {
        "move_id": np.repeat(np.arange(moves), n),
        "kind": np.repeat(kinds, n),
        "positioner_id": np.tile(PLANE.positioner_id, moves),
        "alpha_deg": alpha,
        "beta_deg": beta,
        "wire_alpha_deg": alpha,
        "wire_beta_deg": beta,
        "x_mm": x,
        "y_mm": y,
        "seen": np.ravel(seen),
        "status": np.array([str(s) for s in np.ravel(status)], dtype=object),
    }


def test_a_move_is_told_as_it_was_recorded():
    start = np.array([[10.0, 90.0], [20.0, 95.0], [30.0, 100.0], [40.0, 105.0]])
    goal = start + np.array([[5.0, 0.0], [0.0, -5.0], [0.0, 0.0], [5.0, 5.0]])
    seen = [[True] * 4, [True, True, True, False]]
    recorded = columns(np.stack([start, goal]), [START, "field"], [[FibreStatus.ON_TARGET] * 4, STATUS], seen)
    first, second = passages(Remembered(recorded), 1, PLANE)
    assert not first.asked.any()
    np.testing.assert_array_equal(first.believed_deg, start)
    np.testing.assert_array_equal(second.before_deg, start)
    np.testing.assert_array_equal(second.believed_deg, goal)
    # the third was not told to move: that it is dead says nothing of this move
    assert second.asked.tolist() == [True, True, False, True]
    assert second.collided.tolist() == [False, True, False, False]
    assert second.arrived.tolist() == [True, False, False, False]
    assert np.isfinite(second.seen_mm).all(axis=1).tolist() == [True, True, True, False]
    np.testing.assert_allclose(second.seen_mm[:3], PLANE.forward(*goal.T, "metrology")[:3])


def test_a_motor_far_from_its_command_has_not_arrived():
    start = np.tile([50.0, 90.0], (4, 1))
    goal = start + np.array([3.0, 0.0])
    recorded = columns(
        np.stack([start, goal]),
        [START, "field"],
        np.full((2, 4), FibreStatus.ON_TARGET),
        np.ones((2, 4), bool),
    )
    recorded["wire_alpha_deg"] = recorded["alpha_deg"].copy()
    # 0.6 deg is what a gear may be off by, 1.5 deg is half of the way
    recorded["wire_alpha_deg"][4:6] -= [0.6, 1.5]
    second = list(passages(Remembered(recorded), 1, PLANE))[1]
    assert second.arrived.tolist() == [True, False, True, True]


def test_who_was_in_a_move_that_was_cut_short_has_not_arrived():
    start = np.tile([50.0, 90.0], (4, 1))
    places = np.stack([start, start + 3.0, start + 6.0])
    on_target = np.full((3, 4), FibreStatus.ON_TARGET)
    recorded = columns(places, [START, "field", "field"], on_target, np.ones((3, 4), bool))
    stopped = np.unique(recorded["move_id"])[1]
    told = list(passages(Remembered(recorded, [stopped]), 1, PLANE))
    assert [p.arrived.all() for p in told] == [True, False, True]
    # its command is not where the next one begins
    assert np.isnan(told[2].before_deg).all()
