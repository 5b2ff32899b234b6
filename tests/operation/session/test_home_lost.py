"""The datum search of a positioner that is not seen: where its count is known, or its whole reach free."""

from dataclasses import replace

import numpy as np
import pytest
from arrays import BUS, TwinArray, done, layout, session

from fiberloom.bus.client import Client
from fiberloom.operation.session import home
from fiberloom.operation.session.clearing import Clearing, within_reach
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.faults.kinds import FaultKind
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
    assert "light its fibre, exclude it, or search it on the bench" in report.left_out[LOST]
    np.testing.assert_allclose(array.twin.truth()[ROW], there[ROW], atol=0.1)
    # those out of its reach were searched
    assert report.datum_found


def test_without_the_rule_it_sweeps_into_its_neighbours(store, monkeypatch):
    """What the rule is for."""
    monkeypatch.setattr(home, "within_reach", lambda plane, *how: np.zeros(len(plane), dtype=bool))
    monkeypatch.setattr(home.Homing, "_ready", lambda homing, made, axis: made.searchers)
    there = PLANE.park_deg.copy()
    there[ROW] = (200.0, 120.0)
    array = dark_and_lying(there, (40.0, 30.0))
    done(session(array, PLANE, store).home([LOST]))
    assert array.twin.touches()


def apart(plane, factor):
    """The same positioners farther apart."""
    arms, fiducials = plane.arms.copy(), plane.fiducials.copy()
    arms[:, :2] *= factor
    fiducials[:, :2] *= factor
    return replace(plane, arms=arms, fiducials=fiducials, guide_cameras=plane.guide_cameras[:0])


def test_among_folded_neighbours_that_its_reach_does_not_meet_it_searches(store):
    """Proven by the discs: whatever its angles are, it cannot be where they are, folded as they are."""
    plane = apart(layout(7), 1.6)
    there = plane.park_deg.copy()
    there[0] = (200.0, 120.0)
    array = TwinArray.of(plane, there)
    array.dark = [0]
    lost = int(plane.positioner_id[0])
    client = Client(TwinTransport(array.twin))

    async def tell():
        wire_deg, _ = await client.positions_deg([lost])
        assert (await client.set_position([lost], *np.add(wire_deg, [40.0, 30.0]).T)).ok.all()

    done(tell())
    report = done(session(array, plane, store).home([lost]))
    assert array.twin.touches() == []
    assert (report.datum_found, report.left_out) == ([lost], {})


@pytest.mark.parametrize(("factor", "within"), [(1.0, True), (1.45, True), (1.6, False)])
def test_a_folded_arm_of_which_alpha_is_not_known_counts_as_the_disc_that_it_sweeps(factor, within):
    plane = apart(layout(7), factor)
    # every elbow points away from the first: as they are, they are clear sooner
    away_deg = np.rad2deg(np.arctan2(*(plane.centres_mm - plane.centres_mm[0])[:, ::-1].T))
    here_deg = np.column_stack([np.mod(away_deg, 360.0), np.full(7, 175.0)])
    every = np.ones(7, dtype=bool)
    assert within_reach(plane, here_deg, 0, every)[1:].any() == within
    assert within_reach(plane, here_deg, 0)[1:].sum() <= within_reach(plane, here_deg, 0, every)[1:].sum()


def test_one_that_was_seen_at_this_count_is_known_though_it_is_dark_now(store):
    """Among folded neighbours, where a search of one that may be anywhere is refused."""
    array = TwinArray.of(PLANE)
    done(session(array, PLANE, store).park())
    assert ArrayBook(store, BUS).places(np.array([LOST])).how == ["right"]
    array.dark = [ROW]
    report = done(session(array, PLANE, store).home([LOST]))
    assert array.twin.touches() == []
    assert (report.datum_found, report.left_out) == ([LOST], {})


def declared(array):
    """Its count was set to another place, by another program."""
    client = Client(TwinTransport(array.twin))

    async def tell():
        wire_deg, _ = await client.positions_deg([LOST])
        assert (await client.set_position([LOST], *np.add(wire_deg, [40.0, 0.0]).T)).ok.all()

    done(tell())


@pytest.mark.parametrize("since", [declared, lambda array: array.twin.power_cycle(LOST)])
def test_where_its_count_or_its_power_has_changed_since_it_is_not_known(store, since):
    array = TwinArray.of(PLANE)
    done(session(array, PLANE, store).park())
    array.dark = [ROW]
    since(array)
    array.twin.run(1.0)
    before_deg = array.twin.truth()
    report = done(session(array, PLANE, store).home([LOST]))
    assert array.twin.touches() == []
    assert report.datum_found == []
    assert "where it is cannot be seen" in report.left_out[LOST]
    np.testing.assert_allclose(array.twin.truth()[ROW], before_deg[ROW], atol=0.1)
    # what was seen once does not come back with its count
    assert ArrayBook(store, BUS).places(np.array([LOST])).how != ["right"]


def test_one_that_lies_is_seen_but_not_right(store):
    """Seen at the same count before: at another place than it reports, which is no proof."""
    there = PLANE.park_deg.copy()
    there[ROW] = (200.0, 120.0)
    array = dark_and_lying(there, (40.0, 0.0))
    array.dark = []
    done(session(array, PLANE, store).park())
    assert ArrayBook(store, BUS).places(np.array([LOST])).how == ["seen"]
    array.dark = [ROW]
    report = done(session(array, PLANE, store).home([LOST]))
    assert array.twin.touches() == []
    assert report.datum_found == []


def test_those_that_are_excluded_or_silent_stay_though_they_are_named(store):
    """`home --only` of one that is excluded, of one that does not answer, and of one that is neither."""
    array, silent, other = TwinArray.of(PLANE), int(PLANE.positioner_id[3]), int(PLANE.positioner_id[12])
    for kind in (FaultKind.DEAF, FaultKind.MUTE):
        array.twin.inject(Fault(kind, silent))
    before_deg = array.twin.truth()
    report = done(session(array, PLANE, store, exclude=(LOST,)).home([LOST, silent, other]))
    assert array.twin.touches() == []
    assert report.left_out[LOST].endswith(": excluded, or switched off")
    assert report.left_out[silent] == "does not answer on the bus"
    assert report.datum_found == [other]
    stayed = [ROW, 3]
    np.testing.assert_allclose(array.twin.truth()[stayed], before_deg[stayed], atol=0.1)
