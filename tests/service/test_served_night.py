"""A night that is served: what is shown is what the store has, and what people ask of it, by HTTP."""

import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from served import OURS, asking, idle, served_three_fields, wait_for

from fiberloom.night.asked.control import NightControl
from fiberloom.service.array import Author, Busy
from fiberloom.service.guard.tokens import TokenFile
from fiberloom.service.night.served_night import ServedNight
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.store.nights.book import NightBook


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("night")


@pytest.fixture(scope="module")
def both(folder):
    with served_three_fields(folder, long_s=100, short_s=50) as both:
        yield both


@pytest.fixture(scope="module")
def array(both):
    return both[0]


@pytest.fixture(scope="module")
def night(both):
    return both[1]


@pytest.fixture(scope="module")
def client(array, folder, night):
    with asking(array, folder, night=night) as client:
        yield client


def shown(client):
    return client.get("/api/v1/night").json()


def names(view):
    return [(bar["name"], bar["field"]) for bar in view["bars"] if bar["end"] is not None]


def is_under_way(client, name=""):
    """Whether a stage of this name, or any, has begun and not ended."""
    bars = shown(client)["bars"][-1:]
    return any(bar["end"] is None and name in ("", bar["name"]) for bar in bars)


def ask(client, what, **body):
    answer = client.post(f"/api/v1/night/{what}", json=body or None)
    return answer.status_code, answer.json()


@pytest.fixture(scope="module")
def done(client, array):
    """A night that was paused, whose queue was changed, and that came to its end."""
    told = {"before": ask(client, "pause"), "view before": shown(client)}
    code, begun = ask(client, "begin", resume=False)
    assert (code, begun["command"], begun["result"]) == (202, "night", "running")
    wait_for(lambda: shown(client).get("bars"))
    told["paused"] = ask(client, "pause")
    wait_for(lambda: shown(client)["bars"][-1]["name"] == "pause")
    told["view"] = shown(client)
    told["second"] = ask(client, "begin", resume=False)
    told["park"] = client.post("/api/v1/park").status_code
    told["skip"] = [ask(client, "skip", field=name) for name in ("left", "none")]
    told["add"] = [ask(client, "fields", id=i, targets="t.csv", exposure_s=30.0) for i in ("new", "a")]
    told["first"] = ask(client, "priority", field="new", priority=9.0)
    told["where"] = client.post("/api/v1/night/fields", json={"id": "x", "targets": "../q.toml"}).json()
    assert ask(client, "go_on")[0] == 200
    number = int(array.field.plane.positioner_id[0])
    judged = lambda: client.get(f"/api/v1/positioners/{number}").json()["health"]["moves"]  # noqa: E731
    wait_for(lambda: judged() > 0 or array.running is None)
    told["judged in a night that is"] = shown(client)["status"]
    idle(array)
    return told


def test_what_is_shown_is_what_the_store_has(done, client, folder):
    view = shown(client)
    assert (view["goes_on"], view["status"], view["resume"]) == (False, "finished", False)
    with Store.read(folder / "store.sqlite") as store:
        book = NightBook(store, 1)
        stages, visits = book.stages(), book.visits()
        assert [bar["name"] for bar in view["bars"]] == [s.name for s in stages if ":" not in s.name]
        for bar, stage in zip(view["bars"], [s for s in stages if ":" not in s.name], strict=True):
            assert bar["begin"] == stage.utc_start.timestamp()
            assert bar["end"] - bar["begin"] == pytest.approx(stage.duration_s, abs=1e-3)
        last = {v.field: v for v in visits}
        for row in view["fields"]:
            visit = last.get(row["name"])
            assert row["on_target"] == (visit and visit.on_target)
            assert row["rms_um"] == (visit and visit.rms_um)
            assert visit is None or visit.state == row["state"]
    # one fibre is dark, and all are required: each field has one alarm, and is not done
    told = {(a["code"], a["subject"]) for a in view["alarms"] if a["subject"].startswith("field ")}
    assert told == {("on target", f"field {name}") for name in ("a", "b", "new")}
    assert {f["state"] for f in view["fields"]} == {"failed", "skipped"}


def test_health_has_judged_each_visit_before_the_night_is_over(done, array):
    assert done["judged in a night that is"] == "running"


