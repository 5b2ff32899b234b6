"""A night with RA and Dec: targets are where they will be in the middle of the exposures that are made."""

import time
from datetime import timedelta

import numpy as np
import pytest
from nights import Night

from fiberloom.night import runner
from fiberloom.night.step import Position
from fiberloom.operation.past.rebuild import rebuild

RA_DEG, DEC_DEG = 230.0, 20.0
QUEUE = """
[site]
longitude_deg = -105.82
latitude_deg = 32.78
[[field]]
id = "sky"
targets = "stars.csv"
field = "field.toml"
airmass_max = 1.5
exposure_s = 60
exposures = 2
dithers_um = [[0, 0], [60, 0], [0, 60]]
"""
FIELD = f"""ra_deg = {RA_DEG}
dec_deg = {DEC_DEG}
time = "2026-03-01T00:00:00"
time_scale = "utc"
exposure_s = 10.0
"""


def night_in(folder):
    rng = np.random.default_rng(2)
    stars = np.array([RA_DEG, DEC_DEG]) + rng.uniform(-0.06, 0.06, (60, 2))
    rows = [f"{k},{ra:.9f},{dec:.9f}" for k, (ra, dec) in enumerate(stars)]
    (folder / "stars.csv").write_text("source_id,ra,dec\n" + "\n".join(rows) + "\n")
    (folder / "field.toml").write_text(FIELD)
    return Night(folder, QUEUE)


@pytest.fixture(scope="module")
def night(tmp_path_factory):
    return night_in(tmp_path_factory.mktemp("sky"))


def placed_off_s(night, visit, folder):
    """How much later than the middle of its exposures a visit is placed for, s; and its sky."""
    sky = rebuild(night.store, visit.run_id, folder / str(visit.run_id)).summary["sky"]
    mine = [e for e in night.book.exposures() if e.visit_id == visit.id]
    middle = mine[0].utc_start + (mine[-1].utc_end - mine[0].utc_start) / 2
    placed = np.datetime64(sky["placed_for_utc"]).astype("datetime64[ms]").astype(object)
    return (placed - middle.replace(tzinfo=None)).total_seconds(), sky


def took_s(night, visit):
    """From its begin to its first exposure."""
    first = next(e for e in night.book.exposures() if e.visit_id == visit.id)
    return (first.utc_start - visit.utc_start).total_seconds()


def step_s(night, visit, name):
    return [
        s.duration_s for s in night.book.stages() if (s.visit_id, s.name) == (visit.id, f"position: {name}")
    ]


def slowly(work):
    """As on a busy machine: the clock of the night goes on while the store is read."""

    def slow(*given):
        time.sleep(0.03)
        return work(*given)

    return slow


def test_each_place_is_for_the_middle_of_its_exposures(night, tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "state_of", slowly(runner.state_of))
    assert night.run().status == "finished"
    first, second, third = night.book.visits()
    assert [(v.dither, v.state) for v in (first, second, third)] == [(0, "done"), (1, "done"), (2, "done")]
    (check_s,), (correction_s,) = (step_s(night, first, n) for n in ("begin check", "correction 1"))
    # it was placed for so long after its begin: the queue's word; by the steps; as the dither before
    counted_s = [90.0, check_s + 2 * correction_s, took_s(night, second)]
    for visit, so_long_s in zip((first, second, third), counted_s, strict=True):
        off_s, sky = placed_off_s(night, visit, tmp_path)
        assert off_s == pytest.approx(so_long_s - took_s(night, visit), abs=0.01), visit.dither
        assert sky["exposure_s"] == 120.0
        assert visit.dither == 0 or abs(off_s) < 3.0  # in short: on time


def test_the_next_night_places_its_first_field_as_the_night_before_has_taught(night, tmp_path):
    before_s = took_s(night, night.book.visits()[0])
    ended = night.run()
    visit = night.book.visits()[0]
    off_s, _ = placed_off_s(night, visit, tmp_path)
    assert (ended.night, ended.status) == (2, "finished")
    assert off_s == pytest.approx(before_s - took_s(night, visit), abs=0.01)
    assert abs(off_s) < 5.0


def test_a_place_that_is_resumed_is_for_the_exposures_that_are_left(tmp_path):
    night = night_in(tmp_path)

    def stop(text):
        if text == "expose 2":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        night.run(progress=stop)
    assert night.run(resume=True).status == "finished"
    first, second = night.book.visits()[:2]
    assert [(v.dither, v.state) for v in (first, second)] == [(0, "interrupted"), (0, "done")]
    off_s, sky = placed_off_s(night, second, tmp_path)
    assert sky["exposure_s"] == 60.0
    assert off_s == pytest.approx(took_s(night, first) - took_s(night, second), abs=0.01)


def test_a_dither_follows_the_sky_and_keeps_its_targets(night):
    setup = night.setup()
    queue = setup.read_queue()
    (entry,) = queue.fields
    assert (entry.ra_deg, entry.dec_deg) == (RA_DEG, DEC_DEG)
    first = setup.assigned(Position("sky", 0, 0), entry, queue.begin)
    later = queue.begin + timedelta(hours=1)
    second = setup.assigned(Position("sky", 0, 1), entry, later, first)
    has = np.flatnonzero(first.assignment.target >= 0)
    assert len(has) >= 5
    assert second.assignment.target.tolist() == first.assignment.target.tolist()
    drifted_um = []
    for k in has:
        fibre, row = second.assignment.fibre[k], second.assignment.target[k]
        goal_deg = np.tile(second.assignment.goal_deg[k], (night.plane.n, 1))
        at_mm = night.plane.forward(*goal_deg.T, fibre)[k]
        assert at_mm == pytest.approx(second.targets.place_mm(fibre)[row], abs=1e-6)
        moved_mm = second.targets.place_mm(fibre)[row] - first.targets.place_mm(fibre)[row]
        drifted_um.append(1e3 * np.hypot(*(moved_mm - [0.06, 0.0])))
    assert max(drifted_um) > 1.0
