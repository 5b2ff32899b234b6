"""Commands by HTTP: what they do to the array, what the store has of them, who may be in whose way."""

import json
import struct
import time

import numpy as np
import pytest
from served import ANN, STREAM, N, asking, idle, plane_of, served, wait_for

from fiberloom.errors import InputError
from fiberloom.service.live import FRAME, STATES
from fiberloom.store import Store

PLANE = plane_of()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("served")


@pytest.fixture(scope="module")
def array(folder):
    """At fifty times the speed of an array: a motion lasts half a second."""
    with served(folder, speed=50.0) as array:
        yield array


@pytest.fixture
def client(array, folder):
    with asking(array, folder) as client:
        yield client
    idle(array)


def command(client, path, asked=None):
    """Gives a command and waits for its end; the record of it."""
    found = client.post(path, json=asked)
    assert found.status_code == 202, found.text
    number = found.json()["id"]
    wait_for(lambda: client.get(f"/api/v1/commands/{number}").json()["result"] != "running")
    return client.get(f"/api/v1/commands/{number}").json()


def test_a_target_list_is_observed_and_what_is_shown_is_in_the_store(client, array, folder):
    done = command(client, "/api/v1/observe", {"targets": "t.csv", "corrections": 1})
    assert (done["result"], done["author"], done["role"]) == ("done", "local", "engineer")
    idle(array)
    state = client.get("/api/v1/state").json()
    with Store.read(folder / "store.sqlite") as store:
        run = store.runs()[-1]
        measured = store.measurements(run.id)
    last = measured["move_id"] == measured["move_id"].max()
    # the errors that are drawn are those that were measured, and so are the states
    shown_um = np.array(state["seen"]["errors_um"], dtype=float)
    np.testing.assert_allclose(np.hypot(*shown_um.T), measured["error_um"][last], atol=0.02)
    assert [STATES[code] for code in state["states"]] == measured["status"][last].tolist()
    assert run.command_line == "fiberloom serve: observe by local"
    assert done["text"].startswith(f"{(measured['status'][last] == 'on_target').sum()} of ")
    assert (folder / f"{run.id:04d}" / "summary.json").is_file()


def test_the_targets_that_are_drawn_are_those_of_the_list(client, array, folder):
    command(client, "/api/v1/observe", {"targets": "t.csv", "corrections": 0})
    idle(array)
    shown_mm = np.array(client.get("/api/v1/state").json()["seen"]["targets"], dtype=float)
    with Store.read(folder / "store.sqlite") as store:
        measured = store.measurements(store.runs()[-1].id)
    last = measured["move_id"] == measured["move_id"].max()
    asked_mm = np.column_stack([measured["x_target_mm"][last], measured["y_target_mm"][last]])
    # they are drawn at the goal angles, which reach their targets to a micrometre
    np.testing.assert_allclose(shown_mm, asked_mm, atol=1e-3)


def test_a_second_motion_is_told_which_one_runs(client, array):
    assert client.post("/api/v1/park").status_code == 202
    refused = client.post("/api/v1/observe", json={"targets": "t.csv"})
    assert refused.status_code == 409
    assert "park of local runs since" in refused.json()["detail"]
    idle(array)
    last = client.get("/api/v1/commands").json()
    assert [(c["command"], c["result"]) for c in last[:2]] == [("observe", "refused"), ("park", "done")]


def test_an_array_that_another_process_owns_is_busy(client, array):
    token, _ = array.book.take("fiberloom observe t.csv", "connecting")
    try:
        refused = client.post("/api/v1/park")
    finally:
        array.book.release(token, "unknown")
    assert refused.status_code == 409
    assert "fiberloom observe t.csv" in refused.json()["detail"]


def test_a_locked_array_recovers_and_nothing_else(client, array):
    before = array.book.state()
    array.book.note_stopped("collision of positioners 3, 5", "locked")
    try:
        refused = client.post("/api/v1/park")
        array._look_at_state()
        alarms = client.get("/api/v1/state").json()["alarms"]
    finally:
        array.book.note_stopped("", str(before.state))
        array._look_at_state()
    assert refused.status_code == 409
    assert "recover" in refused.json()["detail"]
    assert [(a["code"], a["severity"], a["text"]) for a in alarms] == [
        ("collision", "critical", "collision of positioners 3, 5")
    ]
    (alarm,) = alarms
    assert client.post(f"/api/v1/alarms/{alarm['id']}/acknowledge").json()["acknowledged_by"] == "local"
    assert client.get("/api/v1/state").json()["alarms"] == []


def test_the_same_key_is_the_same_command(client, array):
    first = client.post("/api/v1/park", headers={"Idempotency-Key": "night-7"}).json()
    again = client.post("/api/v1/park", headers={"Idempotency-Key": "night-7"})
    assert (again.status_code, again.json()["id"]) == (202, first["id"])
    key = {"Idempotency-Key": "night-8"}
    refused = client.post("/api/v1/observe", json={"targets": "t.csv"}, headers=key)
    assert refused.status_code == 409
    idle(array)
    # nothing was done by it: it is given again, and done
    accepted = client.post("/api/v1/park", headers=key)
    assert (accepted.status_code, accepted.json()["command"]) == (202, "park")