def test_it_was_paused_and_its_queue_was_changed_by_people_on_record(done, client, folder):
    assert done["before"][0] == 409
    assert "no night goes on" in done["before"][1]["detail"]
    assert (done["view"]["paused_by"], done["second"][0], done["park"]) == ("local", 409, 409)
    assert [code for code, _ in done["skip"]] == [200, 400]
    assert [code for code, _ in done["add"]] == [200, 400]
    assert "is in the queue already" in done["add"][1][1]["detail"]
    assert "below the folder of lists" in done["where"]["detail"]
    exposed = [f for name, f in names(shown(client)) if name.startswith("expose")]
    assert exposed in (["a", "a", "new", "b"], ["new", "a", "a", "b"])
    states = {f["name"]: (f["state"], f["reason"]) for f in shown(client)["fields"]}
    assert states["left"] == ("skipped", "by local; 0 of 1 places done")
    with Store.read(folder / "store.sqlite") as store:
        given = [(c.author, c.role, c.command, c.result) for c in NightBook(store, 1).commands()]
    assert given == [
        ("local", "engineer", *how)
        for how in (
            ("pause", "done"),
            ("skip", "done"),
            ("skip", "refused"),
            ("add field", "done"),
            ("add field", "refused"),
            ("priority", "done"),
            ("go on", "done"),
        )
    ]
    assert any(c["command"] == "skip" for c in client.get("/api/v1/commands").json())


def test_what_comes_next_is_shown_while_it_is_paused(done):
    view = done["view"]
    comes = [(step["name"], step["field"]) for step in view["next"]]
    assert comes[-1] == ("park", "")
    assert ("expose", "b") in comes
    assert all(step["begin"] >= view["now"] for step in view["next"])


def test_an_alarm_of_the_night_is_acknowledged_once(done, client, folder):
    alarm = shown(client)["alarms"][0]
    code, view = ask(client, f"alarms/{alarm['id']}/acknowledge")
    assert (code, alarm["id"] in {a["id"] for a in view["alarms"]}) == (200, False)
    assert ask(client, f"alarms/{alarm['id']}/acknowledge")[0] == 400
    with Store.read(folder / "store.sqlite") as store:
        kept = {a.id: a.acknowledged_by for a in NightBook(store, 1).alarms()}
    assert kept[alarm["id"]] == "local"


def test_a_stop_ends_the_night_it_is_resumed_and_parked_at_once(done, client, array, folder):
    assert ask(client, "begin", resume=True)[0] == 202  # there is none: the command fails, and says so
    idle(array)
    assert "--resume: night 1 is finished" in client.get("/api/v1/commands").json()[0]["text"]
    assert ask(client, "begin", resume=False)[0] == 202
    wait_for(lambda: shown(client)["id"] == 2 and is_under_way(client, "position"))
    assert client.post("/api/stop").json()["stopping"] == "night"
    idle(array)
    assert (shown(client)["status"], shown(client)["resume"]) == ("interrupted", True)
    assert ask(client, "begin", resume=True)[0] == 202
    wait_for(lambda: shown(client)["goes_on"] and is_under_way(client))
    assert ask(client, "park")[0] == 200
    idle(array)
    assert (shown(client)["status"], shown(client)["note"]) == ("interrupted", "parked by local")
    assert ArrayBook(array.book.store, array.book.address).state().state == "parked"
    assert (folder / "night-0002" / "night.html").exists()


def test_a_viewer_sees_the_night_and_changes_nothing(done, array, folder, night, tmp_path):
    file = tmp_path / "tokens"
    file.write_text(f"viewer wall {'v' * 32}\n")
    file.chmod(0o600)
    headers = OURS | {"Authorization": f"Bearer {'v' * 32}"}
    with asking(array, folder, TokenFile.read(file), headers, night) as viewer:
        assert viewer.get("/api/v1/night").status_code == 200
        for path, body in (
            ("begin", {}), ("pause", None), ("go_on", None), ("park", None), ("skip", {"field": "a"}),
            ("priority", {"field": "a", "priority": 1}), ("fields", {"id": "z", "targets": "t.csv"}),
            ("alarms/1/acknowledge", None),
        ):  # fmt: skip
            assert viewer.post(f"/api/v1/night/{path}", json=body).status_code == 403, path


def test_a_night_that_only_begins_takes_no_orders_for_the_one_before(tmp_path):
    """It calibrates first, and has no record: a pause then went to the night before, and was lost."""
    last = SimpleNamespace(control=NightControl())
    array = SimpleNamespace(running=SimpleNamespace(name="night"), hub=None)
    night = ServedNight(array, Path("queue.toml"))
    night._store = Store.open(tmp_path / "store.sqlite", create=True)
    assert (night.view()["begins"], night.view()["goes_on"]) == (True, False)
    night._begun(last)
    assert (night.begins, night.goes_on) == (False, True)
    array.running = SimpleNamespace(name="night")  # the next one
    with pytest.raises(Busy, match="the night only begins"):
        night.pause(Author("ann", "operator"))
    assert (night.begins, night.goes_on, last.control.paused_by) == (True, False, "")


def test_people_outside_are_told_though_health_cannot_judge():
    sent, over = [], threading.Event()

    def judge():
        over.set()
        raise ValueError("a run that cannot be read")

    news = threading.Event()
    news.set()
    array = SimpleNamespace(hub=SimpleNamespace(publish=lambda *_: None))
    made = SimpleNamespace(_over=over, _news=news, array=array, view=dict, _judge=judge)
    made._send = lambda: sent.append("alarm")
    ServedNight._show(made)
    assert sent == ["alarm"]
