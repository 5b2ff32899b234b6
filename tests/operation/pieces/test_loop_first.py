"""The event loop comes first while an array can move, and the process is as before afterwards."""

import gc
import sys

import pytest

import fiberloom as fl
from fiberloom.operation.observe import Silent
from fiberloom.operation.safety.loop_first import TURN_S, LoopFirst
from fiberloom.targets import random_targets


@pytest.fixture(autouse=True)
def before_s():
    """Turns as nobody has set them, before and after."""
    before_s = sys.getswitchinterval()
    assert before_s > 2 * TURN_S
    yield before_s
    assert sys.getswitchinterval() == before_s
    assert gc.get_freeze_count() == 0


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


def test_an_observation_has_it_from_its_first_image_to_the_last(tmp_path):
    seen = []

    class Watching(Silent):
        """Looks at each step."""

        def say(self, text):
            seen.append((text, sys.getswitchinterval(), gc.get_freeze_count()))

    plane = fl.FocalPlane.of("sdssv", n=7)
    field = fl.Field.twin(plane, seed=1)
    field.watcher = Watching()
    field.run.observe(random_targets(plane, 14, 1), corrections=1, out=tmp_path)
    moving = [row[1:] for row in seen if row[0].startswith("planning")]
    assert moving
    assert all(turn_s == pytest.approx(TURN_S) and frozen > 1000 for turn_s, frozen in moving)
