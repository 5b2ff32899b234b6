"""Steps of a datum search by themselves: turns by the image, and clearing the way."""

import asyncio
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fiberloom.bus.outcome import Outcome, Result, Results
from fiberloom.bus.protocol import Status
from fiberloom.instruments import generate, load_instrument
from fiberloom.instruments.model import Care
from fiberloom.operation.session.clearing import Clearing, Round
from fiberloom.operation.session.home import Homing, _turns_off

PLANE = generate(load_instrument("sdssv"), 0, n_positioners=7)
ROWS = np.arange(7)
TURN_DEG = np.array([360.0 / a.gear for a in PLANE.instrument.axes])
HERE = np.column_stack([np.linspace(10.0, 300.0, 7), np.full(7, 90.0)])


def off_by(turns, axis):
    """What is said of positioners that are truly so many motor turns from where they report."""
    true_deg = HERE + np.array(turns) * TURN_DEG
    return _turns_off(PLANE, ROWS, HERE, PLANE.forward(*true_deg.T), axis)


@pytest.mark.parametrize(
    ("axis", "turns"),
    [("alpha", (k, 0)) for k in (-3, -1, 1, 3)]
    + [("beta", (0, k)) for k in (-3, -1, 1, 3)]
    + [("both", (a, b)) for a in (-1, 0, 1) for b in (-1, 0, 1)],
)
def test_turns_that_the_image_shows_are_told(axis, turns):
    np.testing.assert_array_equal(off_by(turns, axis), np.tile(turns, (7, 1)))


@pytest.mark.parametrize(
    ("axis", "turns"),
    [("alpha", (0, 2)), ("beta", (2, 0)), ("alpha", (4, 0)), ("beta", (0, -4)), ("both", (2, 0)),
     ("both", (-2, 0)), ("both", (0, 2)), ("both", (0, -2))],
)  # fmt: skip
def test_turns_that_are_not_tried_are_not_declared(axis, turns):
    """Of one axis three, of the other none; of both at once one: more would look alike."""
    assert not off_by(turns, axis).any()


def test_what_fits_as_it_is_stays():
    seen_mm = PLANE.forward(*HERE.T) + 0.015
    assert not _turns_off(PLANE, ROWS, HERE, seen_mm, "both").any()
    assert not _turns_off(PLANE, ROWS, HERE, np.full((7, 2), np.nan), "both").any()


@pytest.mark.parametrize(("way_deg", "moves"), [(0.0, False), (0.01, True), (0.9, True), (30.0, True)])
def test_the_others_are_brought_exactly_out_of_the_way(way_deg, moves):
    """A place that is clear by the margin only is not clear a little beside it."""
    gone = []

    async def go(goals):
        gone.append(goals.angles_deg)

    state = SimpleNamespace(here_deg=HERE, mobile=np.ones(7, dtype=bool))
    homing = Homing(SimpleNamespace(plane=PLANE, state=state, go=go), ROWS[:0])
    goals_deg = HERE + np.where(ROWS[:, None] == 3, [way_deg, 0.0], 0.0)
    asyncio.run(homing._clear(Round([0], goals_deg, {})))
    assert len(gone) == moves
    for there_deg in gone:
        np.testing.assert_array_equal(there_deg, goals_deg)


def test_one_that_cannot_move_is_not_told_to():
    async def go(goals):
        raise AssertionError("moved")

    state = SimpleNamespace(here_deg=HERE, mobile=ROWS != 3)
    homing = Homing(SimpleNamespace(plane=PLANE, state=state, go=go), ROWS[:0])
    goals_deg = HERE + np.where(ROWS[:, None] == 3, 5.0, 0.0)
    asyncio.run(homing._clear(Round([0], goals_deg, {})))


def test_searchers_of_beta_wait_folded_at_the_side_to_which_they_sweep():
    plane = generate(load_instrument("sdssv"), 0, n_positioners=19)
    nowhere = np.zeros(19, dtype=bool)
    clearing = Clearing(plane, plane.park_deg, ~nowhere, nowhere)
    found = clearing.beta_round(list(range(19)))
    assert len(found.searchers) >= 2
    for row in found.searchers:
        alpha_deg, beta_deg = found.goals_deg[row]
        assert beta_deg == plane.park_deg[row, 1]
        wanted = clearing.of_beta(row, alpha_deg)
        np.testing.assert_allclose(found.sweeps[row].segments_mm, wanted.segments_mm, atol=1e-12)
        assert not clearing.in_the_way(row, wanted, found.goals_deg, found.sweeps)


def test_one_that_makes_room_keeps_off_what_may_be_anywhere():
    """Beside a positioner whose place is not known: its whole reach is a disc that arms keep out of."""
    plane = generate(load_instrument("sdssv"), 0, n_positioners=19)
    lost = np.arange(19) == int(np.argmax(plane.centres_mm[:, 0]))
    clearing = Clearing(plane, plane.park_deg, ~lost, lost)
    row = int(np.argsort(np.hypot(*(plane.centres_mm - plane.centres_mm[lost][0]).T))[1])
    place_deg = clearing._elsewhere(row, plane.park_deg, {})
    (arm,) = clearing.arms_mm(np.array([row]), place_deg[None])
    along = arm[:2] + np.linspace(0.0, 1.0, 400)[:, None] * (arm[2:] - arm[:2])
    gap_mm = np.hypot(*(along - plane.centres_mm[lost][0]).T).min() - plane.body_reach_mm[lost][0]
    assert gap_mm > plane.collision_buffer_mm


