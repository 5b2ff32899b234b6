"""What a night does when positioning fails, when arms touch, and when the shutter stays open."""

import asyncio

import pytest
from nights import Night

from fiberloom.metrology.sources.errors import CameraError
from fiberloom.night.carry import carry_out
from fiberloom.night.runner import NightRunner
from fiberloom.night.shutter import TimedShutter
from fiberloom.operation.loop import Loop
from fiberloom.operation.session.recover import Recovery
from fiberloom.operation.session.states import Step
from fiberloom.store.arrays import ArrayBook

ONE = '[[field]]\nid = "a"\ntargets = "a.csv"\nexposure_s = 120\n'


def state_of_array(night):
    return ArrayBook(night.store, "twin:1").state()


def test_a_visit_that_fails_while_it_moves_is_made_again(tmp_path, monkeypatch):
    night, correct, left = Night(tmp_path, ONE), Loop.run, [1]

    async def dark_once(self):
        if left:
            left.pop()
            await self.blind_move()
            raise CameraError("no image")
        return await correct(self)

    monkeypatch.setattr(Loop, "run", dark_once)
    assert night.run().status == "finished"
    assert [v.state for v in night.book.visits()] == ["failed", "done"]
    (alarm,) = night.book.alarms()
    assert (alarm.code, alarm.text) == ("visit", "stopped after an error: no image")
    assert state_of_array(night).state == "parked"


def test_an_array_that_cannot_be_parked_needs_a_person(tmp_path):
    night = Night(tmp_path, "stage_timeout_s = 3\n" + ONE)
    ended = night.run()
    assert ended.status == "failed"
    assert ended.why.startswith("the array is not parked: ")
    assert [v.state for v in night.book.visits()] == ["failed", "failed"]
    assert not state_of_array(night).owned


@pytest.mark.parametrize("fails", [0, 1])
def test_after_a_recovery_the_night_goes_on(tmp_path, monkeypatch, fails):
    night, position, recover = Night(tmp_path, ONE), NightRunner._position, Recovery.run
    collides, in_vain = [1], [CameraError("no image")] * fails

    async def collided_once(self, step):
        if collides:
            collides.pop()
            self.held.leave(Step.COLLIDE, "collision of positioners 3, 4")
            await self._settled()
        else:
            await position(self, step)

    async def recovered(self):
        if in_vain:
            raise in_vain.pop()
        return await recover(self)

    monkeypatch.setattr(NightRunner, "_position", collided_once)
    monkeypatch.setattr(Recovery, "run", recovered)
    assert night.run().status == "finished"
    assert [v.state for v in night.book.visits()] == ["done"]
    (alarm,) = night.book.alarms()
    assert (alarm.code, alarm.count) == ("collision", 1 + fails)


class StuckShutter(TimedShutter):
    """Its log says for how long it stays open, whatever it was asked for."""

    async def start(self, key, exposure_s):
        await super().start(key, 600.0)


def test_nothing_moves_until_a_shutter_that_is_stuck_is_closed(tmp_path):
    night = Night(tmp_path, ONE + ONE.replace('"a"', '"b"'))
    setup, folder = night.setup(), tmp_path / "night-0001"
    setup.shutter = lambda *parts: folder.mkdir() or StuckShutter(folder / "exposures.jsonl", parts[-1])
    ended = asyncio.run(carry_out(setup, night.store, resume=False))
    assert ended.status == "failed"
    assert ended.why.startswith("the shutter: not done within 180 s; see that it is closed")
    assert [(v.field, v.state) for v in night.book.visits()] == [("a", "failed")]  # no other has lost a try
    assert night.book.exposures()[0].utc_end is None
    assert night.run(resume=True).status == "finished"
    stuck = night.book.exposures()[0]
    assert (stuck.utc_end - stuck.utc_start).total_seconds() == 600.0
    assert [(v.field, v.state) for v in night.book.visits()] == [("a", "failed"), ("b", "done")]
    assert all(s.utc_start >= stuck.utc_end for s in night.book.stages() if s.visit_id == 2)
    assert {f.name: f.state for f in night.book.fields()} == {"a": "done", "b": "done"}


def test_motors_that_make_their_own_way_are_not_planned_ahead(tmp_path):
    night = Night(tmp_path, ONE + ONE.replace('"a"', '"b"'), instrument="desi")
    assert night.run().status == "finished"
    told = [(v.field, v.state, v.plan_from) for v in night.book.visits()]
    assert told == [("a", "done", "planned now"), ("b", "done", "planned now")]
