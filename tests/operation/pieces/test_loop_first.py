"""The event loop comes first while an array can move, and the process is as before afterwards."""

import asyncio
import gc
import sys

import pytest

import fiberloom as fl
from fiberloom.calibration.transmission.maps import identity
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.observe import Silent
from fiberloom.operation.safety.loop_first import TURN_S, LoopFirst
from fiberloom.studies.paper.no_record import NoRecord
from fiberloom.targets import random_targets
from fiberloom.twin import draw_units, field_hardware


@pytest.fixture(autouse=True)
def before_s(monkeypatch):
    """Turns as nobody has set them, before and after; motions that another test left open do not count."""
    monkeypatch.setattr(LoopFirst, "_begun", set())
    found_s, before_s = sys.getswitchinterval(), 5 * TURN_S
    sys.setswitchinterval(before_s)
    gc.unfreeze()
    yield before_s
    left = sys.getswitchinterval(), gc.get_freeze_count()
    sys.setswitchinterval(found_s)
    assert left == (pytest.approx(before_s), 0)


def test_of_several_the_last_one_ends_it():
    one, other = LoopFirst(), LoopFirst()
    one.begin()
    other.begin()
    other.begin()
    one.end()
    assert sys.getswitchinterval() == pytest.approx(TURN_S)
    assert gc.get_freeze_count() > 1000
    other.end()


def test_one_that_was_not_begun_ends_nothing():
    one = LoopFirst()
    one.begin()
    LoopFirst().end()
    assert sys.getswitchinterval() == pytest.approx(TURN_S)
    one.end()
    one.end()


def test_shorter_turns_are_left_as_they_are(before_s):
    sys.setswitchinterval(TURN_S / 4)
    one = LoopFirst()
    one.begin()
    assert sys.getswitchinterval() == pytest.approx(TURN_S / 4)
    one.end()
    sys.setswitchinterval(before_s)


def test_an_observation_has_it_from_its_first_step_to_the_last(tmp_path):
    seen = []

    class Watching(Silent):
        """Looks at each step."""

        def say(self, text):
            seen.append((text, sys.getswitchinterval(), gc.get_freeze_count()))

    plane = fl.FocalPlane.of("sdssv", n=7)
    field = fl.Field.twin(plane, seed=1)
    field.watcher = Watching()
    field.run.observe(random_targets(plane, 14, 1), corrections=1, out=tmp_path)
    said = [text for text, *_ in seen]
    first = said.index("assigning targets")  # before it the maps are made, where no file has them yet
    assert any(text.startswith("planning") for text in said)
    assert all(turn_s == pytest.approx(TURN_S) and frozen > 1000 for _, turn_s, frozen in seen[first:])


def test_any_motion_has_it_until_its_bus_is_closed():
    plane = fl.FocalPlane.of("sdssv", n=1)

    async def run():
        hardware = field_hardware(plane, draw_units(plane, 1), 1)
        motion = FieldMotion(plane, identity(plane.positioner_id), hardware, NoRecord())
        await motion.connect()
        while_open_s = sys.getswitchinterval()
        await motion.close()
        return while_open_s

    assert asyncio.run(run()) == pytest.approx(TURN_S)
