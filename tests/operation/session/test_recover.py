"""After a collision: the array is locked, `recover` says what touches and takes it apart."""

import numpy as np
import pytest
from arrays import BUS, TwinArray, done, layout, session

from fiberloom.errors import InputError
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook

PLANE = layout(7)
TANGLED_DEG = np.where(np.arange(7)[:, None] == 0, [60.0, 90.0], PLANE.park_deg)
"""One arm 0.75 mm nearer to a neighbour than the collision buffer."""


@pytest.fixture
def store(tmp_path):
    with Store.open(tmp_path / "arrays.sqlite") as store:
        ArrayBook(store, BUS).note_stopped("collision of positioners 205, 228", "locked")
        yield store


def off_park_mm(array):
    return np.hypot(*(array.twin.fibre_xy("metrology") - PLANE.forward(*PLANE.park_deg.T)).T)


def test_a_locked_array_only_recovers(store):
    array = TwinArray.of(PLANE, TANGLED_DEG)
    for command in ("park", "home"):
        with pytest.raises(
            InputError, match=r"is locked .collision of positioners 205, 228.: .*fiberloom recover"
        ):
            done(getattr(session(array, PLANE, store), command)())
    assert ArrayBook(store, BUS).state().state == "locked"


def test_arms_are_taken_apart_and_folded(store):
    array = TwinArray.of(PLANE, TANGLED_DEG)
    looked = done(session(array, PLANE, store).recover(look_only=True))
    assert looked.touching
    assert looked.stages
    assert (looked.state, array.twin.time_s < 20.0) == ("locked", True)
    assert off_park_mm(array)[0] > 1.0  # nothing has moved
    report = done(session(array, PLANE, store).recover())
    assert report.touching == looked.touching
    assert str(PLANE.positioner_id[0]) in report.touching[0]
    assert (report.state, report.ok) == ("parked", True)
    assert off_park_mm(array).max() < 0.3
    assert [e for e in store.events(store.runs()[-1].id)["kind"] if e == "touching"]
    assert done(session(array, PLANE, store).park()).state == "parked"


def test_nothing_to_recover_from_unlocks(store):
    report = done(session(TwinArray.of(PLANE), PLANE, store).recover())
    assert (report.touching, report.state) == ([], "parked")
    with pytest.raises(
        InputError, match="is parked: recover is not possible now; nothing is to be recovered"
    ):
        done(session(TwinArray.of(PLANE), PLANE, store).recover())
