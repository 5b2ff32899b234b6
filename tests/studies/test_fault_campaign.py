"""The fault campaign counts right: what is missed, what hangs, what crashes, what touches, and it resumes."""

import json
import os
import signal
import time
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks.faults.campaign import ARRAYS, LINES, Campaign, arrays_of
from benchmarks.faults.disk import Ballast, mounted
from benchmarks.faults.draw import KINDS, OF_POSITIONERS, Injected, Scene, draw
from benchmarks.faults.host import Desk
from benchmarks.faults.judge import Image, Record, _Judge
from benchmarks.faults.one_seed import run_seed
from benchmarks.faults.table import SEEDS, Goal, Verdict, exit_code, goals, interval, table
from benchmarks.faults.world import Shot

from fiberloom.errors import InputError
from fiberloom.instruments.model import METROLOGY
from fiberloom.operation.field_state import FieldState
from fiberloom.operation.results import files
from fiberloom.operation.session.recover import Recovery
from fiberloom.twin.twin import Touch, Twin


def line(seed, **more):
    """Of a seed in which all went well."""
    faults = [{"kind": "dark", "shown": True, "flagged": True, "missed": False}]
    return {"seed": seed, "faults": faults, "healthy": 70, "told_good": 70, "exits": [0, 0], **more}


def verdict(lines, name):
    (found,) = [goal.verdict for goal in goals(lines) if name in goal.name]
    return found


# the verdict

GOOD = [line(seed) for seed in range(SEEDS)]
MISSED = [{"kind": "dead", "shown": True, "flagged": False, "missed": True}]


def test_a_campaign_without_findings_reaches_every_goal():
    assert {goal.verdict for goal in goals(GOOD)} == {Verdict.REACHED}
    assert exit_code(GOOD) == 0


@pytest.mark.parametrize(
    ("found", "name"),
    [
        ({"hang": True}, "hang"),
        ({"crash": "Traceback"}, "crash"),
        ({"unreadable": "damaged"}, "cannot be read"),
        ({"contacts": [[1.0, 3, 4]]}, "contact"),
        ({"false_good": [[1, 5, 900.0]]}, "gross false good"),
        ({"false_success": [0]}, "false success"),
    ],
)
def test_a_single_finding_is_a_goal_that_is_not_reached(found, name):
    lines = [*GOOD[1:], line(0, **found)]
    assert verdict(lines, name) == Verdict.MISSED
    assert exit_code(lines) == 1
    assert f"| {Verdict.MISSED} |" in "\n".join(table(lines))


def test_shares_are_held_against_their_goals():
    missed = [line(seed, faults=MISSED) if seed % 40 == 0 else line(seed) for seed in range(SEEDS)]
    assert verdict(missed, "missed") == Verdict.MISSED
    flags = [line(0, false_flags=[[1, 2, "dead"]] * 71), *GOOD[1:]]
    assert verdict(flags, "flagged") == Verdict.MISSED
    assert verdict([line(0, false_flags=[[1, 2, "dead"]]), *GOOD[1:]], "flagged") == Verdict.REACHED


def test_too_few_seeds_judge_nothing():
    few = GOOD[:20]
    assert {goal.verdict for goal in goals(few)} == {Verdict.OPEN}
    assert exit_code(few) == 3
    assert exit_code([]) == 3


def test_a_share_near_its_goal_is_not_judged():
    assert Goal("x", 2, 100, 0.02).verdict == Verdict.OPEN
    assert Goal("x", 20, 10000, 0.02).verdict == Verdict.REACHED
    assert interval(0, 1000)[1] == pytest.approx(0.00368, abs=1e-5)
    assert interval(5, 100) == pytest.approx((0.0164, 0.1128), abs=1e-4)


# seeds in processes


def work(seed, log):
    """What seeds do here: some hang, some die."""
    with (log.parent / "begun").open("a") as file:
        file.write(f"{seed} ")
    if seed == 1:
        time.sleep(600.0)
    if seed == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    if seed == 3:
        raise ValueError("no such thing")
    return line(seed)


def test_a_seed_that_hangs_or_dies_is_counted_and_the_others_go_on(tmp_path):
    lines = Campaign(tmp_path, work, workers=2, deadline_s=3.0).run(range(5))
    assert lines[1] == {"seed": 1, "hang": True}
    assert "ended with -9" in lines[2]["crash"]
    assert "no such thing" in lines[3]["crash"]
    assert [lines[seed]["healthy"] for seed in (0, 4)] == [70, 70]
    assert verdict(list(lines.values()), "hang") == verdict(list(lines.values()), "crash") == Verdict.MISSED


