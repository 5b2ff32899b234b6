"""A night on the twin: what it does, what it keeps, how it is stopped and goes on, and what it reports."""

import asyncio
import json
import re
import sqlite3
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from nights import Night

from fiberloom.errors import InputError
from fiberloom.night import runner as runner_module
from fiberloom.night.clock import BusClock, WorldClock, within
from fiberloom.night.figures import night_figures, shutter_to_ready_s
from fiberloom.night.report import write_report
from fiberloom.night.runner import NightRunner
from fiberloom.night.shutter import Exposed, TimedShutter
from fiberloom.night.stages import NightStage, RefusedError, StageRunner
from fiberloom.operation.results import Observation
from fiberloom.operation.session.array_lock import ArrayLock, ForbiddenError
from fiberloom.operation.session.states import Deed, Step
from fiberloom.store.arrays import ArrayBook

QUEUE = """
[[field]]
id = "a"
targets = "a.csv"
exposure_s = 300
dithers_um = [[0, 0], [60, 0]]
[[field]]
id = "b"
targets = "b.csv"
priority = 1
exposure_s = 200
exposures = 2
notes = "<b>bold</b>"
[[field]]
id = "c"
targets = "c.csv"
not_after = 2026-11-25T18:01:00Z
"""


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A night of three fields, of which one has no time."""
    night = Night(tmp_path_factory.mktemp("night"), QUEUE)
    said = []
    night.ended = night.run(progress=said.append)
    night.said = said
    return night


def test_a_night_exposes_what_its_queue_asks_for_and_parks(done):
    assert (done.ended.status, done.ended.why) == ("finished", "nothing left that fits")
    visits, exposures = done.book.visits(), done.book.exposures()
    assert [(v.field, v.dither, v.state) for v in visits] == [
        ("b", 0, "done"),
        ("a", 0, "done"),
        ("a", 1, "done"),
    ]
    assert [e.visit_id for e in exposures] == [1, 1, 2, 3]
    assert [(e.utc_end - e.utc_start).total_seconds() for e in exposures] == [200, 200, 300, 300]
    assert {f.name: f.state for f in done.book.fields()} == {"a": "done", "b": "done", "c": "skipped"}
    assert done.store.runs()[-1].status == "finished"
    here = ArrayBook(done.store, "twin:1")
    assert here.state().state == "parked"
    assert not here.state().owned


def test_nothing_moves_while_the_shutter_is_open(done):
    open_ = [(e.utc_start, e.utc_end) for e in done.book.exposures()]
    moving = [s for s in done.book.stages() if s.name in ("position", "park")]
    for stage in moving:
        end = stage.utc_start + timedelta(seconds=stage.duration_s)
        assert all(end <= begin or stage.utc_start >= close for begin, close in open_)
    assert len(moving) == 4


def test_the_next_field_is_planned_while_the_shutter_is_open(done):
    assert [v.plan_from for v in done.book.visits()] == ["planned now", "ahead", "ahead"]
    digests = [done.store.moves(v.run_id)["plan_digest"][1] for v in done.book.visits()]
    assert [v.plan_digest for v in done.book.visits()] == digests  # row 0 is where it began


def test_from_one_dither_to_the_next_each_fibre_keeps_its_target(done):
    first, second = (done.store.measurements(v.run_id) for v in done.book.visits()[1:])
    taken = [t["target_id"][t["move"] == 1].tolist() for t in (first, second)]
    assert taken[0] == taken[1]
    shift = second["x_target_mm"][second["move"] == 1] - first["x_target_mm"][first["move"] == 1]
    np.testing.assert_allclose(shift[np.isfinite(shift)], 0.06, atol=1e-9)
    took = {(s.visit_id, s.name): s.duration_s for s in done.book.stages()}
    assert took[3, "position"] < 0.3 * took[2, "position"]


def test_the_seconds_of_a_visit_are_those_of_its_steps(done):
    for visit in done.book.visits():
        stages = [s for s in done.book.stages() if s.visit_id == visit.id]
        whole = sum(s.duration_s for s in stages if s.name == "position")
        assert sum(s.duration_s for s in stages if s.name.startswith("position: ")) == pytest.approx(whole)
    assert "begin check" in done.said


def test_the_report_says_what_the_store_has(done, tmp_path):
    page = write_report(done.book, tmp_path).read_text()
    assert not re.search(r"(src|href)=|https?://(?!www\.w3\.org)", page)  # nothing from elsewhere
    assert "&lt;b&gt;bold" in page
    figures = json.loads((tmp_path / "night.json").read_text())
    assert figures["totals"]["shutter_open_s"] == pytest.approx(1000.0)
    assert figures["totals"]["exposures"] == 4
    bars = figures["timeline"]
    assert sum(bar["duration_s"] for bar in bars if bar["what"].startswith("exposure")) == pytest.approx(
        1000.0
    )
    for told, visit in zip(figures["convergence"], done.book.visits(), strict=True):
        rows = done.store.measurements(visit.run_id)
        last = rows["error_um"][rows["move"] == rows["move"].max()]
        assert told["rms_um"][-1] == pytest.approx(np.sqrt(np.nanmean(last**2)))
        assert told["rms_um"][-1] == pytest.approx(visit.rms_um)
    assert page.count("<rect") == len(bars)


def test_from_shutter_to_ready_is_measured_from_the_record(done):
    found = shutter_to_ready_s(done.book.visits(), done.book.stages(), done.book.exposures())
    took = {s.visit_id: s.duration_s for s in done.book.stages() if s.name == "position"}
    assert set(found) == {2, 3}
    for visit, gap_s in found.items():
        assert gap_s == pytest.approx(took[visit], abs=0.1)


def test_a_night_that_is_finished_is_not_resumed(done):
    with pytest.raises(InputError, match="--resume: night 1 is finished"):
        done.run(resume=True)


ONE = '[[field]]\nid = "a"\ntargets = "a.csv"\nexposure_s = 120\nexposures = 2\n'


def test_a_night_is_stopped_while_it_exposes_and_goes_on(tmp_path):
    night = Night(tmp_path, ONE)

    def stop(text):
        if text == "expose 2":
            ArrayBook(night.store, "twin:1").ask_stop("ann")

    with pytest.raises(Exception, match="stopped by ann"):
        night.run(progress=stop)
    assert night.book.about.status == "interrupted"
    assert night.book.exposures()[0].utc_end is not None
    again = night.run(resume=True)
    assert (again.status, again.night) == ("finished", 1)
    log = (tmp_path / "night-0001" / "exposures.jsonl").read_text().splitlines()
    assert len(log) == 2  # not opened a second time
    assert sum(e.utc_end is not None for e in night.book.exposures()) == 2


def test_a_field_that_fails_is_told_and_the_night_goes_on(tmp_path):
    two = ONE + '[[field]]\nid = "bad"\ntargets = "bad.csv"\npriority = 1\n'
    (tmp_path / "bad.csv").write_text("target_id,x_mm,y_mm\n1,zero,0\n")
    night = Night(tmp_path, two)
    assert night.run().status == "finished"
    states = {f.name: (f.state, f.reason) for f in night.book.fields()}
    assert states == {"a": ("done", ""), "bad": ("failed", "0 of 1 places done")}
    (alarm,) = night.book.alarms()
    assert (alarm.code, alarm.severity, alarm.subject, alarm.count) == ("visit", "major", "field bad", 2)
    assert "bad.csv" in alarm.text
    assert [v.state for v in night.book.visits()] == ["failed", "failed", "done"]


def test_a_queue_is_edited_while_the_night_goes_on(tmp_path):
    night = Night(tmp_path, ONE)

    texts = {"expose 1": "field = broken", "expose 2": ONE + ONE.replace('id = "a"', 'id = "new"')}

    def edit(text):
        if text in texts:
            night.write(texts.pop(text))

    assert night.run(progress=edit).status == "finished"
    assert [f.name for f in night.book.fields()] == ["a", "new"]
    assert {v.field for v in night.book.visits()} == {"a", "new"}
    (alarm,) = night.book.alarms()
    assert (alarm.code, alarm.gone is not None) == ("queue", True)


def test_what_a_run_tells_an_operator_is_an_alarm_of_the_night(tmp_path):
    night = Night(tmp_path, ONE.replace("exposures = 2", "exposures = 1"), faults="dead=1")
    night.run()
    visit = night.book.visits()[0]
    assert visit.on_target < 7
    figures = night_figures(night.book)
    assert "dead" in figures["worst_positioners"][0]["flags"]


def test_a_night_counts_what_the_images_show_and_not_what_only_a_twin_knows(tmp_path, monkeypatch):
    """A real array has nothing else: it decides by it, and the page's picture shows the same."""
    monkeypatch.setattr(Observation, "on_target", lambda seen, move: np.zeros(len(seen.plane), dtype=bool))
    night = Night(tmp_path, ONE.replace("exposures = 2", "exposures = 1"), faults="dark=1")
    assert night.run().status == "finished"
    (visit,) = night.book.visits()
    rows = night.store.measurements(visit.run_id)
    status = rows["status"][rows["move"] == rows["move"].max()]
    assert visit.on_target == (status == "on_target").sum() == 6
    assert visit.state == "done"


