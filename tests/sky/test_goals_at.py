"""Goals of a field for an exposure that begins at some time."""

from datetime import UTC, datetime

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.operation.series.goals import goals_at, targets_at
from fiberloom.sky.sky_field import SkyField
from fiberloom.targets import read_targets
from fiberloom.targets.read import read_sky

FIELD = {"ra_deg": 166.79, "dec_deg": 0.0, "time_scale": "utc", "exposure_s": 1200.0}
FIRST, SECOND = "2024-04-26T05:00:00", "2024-04-26T06:00:00"


@pytest.fixture(scope="module")
def listed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("goals")
    rng = np.random.default_rng(4)
    rows = [f"{k},{166.79 + rng.uniform(-0.5, 0.5):.9f},{rng.uniform(-0.5, 0.5):.9f}" for k in range(60)]
    (folder / "stars.csv").write_text("source_id,ra,dec\n" + "\n".join(rows) + "\n")
    return folder / "stars.csv"


@pytest.fixture(scope="module")
def plane():
    return FocalPlane.of("sdssv", seed=0, n=37)


def test_goals_are_those_of_the_time_that_is_asked_for(listed, plane):
    field = SkyField.parse(FIELD | {"time": FIRST}, "field")
    then = goals_at(plane, read_sky(listed)[0], field, datetime(2024, 4, 26, 6, tzinfo=UTC))
    told = read_targets(listed, SkyField.parse(FIELD | {"time": SECOND}, "field"), "sdssv")
    assert then.targets.xy_mm == pytest.approx(told.xy_mm, abs=1e-9)
    first = read_targets(listed, field, "sdssv")
    assert 1e3 * np.abs(then.targets.xy_mm - first.xy_mm).max() > 5.0
    assert then.targets.on_sky.chain.pointing.time.iso == "2024-04-26T06:10:00.000"
    has = np.flatnonzero(then.assignment.target >= 0)
    assert len(has) > 10
    for k in has:
        fibre, row = then.assignment.fibre[k], then.assignment.target[k]
        at = plane.forward(*np.tile(then.assignment.goal_deg[k], (plane.n, 1)).T, fibre)[k]
        assert at == pytest.approx(then.targets.place_mm(fibre)[row], abs=1e-6)


def test_without_a_time_it_is_the_fields(listed, plane):
    field = SkyField.parse(FIELD | {"time": FIRST}, "field")
    own = targets_at(read_sky(listed)[0], field, plane)
    assert own.xy_mm == pytest.approx(read_targets(listed, field, "sdssv").xy_mm, abs=1e-9)


def test_a_time_that_cannot_be(listed, plane):
    stars, field = read_sky(listed)[0], SkyField.parse(FIELD | {"time": FIRST}, "field")
    with pytest.raises(InputError, match="needs a time zone"):
        targets_at(stars, field, plane, datetime(2024, 4, 26, 6))
    with pytest.raises(InputError, match="below the horizon"):
        targets_at(stars, field, plane, datetime(2024, 4, 26, 20, tzinfo=UTC))