def test_it_goes_on_where_it_was_stopped(tmp_path):
    def stop(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Campaign(tmp_path, work).run([5, 6, 7], stop)
    with (tmp_path / LINES).open("a") as file:
        file.write('{"seed": 6, "heal')  # killed while it wrote
    lines = Campaign(tmp_path, work).run([5, 6, 7])
    assert sorted(lines) == [5, 6, 7]
    assert (tmp_path / "begun").read_text() == "5 6 7 "
    assert [json.loads(text)["seed"] for text in (tmp_path / LINES).read_text().splitlines()] == [5, 6, 7]


def test_two_campaigns_in_one_folder_are_refused(tmp_path):
    campaign = Campaign(tmp_path, work)

    def again(_):
        with pytest.raises(InputError, match="another campaign runs there"):
            campaign.run([6])

    assert list(campaign.run([5], again)) == [5]


# what is drawn


def test_every_kind_is_drawn_and_nobody_has_two_faults():
    scenes = [draw(seed, range(1, 38)) for seed in range(200)]
    assert {f.kind for scene in scenes for f in scene.faults} == set(KINDS)
    assert all(1 <= len({f.kind for f in scene.faults}) <= 4 for scene in scenes)
    for scene in scenes:
        victims = [f.positioner_id for f in scene.of(*OF_POSITIONERS)]
        assert len(set(victims)) == len(victims)
    assert draw(7, range(1, 38)) == scenes[7]


def test_a_disk_that_is_full(tmp_path):
    """In a process of its own, for the mount stays."""
    pid = os.fork()
    if pid == 0:
        if not mounted(tmp_path):
            os._exit(2)
        ballast = Ballast(tmp_path)
        ballast.fill(0.0)
        try:
            (tmp_path / "more").write_bytes(bytes(8192))
        except OSError:
            ballast.away()
            (tmp_path / "more").write_bytes(bytes(8192))
            os._exit(0)
        os._exit(1)
    _, status = os.waitpid(pid, 0)
    assert os.waitstatus_to_exitcode(status) in (0, 2)  # 2: mounts are not allowed here
    assert not (tmp_path / "more").exists()


# the array

N = 7


@pytest.fixture(autouse=True)
def no_figures(monkeypatch):
    """Commands draw nothing here: that is most of their time."""
    monkeypatch.setattr(files, "_plot", lambda *_: None)


@pytest.fixture(scope="module")
def array(tmp_path_factory):
    return arrays_of(N, tmp_path_factory.mktemp("faults"), count=1)[0]


def came_of(array, tmp_path, *faults):
    return run_seed(array, Scene(3, faults), tmp_path / "log")


def number(array, row=3):
    return int(array.plane.positioner_id[row])


@pytest.mark.slow
def test_a_field_without_faults_has_no_findings(array, tmp_path):
    found = came_of(array, tmp_path)
    assert found["exits"] == [0, 0]
    assert found["healthy"] == 2 * N
    assert found["told_good"] >= 2 * N - 2
    for name in ("false_flags", "false_good", "contacts", "contacts_unknown", "false_success", "crash"):
        assert not found[name], name


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["dark", "lying"])
def test_a_fault_is_flagged_and_missed_without_its_detector(array, tmp_path, monkeypatch, kind):
    fault = Injected(kind, number(array))
    (told,) = came_of(array, tmp_path, fault)["faults"]
    assert told["shown"]
    assert told["flagged"]
    assert not told["missed"]

    def nothing(*_):
        pass

    monkeypatch.setattr(FieldState, "flag", nothing)
    monkeypatch.setattr("benchmarks.faults.judge._health", lambda *_: [])
    found = came_of(array, tmp_path, fault)
    (missed,) = found["faults"]
    assert (missed["shown"], missed["flagged"], missed["missed"]) == (True, False, True)


@pytest.mark.slow
def test_contacts_are_counted_by_what_was_known(array, tmp_path, monkeypatch):
    a, b = number(array, 1), number(array, 2)
    touches = iter([[Touch(20.0, a, b)]])
    monkeypatch.setattr(Twin, "touches", lambda _: next(touches, []))
    found = came_of(array, tmp_path)
    assert found["contacts"] == [[20.0, a, b]]
    assert found["healthy"] == 2 * N - 4  # what was touched may be anywhere
    touches = iter([[Touch(20.0, a, b)]])
    found = came_of(array, tmp_path, Injected("lying", a, 19.0))
    assert (found["contacts"], found["contacts_unknown"]) == ([], [[20.0, a, b]])


