"""Commands to an array on the virtual twin: park, home, exclusions, what one session leaves to the next."""

import asyncio

import numpy as np
import pytest
from arrays import BUS, TwinArray, done, layout, session

from fiberloom.bus.client import Client
from fiberloom.errors import InputError, StoppedError
from fiberloom.operation.move import Goals
from fiberloom.operation.session import home
from fiberloom.operation.session.states import Deed
from fiberloom.planning import random_configuration
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.faults.kinds import FaultKind

PLANE = layout(19)


@pytest.fixture
def store(tmp_path):
    with Store.open(tmp_path / "arrays.sqlite") as store:
        yield store


@pytest.fixture
def array():
    return TwinArray.of(PLANE, random_configuration(PLANE, 1))


def off_park_mm(array, plane=PLANE):
    """(N,) how far the fibres truly are from where they are when parked."""
    return np.hypot(*(array.twin.fibre_xy("metrology") - plane.forward(*plane.park_deg.T)).T)


def test_park_folds_all_and_says_so(array, store):
    report = done(session(array, PLANE, store).park())
    assert (report.state, report.ok, len(report.folded)) == ("parked", True, len(PLANE))
    assert off_park_mm(array).max() < 0.3
    assert array.twin.touches() == []
    book = ArrayBook(store, BUS)
    assert (book.state().state, book.state().owned) == ("parked", False)
    places = book.places(PLANE.positioner_id)
    assert places.how == ["right"] * len(PLANE)
    assert not places.datum.any()
    np.testing.assert_allclose(places.angles_deg, PLANE.park_deg, atol=0.1)
    assert [run.status for run in store.runs()] == ["finished"]


def test_home_finds_every_datum_without_a_touch(array, store):
    report = done(session(array, PLANE, store).home())
    assert report.left_out == {}
    assert sorted(report.datum_found) == sorted(PLANE.positioner_id.tolist())
    assert report.state == "parked"
    assert array.twin.touches() == []
    assert ArrayBook(store, BUS).places(PLANE.positioner_id).datum.all()
    # the counters are right after it, to the turn: an observation goes on as before
    assert off_park_mm(array).max() < 0.05


def test_a_search_of_beta_begins_near_its_stop(array, store, monkeypatch):
    """A search is slow: a plan makes most of the way."""
    search, begun = Client.home, []

    async def spied(client, ids, axis=None):
        begun.append((axis, array.twin.truth()[PLANE.index_of(ids)], client.time_s))
        return await search(client, ids, axis)

    monkeypatch.setattr(Client, "home", spied)
    assert done(session(array, PLANE, store).home()).left_out == {}
    beta_deg = np.concatenate([truth_deg[:, 1] for axis, truth_deg, _ in begun if axis == "beta"])
    assert len(beta_deg) == len(PLANE)
    near_deg = PLANE.hard_stops_deg[1, 0] + home.NEAR_DEG
    np.testing.assert_allclose(beta_deg, near_deg, atol=1.0)
    # a search of all the way takes 100 s alone
    rounds = [time_s for axis, _, time_s in begun if axis == "beta"]
    assert np.diff(rounds).max() < 80.0


def test_one_that_does_not_come_near_its_stop_is_not_searched(array, store, monkeypatch):
    """It stands in the way where it is; who would meet it there waits, or is left out."""
    approach, search, stuck, searched = home.Homing._approach, Client.home, [], []

    async def spied(client, ids, axis=None):
        searched.append((axis, set(ids)))
        return await search(client, ids, axis)

    async def without_one(homing, made, rows):
        if not stuck:
            stuck.append(rows[0])
            array.twin.inject(Fault(FaultKind.DEAD, int(PLANE.positioner_id[rows[0]])))
        return await approach(homing, made, rows)

    monkeypatch.setattr(home.Homing, "_approach", without_one)
    monkeypatch.setattr(Client, "home", spied)
    report = done(session(array, PLANE, store).home())
    number = int(PLANE.positioner_id[stuck[0]])
    assert not any(number in ids for axis, ids in searched if axis != "alpha")
    assert report.left_out[number].startswith("dead: after a move")
    assert len(report.datum_found) > len(PLANE) / 2
    assert array.twin.touches() == []


def test_one_without_a_plan_to_its_stop_searches_all_of_its_way(array, store, monkeypatch):
    clear, search, begun = home.Homing._clear, Client.home, []

    async def not_near(homing, made):
        if (made.goals_deg[:, 1] > home.NEAR_DEG).all():
            await clear(homing, made)

    async def spied(client, ids, axis=None):
        begun.append((axis, array.twin.truth()[PLANE.index_of(ids), 1]))
        return await search(client, ids, axis)

    monkeypatch.setattr(home.Homing, "_clear", not_near)
    monkeypatch.setattr(Client, "home", spied)
    report = done(session(array, PLANE, store).home())
    assert sorted(report.datum_found) == sorted(PLANE.positioner_id.tolist())
    assert min(beta_deg.min() for axis, beta_deg in begun if axis == "beta") > 160.0
    assert array.twin.touches() == []


