"""The datum search of a positioner that is nowhere seen and has no datum: only with its whole reach free."""

import numpy as np
import pytest
from arrays import BUS, TwinArray, done, layout, session

from fiberloom.bus.client import Client
from fiberloom.operation.session import home
from fiberloom.operation.session.clearing import Clearing, within_reach
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.twin.transport import TwinTransport

PLANE = layout(19)
ROW = 7
LOST = int(PLANE.positioner_id[ROW])


@pytest.fixture
def store(tmp_path):
    with Store.open(tmp_path / "arrays.sqlite") as store:
        yield store


def away():
    """Places (19, 2) at which all others are out of the reach of one."""
    others = np.arange(19) != ROW
    clearing = Clearing(PLANE, PLANE.park_deg, others, np.zeros(19, dtype=bool))
    found = clearing.whole_round([ROW])
    assert found.searchers == [ROW]
    assert not within_reach(PLANE, found.goals_deg, ROW).any()
    return found.goals_deg


def dark_and_lying(true_deg, off_deg):
    """An array in which one is dark and believes to be elsewhere."""
    array = TwinArray.of(PLANE, true_deg)
    array.dark = [ROW]
    client = Client(TwinTransport(array.twin))

    async def tell():
        wire_deg, _ = await client.positions_deg([LOST])
        assert (await client.set_position([LOST], *(wire_deg + off_deg).T)).ok.all()

    done(tell())
    return array


def off_park_mm(array):
    return np.hypot(*(array.twin.fibre_xy("metrology") - PLANE.forward(*PLANE.park_deg.T)).T)


@pytest.mark.parametrize(
    ("place_deg", "off_deg"),
    [((200.0, 40.0), (40.0, 0.0)), ((20.0, 5.0), (100.0, 20.0)), ((300.0, 120.0), (-60.0, -60.0))],
)
def test_with_its_reach_free_it_searches_and_is_one_like_any_other(store, place_deg, off_deg):
    there = away()
    there[ROW] = place_deg
    array = dark_and_lying(there, off_deg)
    report = done(session(array, PLANE, store).home([LOST]))
    assert array.twin.touches() == []
    assert report.datum_found == [LOST]
    assert ArrayBook(store, BUS).places(np.array([LOST])).datum[0]
    # the stop says the angle of the motor, not always its turn: 0.35 deg
    assert off_park_mm(array).max() < 0.3
    array.dark = []
    assert done(session(array, PLANE, store).park()).ok


def test_with_others_in_its_reach_it_is_refused_by_their_numbers_and_stays(store):
    there = PLANE.park_deg.copy()
    there[ROW] = (200.0, 120.0)
    array = dark_and_lying(there, (40.0, 30.0))
    report = done(session(array, PLANE, store).home())
    assert array.twin.touches() == []
    near = PLANE.positioner_id[within_reach(PLANE, PLANE.park_deg, ROW)]
    assert len(near) >= 4
    assert all(str(p) in report.left_out[LOST] for p in near)
    assert "bring light, or exclude it" in report.left_out[LOST]
    np.testing.assert_allclose(array.twin.truth()[ROW], there[ROW], atol=0.1)
    # those out of its reach were searched
    assert report.datum_found


def test_without_the_rule_it_sweeps_into_its_neighbours(store, monkeypatch):
    """What the rule is for."""
    monkeypatch.setattr(home, "within_reach", lambda plane, here_deg, row: np.zeros(len(plane), dtype=bool))
    monkeypatch.setattr(home.Homing, "_ready", lambda homing, made, axis: made.searchers)
    there = PLANE.park_deg.copy()
    there[ROW] = (200.0, 120.0)
    array = dark_and_lying(there, (40.0, 30.0))
    done(session(array, PLANE, store).home([LOST]))
    assert array.twin.touches()