@pytest.mark.slow
@pytest.mark.parametrize(("row", "kind"), [(2, "contacts_unreached"), (0, "contacts")])
def test_a_contact_of_one_that_no_frame_reaches_is_counted_apart(array, tmp_path, monkeypatch, row, kind):
    """Rows 1, 3, 5 are behind the cut cable. One in row 2 could have been stopped."""
    a, b = number(array, 1), number(array, 2)
    cut, ill = Injected("cut", 0, 18.0, 5.0), Injected("stuck_hall", number(array, row), 19.0)
    touches = iter([[Touch(20.0, a, b)]])
    monkeypatch.setattr(Twin, "touches", lambda _: next(touches, []))
    found = came_of(array, tmp_path, cut, ill)
    told = {name: found[name] for name in ("contacts", "contacts_unknown", "contacts_unreached")}
    assert {name for name, value in told.items() if value} == {kind}


def test_one_that_was_not_heard_yet_has_reported_nothing(array):
    """Seed 977: it was behind the cut cable at the begin."""
    world = SimpleNamespace(contacts=[], scene=Scene(977, ()), plane=array.plane)
    here = {METROLOGY: np.zeros((N, 2))}
    heard = np.full((N, 2), 10.0)
    for wire_deg, lies in ((np.zeros((N, 2)), False), (heard, True)):
        image = Image(1, True, Shot(0.0, here), [""] * N, heard, wire_deg, heard)
        judge = _Judge(world, array.maps, Record([], [image], []), [], [])
        assert judge._shows_lying(0, 3) == lies


def test_one_that_waits_where_it_reports_does_not_show_that_it_lies():
    """Seed 68: a motion was stopped before its motor had turned; nothing could tell of it."""
    world = SimpleNamespace(contacts=[], scene=Scene(68, ()), plane=None)
    judge = _Judge(world, None, Record([], [], []), [], [])
    judge._shows_lying = lambda *_: False
    judge._shows_stillness = lambda *_: True
    assert [judge._shows(1, 0, kind) for kind in ("lying", "broken_arm", "dead")] == [False, False, True]


@pytest.mark.slow
def test_a_command_that_is_killed_is_told_and_the_next_one_goes_on(array, tmp_path):
    found = came_of(array, tmp_path, Injected("kill", 0, 12.0, 0.05))
    assert found["exits"][0] == -9
    (kill,) = found["faults"]
    assert kill["flagged"]
    assert found["runs"][0] == "interrupted"
    assert not found["contacts"]
    assert not found["crash"]


@pytest.mark.slow
def test_a_false_good_is_counted(array, tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.faults.judge.POOR_REQUIREMENTS", 1e-9)
    found = came_of(array, tmp_path)
    assert len(found["false_good"]) == found["told_good"] > 0
    assert found["false_success"] == [0, 1]


@pytest.mark.slow
@pytest.mark.parametrize("works", [True, False])
def test_an_array_that_is_left_locked_is_recovered(tmp_path, monkeypatch, works):
    """Seed 59: a hall sensor sticks in a field of 37, and the array is locked."""
    if not works:
        monkeypatch.setattr(Recovery, "run", nothing_is_done)
    dense = arrays_of(37, tmp_path)[59 % ARRAYS]
    found = run_seed(dense, draw(59, dense.plane.positioner_id.tolist()), tmp_path / "log")
    assert (found["locked"], found["recovered"]) == (1, int(works))
    assert len(found["recover_exits"]) == (1 if works else 4)  # the next command is refused; then twice more


async def nothing_is_done(*_):
    raise InputError("nothing is done")


@pytest.mark.slow
def test_a_restart_that_is_told_where_no_image_comes_is_not_missed(array, tmp_path):
    """At rest; the motion that shows it is the last one before the camera fails for good."""
    hang = Injected("camera_hang", 0, 3.0, 6.0)
    found = came_of(array, tmp_path, hang, Injected("reboot", number(array), 25.0))
    assert found["runs"][0] == "failed"
    told = {f["kind"]: f for f in found["faults"]}["reboot"]
    assert not told["missed"]


def test_a_store_without_tables_is_of_no_locked_array(tmp_path):
    """As a command leaves it that was killed at its very begin."""
    desk = Desk([1], (), tmp_path / "maps.npz", tmp_path, tmp_path / "log")
    assert not desk.locked()
    desk.store.touch()
    assert not desk.locked()