def test_a_datum_on_record_vouches_for_a_dark_fibre(array, store):
    array.dark = [3]
    report = done(session(array, PLANE, store).park())
    # dark, and nothing else says where it is: an obstacle of its whole reach, which its neighbours feel
    assert report.left_out[PLANE.positioner_id[3]] == "dark"
    assert {report.left_out[p] for p in set(report.left_out) - {PLANE.positioner_id[3]}} <= {"blocked"}
    array.dark = []
    done(session(array, PLANE, store).home())
    array.dark = [3]
    assert done(session(array, PLANE, store).park()).left_out == {}
    # moved by another program since: nothing vouches for it any more
    array.twin.power_cycle(int(PLANE.positioner_id[3]))
    report = done(session(array, PLANE, store).park())
    assert not ArrayBook(store, BUS).places(PLANE.positioner_id[[3]]).datum[0]


def test_what_is_excluded_stays_where_it_is(array, store):
    book, before_mm = ArrayBook(store, BUS), array.twin.fibre_xy("metrology")
    excluded = PLANE.positioner_id[[2, 7]].tolist()
    book.exclude(excluded[:1], "ann", "beta slips")
    report = done(session(array, PLANE, store, exclude=excluded[1:]).park())
    moved_mm = np.hypot(*(array.twin.fibre_xy("metrology") - before_mm).T)
    assert moved_mm[[2, 7]].max() < 1e-3
    assert np.median(moved_mm) > 1.0
    assert not set(excluded) & set(report.folded)
    assert array.twin.touches() == []
    with pytest.raises(InputError, match="--exclude 99999: no such positioner"):
        session(array, PLANE, store, exclude=[99999])


def test_an_excluded_one_is_an_obstacle_where_it_is_seen_not_where_the_record_has_it(array, store):
    book = ArrayBook(store, BUS)
    done(session(array, PLANE, store).park())
    moved = TwinArray.of(PLANE, np.where(np.arange(19)[:, None] == 9, [40.0, 60.0], PLANE.park_deg))
    book.exclude([int(PLANE.positioner_id[9])], "ann", "pushed by hand")
    made = session(moved, PLANE, store)

    async def scenario():
        async with made._moving(Deed.PARK) as motion:
            return motion.state.here_deg[9], motion.state.mobile[9]

    here_deg, mobile = done(scenario())
    np.testing.assert_allclose(here_deg, [40.0, 60.0], atol=1.5)
    assert not mobile


def test_the_bus_is_asked_once_who_is_there_and_where(array, store, monkeypatch):
    asked = []
    for name in ("discover", "positions_deg"):

        def counted(client, *args, name=name, call=getattr(Client, name)):
            asked.append(name)
            return call(client, *args)

        monkeypatch.setattr(Client, name, counted)
    made = session(array, PLANE, store)

    async def begins():
        async with made._moving(Deed.PARK):
            pass

    done(begins())
    assert asked == ["discover", "positions_deg"]


def test_the_datum_of_an_excluded_one_stays_on_record_while_it_has_not_moved(array, store):
    book, left = ArrayBook(store, BUS), PLANE.positioner_id[[2]]
    done(session(array, PLANE, store).home())
    done(session(array, PLANE, store, exclude=left.tolist()).park())
    assert book.places(left).datum.tolist() == [True]


def test_one_motion_at_a_time(array, store):
    first, second = session(array, PLANE, store, "fiberloom park"), session(array, PLANE, store, "other")

    async def both():
        async with first.owning(Deed.PARK):
            with pytest.raises(InputError, match=r"is connecting .in use by `fiberloom park`"):
                async with second.owning(Deed.HOME):
                    pass

    done(both())


class SlowArray(TwinArray):
    """The same twin at the pace of a clock, so that another process can interfere; `asks` does."""

    asks = None

    async def open(self):
        hardware = await super().open()
        receive = hardware.transport.receive

        async def slowly(timeout_s):
            self.asks()
            await asyncio.sleep(0.05)
            return await receive(timeout_s)

        hardware.transport.receive = slowly
        return hardware


def test_another_process_stops_a_session_in_motion(array, store):
    slow, said, asked = SlowArray(array.twin), [], []
    made = session(slow, PLANE, store, progress=said.append)

    def asks():
        if not asked and made.known.book.state().state == "moving":
            asked.append(made.known.book.ask_stop("bob on far"))

    slow.asks = asks
    with pytest.raises(StoppedError, match="stopped by bob on far"):
        done(made.park())
    assert asked == [True]
    state = made.known.book.state()
    assert (state.state, state.owned) == ("stopped", False)
    assert any("positioners at rest after" in text for text in said)
    assert store.runs()[-1].status == "interrupted"
    still_mm = array.twin.fibre_xy("metrology")
    array.twin.run(1.0)
    assert np.abs(array.twin.fibre_xy("metrology") - still_mm).max() < 1e-3
    assert off_park_mm(array).max() > 1.0  # it was on the way
    assert done(session(array, PLANE, store).park()).state == "parked"
    assert array.twin.touches() == []


def test_an_error_leaves_the_array_unknown(array, store):
    made = session(array, PLANE, store)

    async def fails():
        async with made._moving(Deed.PARK) as motion:
            await motion.go(Goals.without_targets(PLANE, PLANE.park_deg))
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        done(fails())
    state = ArrayBook(store, BUS).state()
    assert (state.state, state.text) == ("unknown", "stopped after an error: disk full")
    assert done(session(array, PLANE, store).park()).state == "parked"