class Bus:
    """Answers as told; keeps the positions that are declared."""

    def __init__(self, begun=(), ended=(), bits=0):
        self.begun, self.ended, self.bits, self.declared = begun, ended, bits, []
        self.searched, self.asked = [], 0

    async def home(self, ids, axis):
        self.searched.append(list(ids))
        return results(ids, self.begun)

    async def wait_until_done(self, ids, limit_s):
        return results(ids, self.ended)

    async def status(self, ids):
        self.asked += 1
        return Results({i: Result(i, Outcome.DONE, values=(self.bits.get(i, 0),)) for i in ids})

    async def set_position(self, ids, alpha_deg, beta_deg):
        self.declared.append((ids, alpha_deg, beta_deg))


def results(ids, failing):
    return Results({i: Result(i, Outcome.TIMED_OUT if i in failing else Outcome.DONE) for i in ids})


def homing_by(client, plane=PLANE):
    """A homing on a bus that answers as told, and what it books."""

    async def step(wanted):
        """Every step is legal."""

    homing, booked = Homing(SimpleNamespace(plane=plane, client=client, step=step), ROWS), []

    async def book(done, axis):
        booked.append((done, axis))

    homing._book = book
    return homing, booked


BOTH = Status.DATUMS_INITIALIZED


def test_a_search_that_failed_is_none_even_where_an_older_datum_is_set():
    ids = [int(p) for p in PLANE.positioner_id[:4]]
    # the first does not begin, the second does not end, the third ends without a datum
    client = Bus(begun=ids[:1], ended=ids[1:2], bits={ids[0]: BOTH, ids[1]: BOTH, ids[3]: BOTH})
    homing, booked = homing_by(client)
    assert asyncio.run(homing._search([0, 1, 2, 3], "both")) == [0, 1, 2, 3]
    assert booked == [([ids[3]], "both")]
    assert set(homing.left_out) == set(ids[:3])
    assert client.asked == 1  # all of them at once


def supplied(most):
    """The plane with a supply for so many positioners at once."""
    care = {"motor_friction_A": [0.1, 0.1], "motor_speed_A": [0.1, 0.1], "supply_A": 0.4 * most + 0.1}
    instrument = PLANE.instrument.model_copy(update={"care": Care.model_validate(care)})
    return replace(PLANE, instrument=instrument)


def test_so_many_search_at_once_as_the_supply_can_feed():
    ids = [int(p) for p in PLANE.positioner_id]
    client = Bus(bits=dict.fromkeys(ids, BOTH))
    homing, booked = homing_by(client, supplied(3))
    assert asyncio.run(homing._search(list(range(7)), "beta")) == list(range(7))
    assert client.searched == [ids[:3], ids[3:6], ids[6:]]
    assert booked == [(ids, "beta")]


def test_after_a_search_that_did_not_end_no_other_group_begins():
    ids = [int(p) for p in PLANE.positioner_id]
    client = Bus(bits=dict.fromkeys(ids, BOTH), ended=ids[4:5])
    homing, booked = homing_by(client, supplied(3))
    assert asyncio.run(homing._search(list(range(7)), "beta")) == list(range(6))
    assert client.searched == [ids[:3], ids[3:6]]
    assert booked == [([*ids[:4], ids[5]], "beta")]
    assert set(homing.left_out) == {ids[4]}  # the last one waits for the next round


def counting(here_deg, *seen_mm):
    """A homing whose images show these places (7, 2) one after another; what it declares, what it tells."""
    images = [SimpleNamespace(xy_mm=xy) for xy in seen_mm]
    moves = [SimpleNamespace(measurement=image) for image in images]
    client, told = Bus(), []
    state = SimpleNamespace(here_deg=here_deg, wire_deg=here_deg + 0.01)
    recorder = SimpleNamespace(event=lambda *what: told.append(what))
    motion = SimpleNamespace(
        plane=PLANE, client=client, state=state, moves=moves, image=images[0], recorder=recorder
    )
    homing = Homing(motion, ROWS)

    async def folded():
        pass

    homing._fold = folded
    return homing, client.declared, told


def count(homing):
    asyncio.run(homing._count_turns([int(p) for p in PLANE.positioner_id], "alpha"))


def test_turns_are_counted_in_the_last_image():
    """The image before was taken elsewhere: by it all would be right."""
    right_mm = PLANE.forward(*HERE.T)
    off_mm = PLANE.forward(*(HERE + np.where(ROWS[:, None] == 2, [TURN_DEG[0], 0.0], 0.0)).T)
    homing, declared, told = counting(HERE, right_mm, off_mm)
    count(homing)
    ((ids, alpha_deg, beta_deg),) = declared
    assert ids == [int(PLANE.positioner_id[2])]
    np.testing.assert_allclose([alpha_deg[0], beta_deg[0]], HERE[2] + 0.01 + [TURN_DEG[0], 0.0])
    assert len(told) == 1


def test_what_the_maps_err_by_does_not_hide_a_turn():
    """Folded, a turn of alpha is 45 um; maps that err by 20 um leave 25 um of it, as if it were right."""
    folded_deg = np.array(PLANE.park_deg)
    right_mm = PLANE.forward(*folded_deg.T)
    turned_mm = PLANE.forward(*(folded_deg + TURN_DEG * [1, 0]).T)
    error_mm = -0.020 * (turned_mm - right_mm) / np.hypot(*(turned_mm - right_mm).T)[:, None]
    homing, declared, _ = counting(folded_deg, right_mm + error_mm, turned_mm + error_mm)
    count(homing)
    assert declared[-1][0] == []  # by the one image alone it is not seen
    homing._learn_misses()
    count(homing)
    ids, alpha_deg, _ = declared[-1]
    assert ids == [int(p) for p in PLANE.positioner_id]
    np.testing.assert_allclose(alpha_deg, folded_deg[:, 0] + 0.01 + TURN_DEG[0])