def test_a_stop_without_a_store_stops_all_the_same(client, array, monkeypatch):
    command(client, "/api/v1/observe", {"targets": "t.csv", "corrections": 0})
    idle(array)
    number = client.post("/api/v1/park").json()["id"]
    wait_for(lambda: client.get("/api/v1/state").json()["array"]["state"] == "moving")

    def lost(*_):
        raise InputError("store: the disk is full")

    with monkeypatch.context() as patched:
        patched.setattr(array.commands, "begin", lost)
        stopped = client.post("/api/stop")
        assert (stopped.status_code, stopped.json()["stopping"]) == (200, "park")
        idle(array)
    assert client.get(f"/api/v1/commands/{number}").json()["result"] == "stopped"
    # that it is not on record is an alarm, which is gone when the store works again
    alarms = {a.code: a for a in array.alarms.open()}
    assert "store" in alarms
    command(client, "/api/v1/park")
    idle(array)
    array.acknowledge(ANN, alarms["store"].id)
    assert "store" not in {a.code for a in array.alarms.open()}


def test_health_does_not_propose_again_what_was_excluded(client, array, monkeypatch):
    number = int(PLANE.positioner_id[1])
    monkeypatch.setattr(array.health, "proposals", lambda: {number: ("degraded: scale", "exclude it")})

    def proposed():
        command(client, "/api/v1/park")
        idle(array)
        return [a.subject for a in array.alarms.open() if a.code == "health" and a.gone is None]

    assert proposed() == [str(number)]
    client.post("/api/v1/exclude", json={"positioners": [number], "why": "as proposed"})
    assert proposed() == []
    client.post("/api/v1/include", json={"positioners": [number]})
    (alarm,) = (a for a in array.alarms.open() if a.code == "health")
    array.acknowledge(ANN, alarm.id)


def test_excluded_positioners_stay_and_are_shown(client, array):
    number = int(PLANE.positioner_id[2])
    command(client, "/api/v1/observe", {"targets": "t.csv", "corrections": 0})
    asked = {"positioners": [number], "why": "beta slips"}
    assert client.post("/api/v1/exclude", json=asked).json()[0]["who"] == "local"
    truth = array.field.source._inside.hardware.truth
    before_mm = truth.fibre_xy("metrology")
    command(client, "/api/v1/park")
    idle(array)
    moved_mm = np.hypot(*(truth.fibre_xy("metrology") - before_mm).T)
    assert moved_mm[2] < 0.01
    assert np.sum(moved_mm > 1.0) >= N - 2
    assert STATES[client.get("/api/v1/state").json()["states"][2]] == "excluded"
    history = client.get(f"/api/v1/positioners/{number}").json()
    assert history["exclusions"][-1]["why"] == "beta slips"
    assert client.post("/api/v1/include", json={"positioners": [number]}).json() == []
    assert client.post("/api/v1/include", json={"positioners": [number]}).status_code == 400
    last = client.get("/api/v1/commands").json()[:2]
    assert [(c["command"], c["result"]) for c in last] == [("include", "refused"), ("include", "done")]


def test_who_reads_that_a_command_is_over_can_give_the_next_at_once(client, array, monkeypatch):
    look = array._look_at_state
    monkeypatch.setattr(array, "_look_at_state", lambda: (time.sleep(0.3), look()))
    for _ in range(2):
        command(client, "/api/v1/park")


def test_home_searches_the_datum_of_one(client, array):
    number = int(PLANE.positioner_id[0])
    done = command(client, "/api/v1/home", {"positioners": [number]})
    assert done["result"] == "done", done
    idle(array)
    assert client.get(f"/api/v1/positioners/{number}").json()["place"]["datum"]
    unknown = client.post("/api/v1/home", json={"positioners": [99999]})
    assert (unknown.status_code, "99999" in unknown.json()["detail"]) == (400, True)


def test_recover_looks_and_finds_nothing_that_touches(client, array):
    assert command(client, "/api/v1/recover", {"look": True})["result"] == "done"


def test_bad_input_is_one_line(client, folder):
    (folder / "targets" / "bad.csv").write_text("a,b\n1,2\n")
    for name in ("none.csv", "bad.csv", "../store.sqlite", "/etc/passwd", "a/../../store.sqlite", ".hidden"):
        refused = client.post("/api/v1/observe", json={"targets": name})
        assert refused.status_code == 400, name
        assert "\n" not in refused.json()["detail"]
    assert "store.sqlite" not in json.dumps(client.get("/api/v1/targets").json())


