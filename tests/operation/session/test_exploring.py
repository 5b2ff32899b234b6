"""`recover` finds positioners that are not where they report, by small moves clear wherever they are."""

import numpy as np
import pytest
from arrays import TwinArray, done, layout, lying, off_park_mm, session

from fiberloom.operation.safety.explore import at_spot
from fiberloom.operation.session import exploring
from fiberloom.planning import random_configuration
from fiberloom.store import Store

PLANE = layout(19)
DEPLOYED = random_configuration(PLANE, 1)


@pytest.fixture
def store(tmp_path):
    with Store.open(tmp_path / "arrays.sqlite") as store:
        yield store


def deployed(lies, true_deg=DEPLOYED):
    return lying(TwinArray.of(PLANE, true_deg), PLANE, lies)


def events(store):
    rows = store.events(store.runs()[-1].id)
    return list(zip(rows["kind"], rows["positioner_id"], rows["text"], strict=True))


@pytest.mark.parametrize(
    "lies",
    [
        {4: (15.0, 0.0)},
        {4: (-40.0, 0.0)},
        {11: (60.0, 0.0)},
        {7: (0.0, 30.0)},
        {2: (40.0, 0.0), 13: (-25.0, 20.0)},
    ],
)
def test_those_that_lie_are_found_told_and_folded(store, lies):
    array = deployed(lies)
    report = done(session(array, PLANE, store).recover())
    assert array.twin.touches() == []
    ids = PLANE.positioner_id[list(lies)].tolist()
    assert sorted(report.found) == sorted(ids)
    assert (report.state, report.left_out) == ("parked", {})
    assert off_park_mm(array, PLANE).max() < 0.5
    told = [p for kind, p, _ in events(store) if kind == "found"]
    assert sorted(told) == sorted(ids)
    # from now on they are like any other
    assert done(session(array, PLANE, store).park()).ok


def mirrored(row, true_deg):
    """The other place at which the same fibre can be: the elbow on the other side."""
    (spot,) = PLANE.forward(*true_deg[:, None], index=[row])
    places = at_spot(PLANE, row, spot)
    return places[np.abs(places[:, 1] - true_deg[1]) > 5.0][0]


def test_an_elbow_on_the_other_side_is_found_by_how_the_fibre_moves(store):
    """Its fibre is where the begin check has it; its arm is not."""
    row, true_deg = 4, DEPLOYED.copy()
    true_deg[row] = mirrored(row, DEPLOYED[row])
    assert true_deg[row, 1] > 180.0
    array = deployed({row: DEPLOYED[row] - true_deg[row] + (30.0, 0.0)}, true_deg)
    array.twin.touches()
    report = done(session(array, PLANE, store).recover())
    assert array.twin.touches() == []
    (text,) = [t for kind, _, t in events(store) if kind == "found"]
    alpha_deg, beta_deg = (float(a) for a in text.split(" deg")[0].removeprefix("is at ").split(", "))
    # where it is after a small move of beta
    np.testing.assert_allclose(alpha_deg, true_deg[row, 0], atol=1.5)
    np.testing.assert_allclose(abs(beta_deg - true_deg[row, 1]), 6.0, atol=1.5)
    # no map holds there: it is not moved as others are
    number = int(PLANE.positioner_id[row])
    assert "where no map holds" in report.left_out[number]
    assert report.found == []
    np.testing.assert_allclose(array.twin.truth()[row, 1], beta_deg, atol=1.5)


def test_look_says_what_would_be_done_and_moves_nothing(store):
    array = deployed({4: (40.0, 0.0)})
    before_deg = array.twin.truth()
    report = done(session(array, PLANE, store).recover(look_only=True))
    np.testing.assert_allclose(array.twin.truth(), before_deg, atol=0.1)
    assert any(f"positioner {PLANE.positioner_id[4]} by " in stage for stage in report.stages)
    assert report.found == []


def test_a_dark_one_is_not_moved_and_named_with_what_to_do(store):
    array = deployed({4: (40.0, 0.0)})
    array.dark = [4]
    before_deg = array.twin.truth()
    report = done(session(array, PLANE, store).recover())
    assert array.twin.touches() == []
    np.testing.assert_allclose(array.twin.truth()[4], before_deg[4], atol=0.1)
    number = int(PLANE.positioner_id[4])
    assert f"`fiberloom home --only {number}`, or exclude it" in report.left_out[number]
    assert report.found == []


@pytest.mark.parametrize("proven", [True, False])
def test_a_way_into_a_neighbour_is_not_taken(store, monkeypatch, proven):
    """What the proof is for: the first of the small moves ends in a neighbour here."""
    if not proven:
        monkeypatch.setattr(exploring, "is_clear", lambda *how: True)
    beside_deg = np.where(np.arange(19)[:, None] == 6, [80.0, 95.0], PLANE.park_deg)
    array = deployed({6: (40.0, 0.0)}, beside_deg)
    report = done(session(array, PLANE, store).recover())
    assert bool(array.twin.touches()) != proven
    # the other ways are not clear with the elbow on the other side
    assert report.found == []
    if proven:
        assert (
            "no small move is proven clear for the 2 places" in report.left_out[int(PLANE.positioner_id[6])]
        )
