"""Alarms: raised, counted, latched until gone and acknowledged, sent, kept over a restart."""

import http.server
import json
import sys
import threading
from datetime import UTC, datetime, timedelta

import pytest

from fiberloom.errors import InputError
from fiberloom.health.status import FAULTS
from fiberloom.service.alarms.board import CODES, WELL_MOVES, AlarmBoard
from fiberloom.service.alarms.send import AlarmSender, by_command, by_webhook
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.store.nights.book import NightBook
from fiberloom.store.service.alarms import Alarm, AlarmTable, Severity


@pytest.fixture
def table(tmp_path):
    with Store.open(tmp_path / "store.sqlite") as store:
        yield AlarmTable(ArrayBook(store, "twin:test"))


@pytest.fixture
def told():
    return []


@pytest.fixture
def sent():
    return []


@pytest.fixture
def board(table, told, sent):
    return AlarmBoard(table, lambda kind, content: told.append((kind, content)), sent.append)


def test_an_alarm_is_over_when_its_cause_is_gone_and_it_was_acknowledged(board):
    board.raise_("camera", "camera", "no image")
    (alarm,) = board.open()
    assert (alarm.severity, alarm.count, alarm.gone, alarm.acknowledged_by) == ("major", 1, None, "")
    assert "doctor" in alarm.advice
    board.acknowledge(alarm.id, "ann")
    assert [a.acknowledged_by for a in board.open()] == ["ann"]
    board.clear("camera", "camera")
    assert board.open() == []


def test_the_other_way_round(board):
    board.raise_("camera", "camera", "no image")
    board.clear("camera", "camera")
    (alarm,) = board.open()
    assert alarm.gone is not None
    board.acknowledge(alarm.id, "ann")
    assert board.open() == []
    with pytest.raises(InputError, match="none that is open"):
        board.acknowledge(alarm.id, "ann")


def test_one_that_comes_back_is_news_again(board, sent):
    board.raise_("dark", "7", "its fibre is not seen")
    board.raise_("dark", "7", "its fibre is not seen")
    (alarm,) = board.open()
    assert (alarm.count, len(sent)) == (2, 1)
    board.clear("dark", "7")
    board.raise_("dark", "7", "again")
    (alarm,) = board.open()
    assert (alarm.count, alarm.gone, alarm.text, len(sent)) == (3, None, "again", 2)


def test_a_positioner_is_well_after_several_moves(board):
    board.event("dark", "its fibre is not seen", 7)
    for _ in range(WELL_MOVES - 1):
        board.judged({7: "on_target"})
    assert board.open()[0].gone is None
    board.judged({7: "dark"})
    for _ in range(WELL_MOVES - 1):
        board.judged({7: "on_target"})
    assert board.open()[0].gone is None
    board.judged({7: "on_target"})
    assert board.open()[0].gone is not None


def test_the_worst_is_first(board):
    for code in ("health", "dark", "camera", "collision"):
        board.raise_(code, "7", "text")
    assert [a.code for a in board.open()] == ["collision", "camera", "dark", "health"]
    assert [a.severity for a in board.open()] == [str(s) for s in Severity]


def test_every_fault_of_a_positioner_is_an_alarm_with_what_to_do():
    assert set(map(str, FAULTS)) <= set(CODES)
    assert all(code.advice for code in CODES.values())


def test_images_that_come_again_end_the_alarm(board):
    board.event("alarm", "no image: silent; nothing moves; once more in 2 s")
    board.event("alarm", "arms overlap as reported", 7)
    board.event("camera", "images again, after 1 that could not be used")
    assert {(a.code, a.subject): a.gone is None for a in board.open()} == {
        ("camera", "camera"): False,
        ("alarm", "7"): True,
    }


def test_healths_verdict_is_a_proposal_and_ends_with_it(board):
    board.proposals({7: ("degraded: scale", "calibrate it anew")})
    (alarm,) = board.open()
    assert (alarm.severity, alarm.advice) == ("advice", "calibrate it anew")
    board.proposals({})
    assert board.open()[0].gone is not None


def test_what_a_later_look_does_not_find_again_is_gone(board):
    board.event("alarm", "arms overlap as reported", 7)
    found = board.open()[0].last
    board.looked_again(found)  # by the command that has raised it
    assert board.open()[0].gone is None
    board.looked_again(found + timedelta(seconds=1))
    assert board.open()[0].gone is not None


def test_an_exclusion_deals_with_what_was_wrong(board):
    board.event("dead", "did not move", 7)
    board.excluded(7)
    assert board.open()[0].gone is not None


def test_alarms_outlive_the_service(table, board):
    board.raise_("camera", "camera", "no image")
    board.raise_("dark", "7", "dark")
    board.acknowledge(next(a for a in board.open() if a.code == "dark").id, "ann")
    again = AlarmBoard(table, lambda *_: None)
    assert [(a.code, a.acknowledged_by) for a in again.open()] == [("camera", ""), ("dark", "ann")]


def test_alarms_of_a_night_are_left_to_its_record(table):
    """What a night raises no command of the service would ever end."""
    about = {"name": "n", "queue": "q", "array": "twin:test", "instrument": "i", "config_hash": "c"}
    now = datetime.now(UTC)
    night = NightBook.begin(table._store, now, about | {"seed": 0, "command_line": "x"})
    night.raise_alarm(now, "cut short", Severity.MINOR, "visit 1", "not all are at their goals")
    assert len(night.alarms()) == 1
    assert AlarmBoard(table, lambda *_: None).open() == []


def test_each_change_is_told(board, told):
    board.raise_("camera", "camera", "no image")
    board.clear("camera", "camera")
    assert [kind for kind, _ in told] == ["alarms"] * 2
    assert json.dumps(told[-1][1])


ALARM = Alarm("dark", "minor", "7", "its fibre is not seen", "look at its light")


def test_an_alarm_goes_to_a_command(tmp_path):
    program = f"import sys; open(sys.argv[1], 'w').write(sys.stdin.read()); print({'x'!r})"
    command = f'{sys.executable} -c "{program}" "{tmp_path}/a file"'
    sender = AlarmSender([by_command(command)])
    sender.send(ALARM)
    sender.close()
    assert json.loads((tmp_path / "a file").read_text())["text"] == ALARM.text


def test_an_alarm_goes_to_a_webhook_and_a_failure_is_in_the_log(caplog):
    got = []

    class Hook(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            got.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204 if len(got) == 1 else 500)
            self.end_headers()

        def log_message(self, *_):
            pass

    with http.server.HTTPServer(("127.0.0.1", 0), Hook) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        sender = AlarmSender([by_webhook(f"http://127.0.0.1:{server.server_port}/hook")])
        sender.send(ALARM)
        sender.send(ALARM)
        sender.close()
        server.shutdown()
    assert [a["code"] for a in got] == ["dark", "dark"]
    assert "not sent" in caplog.text


@pytest.mark.parametrize(("make", "text"), [(by_webhook, "file:///etc/passwd"), (by_command, "mail 'x")])
def test_a_way_that_cannot_be_is_refused(make, text):
    with pytest.raises(InputError, match="--alarm-"):
        make(text)
