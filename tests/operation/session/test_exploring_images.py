"""`recover` by a camera whose spots have no names: one that lies is a spot that belongs to none."""

from dataclasses import replace

import numpy as np
import pytest
from arrays import TwinArray, done, layout, lying, off_park_mm, session

from fiberloom.operation.session.exploring import Exploration
from fiberloom.planning import random_configuration
from fiberloom.store import Store

PLANE = layout(19)
DEPLOYED = random_configuration(PLANE, 1)


@pytest.fixture
def store(tmp_path):
    with Store.open(tmp_path / "arrays.sqlite") as store:
        yield store


def deployed(lies):
    return lying(replace(TwinArray.of(PLANE, DEPLOYED), images=True), PLANE, lies)


def spied(monkeypatch):
    """Spots that were taken to be one positioner's, of every look at one that is not seen itself."""
    seen, spots = [], Exploration._spots

    def told(exploration, row, image):
        found = spots(exploration, row, image)
        if not image.seen[row]:
            seen.append((row, len(found), image.loose_mm))
        return found

    monkeypatch.setattr(Exploration, "_spots", told)
    return seen


@pytest.mark.parametrize("lies", [{4: (15.0, 0.0)}, {11: (60.0, 0.0)}])
def test_one_that_lies_is_found_among_spots_without_names(store, monkeypatch, lies):
    array, looked = deployed(lies), spied(monkeypatch)
    report = done(session(array, PLANE, store).recover())
    assert array.twin.touches() == []
    ids = PLANE.positioner_id[list(lies)].tolist()
    assert sorted(report.found) == sorted(ids), (report.left_out, report.stages)
    assert (report.state, report.left_out) == ("parked", {})
    # its place came from a spot that belongs to none
    assert {row for row, n, _ in looked if n} == set(lies)
    assert off_park_mm(array, PLANE).max() < 0.5
    assert done(session(array, PLANE, store).park()).ok


def test_a_report_that_would_touch_a_neighbour_is_no_collision_and_keeps_no_other_from_being_found(store):
    """One that may be anywhere is a body nowhere; a small move must be clear there, too, so it stays."""
    array = deployed({2: (40.0, 0.0), 13: (-25.0, 20.0)})
    report = done(session(array, PLANE, store).recover())
    assert array.twin.touches() == []
    found, stays = PLANE.positioner_id[[2, 13]].tolist()
    assert (report.touching, report.found, list(report.left_out)) == ([], [found], [stays])
    assert "no small move is proven clear for the 3 places" in report.left_out[stays]


def test_without_the_spots_of_none_it_is_not_found_and_stays(store, monkeypatch):
    """What those spots are for."""
    array = deployed({11: (60.0, 0.0)})
    monkeypatch.setattr(
        Exploration,
        "_spots",
        lambda exploration, row, image: image.xy_mm[[row]] if image.seen[row] else np.zeros((0, 2)),
    )
    before_deg = array.twin.truth()
    report = done(session(array, PLANE, store).recover())
    assert report.found == []
    assert "its fibre is not seen" in report.left_out[int(PLANE.positioner_id[11])]
    assert array.twin.touches() == []
    np.testing.assert_allclose(array.twin.truth()[11], before_deg[11], atol=0.1)
