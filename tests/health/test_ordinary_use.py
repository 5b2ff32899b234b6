"""What `fiberloom health` says of healthy positioners after ordinary use: nothing, whatever was between."""

import numpy as np
import pytest
from visits import RIPPLE_DEG

from fiberloom.health.history import passages
from fiberloom.health.monitor import Ailment, HealthMonitor, State
from fiberloom.instruments import generate, load_instrument
from fiberloom.store import Store
from fiberloom.store.run import START

PLANE = generate(load_instrument("sdssv"), seed=0, n_positioners=12)
N = len(PLANE)
PARKED = np.tile(PLANE.instrument.positioner.park_deg, (N, 1))
ILL = 3


class Days:
    """Runs of a store by arithmetic: positioners that believe where they are, and a camera."""

    def __init__(self, seed=1):
        self.rng = np.random.default_rng(seed)
        self.phase = self.rng.uniform(0, 2 * np.pi, (N, 2))
        self.off_deg = np.zeros((N, 2))
        self.share = np.ones((N, 2))
        self.stuck = np.zeros(N, dtype=bool)
        self.map_um = 0.0  # by which the map of one errs at the end of its correction

    def seen_mm(self, at_deg):
        ripple = np.sqrt(2) * np.sin(204 * np.radians(at_deg) + self.phase)
        true = at_deg + self.off_deg + RIPPLE_DEG * ripple
        noise_mm = 0.7e-3 / np.sqrt(2) * self.rng.standard_normal((N, 2))
        return PLANE.forward(*true.T, "metrology") + noise_mm

    def field(self):
        return self.rng.uniform([10.0, 20.0], [350.0, 160.0], (N, 2))

    def moves(self, start_deg, goal_deg):
        """Kind and commanded angles: the begin, a blind move, two corrections."""
        yield START, start_deg
        at = goal_deg
        for name, way_deg in (("blind", 0.0), ("correction 1", 0.04), ("correction 2", 0.004)):
            at = at + self.rng.normal(0.0, way_deg, (N, 2))
            yield name, at


def record(run, days, moves):
    """Rows of one move after the other, as they come; yields after each, so that runs may overlap."""
    before = None
    for number, (kind, at_deg) in enumerate(moves):
        if before is not None:
            way = at_deg - before
            days.off_deg += np.where(days.stuck[:, None], -way, (days.share - 1.0) * way)
        before = at_deg
        xy = days.seen_mm(at_deg)
        xy[ILL] += 1e-3 * days.map_um * (kind == "correction 2")
        columns = {
            "positioner_id": PLANE.positioner_id,
            "x_mm": xy[:, 0],
            "y_mm": xy[:, 1],
            "seen": np.ones(N, dtype=bool),
            "alpha_deg": at_deg[:, 0],
            "beta_deg": at_deg[:, 1],
            "wire_alpha_deg": at_deg[:, 0],
            "wire_beta_deg": at_deg[:, 1],
            "error_um": np.zeros(N),
            "status": np.array(["on_target"] * N, dtype=object),
        }
        run.record_move(number, kind, columns)
        yield


def begin(store, start_deg, goal_deg, days):
    run = store.start_run(command_line="", instrument="sdssv", config_hash="", seed=0)
    return run.id, record(run, days, days.moves(start_deg, goal_deg))


def follow(store, ids):
    monitor = HealthMonitor(PLANE)
    for run_id in ids:
        for passage in passages(store, run_id, PLANE):
            monitor.update(passage)
    return monitor


def in_turn(store, days, starts, goals):
    ids = []
    for start_deg, goal_deg in zip(starts, goals, strict=True):
        run_id, steps = begin(store, start_deg, goal_deg, days)
        list(steps)
        ids.append(run_id)
    return follow(store, ids)


@pytest.fixture
def store(tmp_path):
    with Store.open(tmp_path / "store.sqlite") as opened:
        yield opened


def assert_healthy(monitor):
    assert monitor.findings() == []
    assert set(monitor.states()) == {State.HEALTHY}


@pytest.mark.parametrize("runs", [2, 8])
def test_the_same_field_again_from_the_folded_place(store, runs):
    days = Days()
    goal = days.field()
    monitor = in_turn(store, days, [PARKED] * runs, [goal] * runs)
    assert_healthy(monitor)
    assert monitor.moves == 3 * runs  # where a run begins is no move


def test_other_fields_from_the_folded_place(store):
    days = Days()
    assert_healthy(in_turn(store, days, [PARKED] * 20, [days.field() for _ in range(20)]))


def test_other_fields_each_from_where_the_last_one_ended(store):
    days = Days()
    goals = [days.field() for _ in range(20)]
    assert_healthy(in_turn(store, days, [PARKED, *goals[:-1]], goals))


def test_somebody_else_moved_the_array_in_between(store):
    """Another store, a jog, a datum: the next run begins at places that this store knows nothing of."""
    days = Days()
    starts, goals = ([days.field() for _ in range(20)] for _ in range(2))
    for start_deg in starts[::2]:
        start_deg[:, 1] = days.rng.uniform(168.0, 176.0, N)  # folded, where a fibre does not tell angles
    goals[1::2] = goals[::2]
    assert_healthy(in_turn(store, days, starts, goals))


def test_two_runs_that_overlap(store):
    days = Days()
    goal = days.field()
    first, second = (begin(store, PARKED, goal, days) for _ in range(2))
    for _ in zip(first[1], second[1], strict=True):
        pass
    assert_healthy(follow(store, [first[0], second[0]]))


def test_a_place_at_which_a_map_errs_is_no_scatter_however_often_it_is_visited(store):
    days = Days()
    days.map_um = 15.0
    goal = days.field()
    assert_healthy(in_turn(store, days, [PARKED] * 12, [goal] * 12))


# what it must still find, run by run from the folded place


def test_one_that_stands_still_run_after_run_is_stuck(store):
    days = Days()
    days.stuck[ILL] = True
    goals = [days.field() for _ in range(4)]
    ids = []
    for goal in goals:
        days.off_deg[:] = 0.0  # the host takes it for where it is seen
        start = PARKED.copy()
        run_id, steps = begin(store, start, goal, days)
        list(steps)
        ids.append(run_id)
    (finding,) = follow(store, ids).findings()
    assert (finding.ailment, finding.state) == (Ailment.STUCK, State.DISABLED)
    assert finding.positioner_id == PLANE.positioner_id[ILL]


def test_a_wrong_share_of_the_way_is_found_from_folded_starts(store):
    days = Days()
    days.share[ILL, 0] = 0.9
    ids = []
    for _ in range(12):
        days.off_deg[:] = 0.0
        run_id, steps = begin(store, PARKED, days.field(), days)
        list(steps)
        ids.append(run_id)
    (finding,) = follow(store, ids).findings()
    assert (finding.ailment, finding.axis) == (Ailment.SCALE, "alpha")


def test_a_slip_is_still_told_in_degrees_after_the_next_begin(store):
    days = Days()
    goals = [days.field() for _ in range(8)]
    ids = []
    for k, goal in enumerate(goals):
        if k == 3:
            days.off_deg[ILL, 0] += 0.9  # and stays
        run_id, steps = begin(store, goals[k - 1] if k else PARKED, goal, days)
        list(steps)
        ids.append(run_id)
    (finding,) = follow(store, ids).findings()
    assert (finding.ailment, finding.axis) == (Ailment.SLIPPED, "alpha")
    told_deg = float(finding.evidence.split()[1])
    assert told_deg == pytest.approx(0.9, abs=0.2)  # the rest is in the fit of the offsets
