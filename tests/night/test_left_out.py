"""A positioner that fails in the middle of the night: nothing is exposed off target; the night goes on."""

import numpy as np
import pytest
from nights import Night

from fiberloom.store.service.alarms import Severity

FIELDS = "".join(
    f'[[field]]\nid = "{name}"\ntargets = "{name}.csv"\nexposure_s = 60\nrepeats = 2\n' for name in "abc"
)


def test_a_visit_that_a_collision_has_ended_is_not_exposed_but_made_again(tmp_path):
    number = int(Night(tmp_path, FIELDS).plane.positioner_id[3])
    night = Night(tmp_path, FIELDS, faults=f"dead=#{number}@90")
    assert night.run().status == "finished"
    alarms = {(a.code, a.subject): a.count for a in night.book.alarms()}
    collisions, visits = alarms["collision", f"positioner {number}"], night.book.visits()
    notes = [v.note for v in visits if v.state == "interrupted"]
    assert notes == collisions * ["a collision: the arms were moved apart, and folded"]
    assert collisions == 1 or alarms["left out", f"positioner {number}"] == 1
    exposed = {e.visit_id for e in night.book.exposures()}
    assert exposed == {v.id for v in visits if v.state == "done"}
    assert {v.part for v in map(Part, visits) if v.done} == {(n, k) for n in "abc" for k in range(2)}
    assert all(v.on_target >= 6 for v in visits if v.state == "done")


class Part:
    """A visit as a place of the queue."""

    def __init__(self, visit):
        self.part, self.done = (visit.field, visit.repeat), visit.state == "done"


def test_who_has_collided_twice_stays_where_it_is_when_the_night_is_resumed(tmp_path):
    night = Night(tmp_path, FIELDS.replace("repeats = 2", "repeats = 1"))
    number = int(night.plane.positioner_id[3])

    def stop(text):
        if text == "expose 1":
            for _ in range(2):
                now, subject = night.book.about.utc_start, f"positioner {number}"
                night.book.raise_alarm(now, "collision", Severity.CRITICAL, subject, "it has collided")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        night.run(progress=stop)
    assert night.run(resume=True).status == "finished"
    alarms = {(a.code, a.subject): a.count for a in night.book.alarms()}
    assert alarms["left out", f"positioner {number}"] == 1
    stood = []
    for visit in night.book.visits()[1:]:
        rows = night.store.measurements(visit.run_id)
        mine = (rows["positioner_id"] == number) & (rows["move"] > 0)
        stood += rows["alpha_deg"][mine].tolist()
        last = (rows["positioner_id"] != number) & (rows["move"] == rows["move"].max())
        assert np.nanmedian(rows["error_um"][last]) < 10.0  # the others are on their targets
    assert len(stood) >= 3
    assert np.ptp(stood) < 0.5


def test_who_was_dead_twice_in_a_row_stays_where_it_is_and_the_others_are_corrected(tmp_path):
    number = int(Night(tmp_path, FIELDS).plane.positioner_id[3])
    night = Night(tmp_path, FIELDS, faults=f"mute=#{number}@90")  # from the second visit on
    assert night.run().status == "finished"
    alarms = {(a.code, a.subject): a.count for a in night.book.alarms()}
    assert alarms["dead", f"positioner {number}"] == 2
    assert alarms["left out", f"positioner {number}"] == 1
    visits = night.book.visits()
    assert [v.state for v in visits] == 6 * ["done"]
    dead = [v for v in visits if is_dead(night, v, number)]
    assert len(dead) == 2
    for visit in visits[visits.index(dead[-1]) + 1 :]:  # it is no part of what is planned any more
        assert visit.assigned <= 6
        assert visit.on_target == visit.assigned


def is_dead(night, visit, number):
    """Whether a visit has told that a positioner is dead."""
    events = night.store.events(visit.run_id)
    return ((events["positioner_id"] == number) & (events["kind"] == "dead")).any()
