"""Lists that remember the sky: guided places, steps of a series, and what is told of them."""

import numpy as np
import pytest

from fiberloom.assignment import assign
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.operation.series.steps import check_series, steps_of
from fiberloom.sky.drift import drift
from fiberloom.targets import read_targets

FIELD = """ra_deg = 166.79
dec_deg = 0.0
time = "2024-04-26T06:00:00"
time_scale = "utc"
exposure_s = 1200.0
overhead_s = 60.0
"""


@pytest.fixture(scope="module")
def stars(tmp_path_factory):
    """Targets at airmass 1.4, 1.2 deg from the centre, for fibres of one plane that is there."""
    folder = tmp_path_factory.mktemp("sky")
    rng = np.random.default_rng(2)
    rows = [
        f"{k},{166.79 + 1.2 + rng.uniform(-0.03, 0.03):.9f},{rng.uniform(-0.03, 0.03):.9f},,,,1"
        for k in range(40)
    ]
    (folder / "stars.csv").write_text(
        "source_id,ra,dec,pmra,pmdec,ref_epoch,priority\n" + "\n".join(rows) + "\n"
    )
    (folder / "field.toml").write_text(FIELD)
    return read_targets(folder / "stars.csv", folder / "field.toml")


@pytest.fixture(scope="module")
def assigned(stars):
    plane = generate(load_instrument("sdssv"), 0)
    return plane, assign(plane, stars)


def test_places_of_an_assignment_are_those_of_its_fibres(stars, assigned):
    _, found = assigned
    has = found.target >= 0
    there = stars.on_sky.places_mm(found.target, found.fibre)
    settled = stars.settled(found.target, found.fibre)
    assert there[has] == pytest.approx(settled.xy_mm[found.target[has]], abs=1e-9)
    assert np.isnan(there[~has]).all()
    assert len(set(found.fibre[has])) == 2


def test_guided_places_miss_by_the_guided_drift(stars, assigned):
    _, found = assigned
    sky, has = stars.on_sky, found.target >= 0
    rest = sky.places_mm(found.target, found.fibre)
    assert sky.guided_mm(found.target, found.fibre, 0.0, 0.0)[has] == pytest.approx(rest[has], abs=1e-9)
    ends = [sky.guided_mm(found.target, found.fibre, 0.0, s) for s in (-600.0, 600.0)]
    missed_um = 1e3 * np.max([np.hypot(*(end - rest)[has].T) for end in ends], axis=0)
    seen = drift(sky.chain, sky.asked(found.target, found.fibre), 1200.0)
    assert missed_um == pytest.approx(seen.guided_um, abs=1e-6)
    assert seen.guided_um.max() < 0.75 * seen.plain_um.max()


def test_steps_follow_the_targets_and_leave_room_for_the_drift(stars, assigned):
    plane, found = assigned
    settled = stars.settled(found.target, found.fibre)
    steps = steps_of(plane, found, settled, 3)
    has = np.flatnonzero(found.target >= 0)
    assert len(steps) == 3
    assert steps[0].angles_deg == pytest.approx(found.goal_deg, abs=1e-9)
    for number, step in enumerate(steps):
        assert step.target_mm[has] == pytest.approx(
            stars.on_sky.places_mm(found.target, found.fibre, 1260.0 * number)[has]
        )
        for k in has:
            fibre = found.fibre[k]
            at = plane.forward(*np.tile(step.angles_deg[k], (plane.n, 1)).T, fibre)[k]
            assert 1e3 * np.hypot(*(at - step.target_mm[k])) < 1e-3
        later = stars.on_sky.then(1260.0 * number)
        left = drift(later, stars.on_sky.asked(found.target, found.fibre), 1200.0).guided_um
        # the noise of the camera is 0.669 um
        assert step.limit_um[has] == pytest.approx(np.maximum(5.0 - left - 2 * 0.669, 5.0 / 3.0))
    assert (steps[2].limit_um[has] < 3.6).all()
    moved_um = 1e3 * np.hypot(*(steps[2].target_mm - steps[0].target_mm)[has].T)
    assert (moved_um > 5.0).all()


def test_a_single_exposure_has_no_steps(stars, assigned):
    plane, found = assigned
    assert steps_of(plane, found, stars, 1) == []
    with pytest.raises(InputError, match="exposures = 0: must be 1 to 200"):
        check_series(stars, 0)


def test_what_is_told_of_the_field(stars, assigned):
    _, found = assigned
    about = stars.on_sky.about()
    assert about["placed_for_utc"] == "2024-04-26T06:10:00.000"
    assert about["airmass"] == pytest.approx(1.43, abs=0.03)
    drifts = stars.on_sky.drift_about(found.target, found.fibre)
    asked, every_s = stars.on_sky.asked(found.target, found.fibre), drifts["reposition_every_s"]
    # the length is found to 1 %
    assert drift(stars.on_sky.chain, asked, every_s).largest_um[1] == pytest.approx(5.0, rel=0.02)
    assert drifts["drift_guided_um"] < drifts["drift_um"]
    nothing = np.full(len(found.target), -1)
    assert stars.on_sky.drift_about(nothing, found.fibre) == {}