# the parts alone


def test_no_motion_and_no_image_while_it_is_forbidden(done):
    lock = ArrayLock(ArrayBook(done.store, "cannet://h:1"), "night")
    lock.take(Deed.OBSERVE, lambda why: None)
    try:
        for step in (Step.ANSWER, Step.BEGIN):
            lock.step(step)
        lock.forbidden = "the shutter is open"
        for step in (Step.MOVE, Step.LOOK):
            with pytest.raises(ForbiddenError, match="while the shutter is open"):
                lock.step(step)
        lock.forbidden = ""
        lock.step(Step.MOVE)
    finally:
        lock.step(Step.STOP, "test")
        lock.release()


class Bus:
    """Time that passes when it is waited for."""

    def __init__(self):
        self.time_s = 0.0

    async def sleep(self, duration_s):
        self.time_s += duration_s
        await asyncio.sleep(0)


NOON = datetime(2026, 1, 1, 12, tzinfo=UTC)


def test_a_stage_that_takes_too_long_ends_and_is_cleaned_up(done):
    clock, cleaned = BusClock(NOON, Bus()), []

    async def forever():
        while True:
            await clock.sleep(1.0)
            await asyncio.sleep(0.001)

    async def clean():
        cleaned.append(clock.now())

    record = StageRunner(done.book, clock, lambda _: None)
    with pytest.raises(TimeoutError, match="not done within 30 s"):
        asyncio.run(record.run(NightStage("slow", forever, 30.0, cleanup=clean)))
    assert len(cleaned) == 1
    last = done.book.stages()[-1]
    assert (last.name, "not done within 30 s" in last.outcome, last.duration_s > 30.0) == ("slow", True, True)
    with pytest.raises(RefusedError, match="slow: the shutter is open"):
        asyncio.run(record.run(NightStage("slow", forever, 30.0, lambda: "the shutter is open")))
    with sqlite3.connect(done.folder / "store.sqlite") as raw:
        raw.execute("DELETE FROM stages WHERE name = 'slow'")