def test_a_link_does_not_lead_out_of_the_folder_of_lists(client, folder, tmp_path):
    (tmp_path / "secret.csv").write_text("target_id,x_mm,y_mm\na,1,2\n")
    (folder / "targets" / "link.csv").symlink_to(tmp_path / "secret.csv")
    refused = client.post("/api/v1/observe", json={"targets": "link.csv"})
    assert (refused.status_code, "out of the folder" in refused.json()["detail"]) == (400, True)


def test_a_list_that_is_sent_can_be_observed(client, folder):
    content = (folder / "targets" / "t.csv").read_bytes()
    found = client.put("/api/v1/targets/sent.csv", content=content)
    assert found.json() == {"name": "sent.csv", "targets": 20 * N}
    for name, body in (("sent.exe", content), ("..%2fsent.csv", content), ("sent2.csv", b"no list")):
        assert client.put(f"/api/v1/targets/{name}", content=body).status_code in (400, 404), name
    names = {f["name"] for f in client.get("/api/v1/targets").json()}
    assert "sent.csv" in names
    assert "sent2.csv" not in names


def test_the_stream_numbers_its_events_and_shows_the_motion(client, array):
    states, pictures, numbers = [], [], []
    before = client.get("/api/v1/state").json()["seq"]
    with client.websocket_connect(STREAM) as socket:
        started = client.post("/api/v1/observe", json={"targets": "t.csv", "corrections": 0}).json()
        while True:
            message = socket.receive()
            if (data := message.get("bytes")) is not None:
                pictures.append(data)
                continue
            event = json.loads(message["text"])
            numbers.append(event["seq"])
            states.append(event["kind"])
            if event["kind"] == "command" and event.get("result") == "done" and event["id"] == started["id"]:
                break
    assert numbers == list(range(before + 1, before + 1 + len(numbers)))
    assert {"stage", "plan", "move", "states", "array"} <= set(states)
    head = [FRAME.unpack_from(p) for p in pictures]
    assert all(h[0] == b"FLP1" and h[2] == N for h in head)
    assert all(len(p) == FRAME.size + 9 * N for p in pictures)
    in_motion = [h[3] for h in head if np.isfinite(h[3])]
    assert len(in_motion) >= 2
    assert in_motion == sorted(in_motion)
    last_deg = np.frombuffer(pictures[-1], "<f4", 2 * N, FRAME.size).reshape(2, N).T
    known = array.book.places(PLANE.positioner_id).angles_deg
    idle(array)
    np.testing.assert_allclose(last_deg, known, atol=2e-2)


def test_the_plan_can_be_looked_at_again(client):
    command(client, "/api/v1/observe", {"targets": "t.csv", "corrections": 0})
    content = client.get("/api/v1/plan").content
    step_s, steps, n = struct.unpack_from("<fII", content)
    samples = np.frombuffer(content, "<f4", offset=12).reshape(steps, n, 2)
    about = client.get("/api/v1/state").json()["plan"]
    assert n == N
    assert about["duration_s"] == pytest.approx(step_s * (steps - 1), abs=0.01)
    assert np.isfinite(samples).all()


def test_health_and_figures(client):
    assert client.get("/healthz").json() == {"ok": True}
    assert client.get("/readyz").json() == {"store": True, "bus": True, "camera": True, "maps": True}
    text = client.get("/metrics").text
    assert 'fiberloom_commands_total{command="park",result="done"}' in text or "fiberloom_moves" in text
    assert 'fiberloom_positioners{state="excluded"} 0.0' in text


def test_a_client_that_never_reads_costs_its_queue(array):
    import asyncio

    from fiberloom.service.hub import MOST_CLIENTS, MOST_EVENTS

    async def never_reads():
        client = array.hub.join()
        for _ in range(3 * MOST_EVENTS):
            array.hub.publish("event", {"text": "x"})
            array.hub.show(b"picture")
        found = await client.next()
        others = [array.hub.join() for _ in range(MOST_CLIENTS)]
        for joined in (client, *filter(None, others)):
            array.hub.leave(joined)
        return found, others

    found, others = asyncio.run(never_reads())
    assert [one is None for one in others] == [False] * (MOST_CLIENTS - 1) + [True]
    assert len(array.hub) == 0
    assert len(found) == MOST_EVENTS + 1
    assert json.loads(found[0])["seq"] == array.hub.sequence - MOST_EVENTS + 1


def test_a_mistake_of_the_program_ends_the_command_and_not_the_service(array, monkeypatch):
    async def broken(*_, **__):
        raise ZeroDivisionError("broken")

    monkeypatch.setattr(array.field, "calibrate", broken)
    record = array.park(ANN)
    idle(array)
    ended = array.commands.get(record.id)
    assert (ended.result, "broken" in ended.text) == ("failed", True)
    assert [a.code for a in array.alarms.open()] == ["command"]
    monkeypatch.undo()
    array.park(ANN)
    idle(array)
    (alarm,) = array.alarms.open()
    assert alarm.gone is not None
    array.acknowledge(ANN, alarm.id)
    assert array.alarms.open() == []