def test_work_that_is_done_in_time_gives_its_error():
    async def bad():
        raise ValueError("x")

    with pytest.raises(ValueError, match="x"):
        asyncio.run(within(bad(), WorldClock(), 5.0))


def test_work_of_a_quick_twin_that_took_too_long_is_too_late_although_it_has_ended():
    """Between two looks at its clock."""
    bus = Bus()
    with pytest.raises(TimeoutError, match="not done within 5 s"):
        asyncio.run(within(bus.sleep(5.1), BusClock(NOON, bus), 5.0))
    asyncio.run(within(bus.sleep(4.9), BusClock(NOON, bus), 5.0))


def test_a_shutter_opens_once_for_a_key_and_remembers(tmp_path):
    bus = Bus()
    log, clock = tmp_path / "log.jsonl", BusClock(NOON, bus)

    async def go():
        assert await TimedShutter(log, clock).seen("k") == Exposed()
        await TimedShutter(log, clock).start("k", 100.0)
        await bus.sleep(60.0)
        await TimedShutter(log, clock).start("k", 100.0)
        assert (await TimedShutter(log, clock).seen("k")) == Exposed(NOON, None)
        await bus.sleep(40.0)
        return await TimedShutter(log, clock).seen("k")

    assert asyncio.run(go()) == Exposed(NOON, NOON + timedelta(seconds=100))
    with log.open("a") as lines:
        lines.write('{"key": "half", "ut')  # the process was killed while it wrote
    assert asyncio.run(TimedShutter(log, clock).seen("half")) == Exposed()
    asyncio.run(TimedShutter(log, clock).start("next", 100.0))
    assert asyncio.run(TimedShutter(log, clock).seen("next")) == Exposed(clock.now(), None)
    assert asyncio.run(TimedShutter(log, clock).seen("k")) == Exposed(NOON, NOON + timedelta(seconds=100))


def test_an_array_that_stays_locked_needs_a_person(tmp_path, monkeypatch):
    night = Night(tmp_path, ONE)

    async def collided(self, step):
        self.held.leave(Step.COLLIDE, "collision of positioners 3, 4")
        await self._settled()

    async def in_vain(self):
        self.held.lock.step(Step.CONNECT)
        self.held.leave(Step.COLLIDE, "collision of positioners 3, 4")

    monkeypatch.setattr(NightRunner, "_position", collided)
    monkeypatch.setattr(NightRunner, "_recover", in_vain)
    ended = night.run()
    assert ended.status == "failed"
    assert "fiberloom recover" in ended.why
    (alarm,) = night.book.alarms()
    assert (alarm.code, alarm.count) == ("collision", runner_module.RECOVERIES + 1)
