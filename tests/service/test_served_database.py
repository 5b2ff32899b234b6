"""A night that is served, with its record in PostgreSQL: asked over HTTP, and found in the database."""

import pytest
from databases import postgres
from served import N, StartedService, plane_of, wait_for

from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook, arrays_of
from fiberloom.store.nights.book import NightBook
from fiberloom.store.service.commands import CommandBook
from fiberloom.store.upkeep.check import check_store
from fiberloom.targets import random_targets, write_targets

QUEUE = f"""
begin = 2026-11-25T18:00:00Z
dawn = 2026-11-25T20:00:00Z
require = 0.5
[array]
positioners = {N}
camera = "noise"
[[field]]
id = "a"
targets = "t.csv"
exposure_s = 60
[[field]]
id = "b"
targets = "t.csv"
exposure_s = 60
"""


@pytest.fixture(scope="module")
def url():
    with postgres() as url:
        yield url


def test_a_served_night_is_kept_in_a_database_and_shown_from_it(tmp_path, url):
    write_targets(random_targets(plane_of(), 20 * N, 1), tmp_path / "t.csv")
    (tmp_path / "q.toml").write_text(QUEUE)
    out, number = tmp_path / "out", int(plane_of().positioner_id[0])
    words = "--night", tmp_path / "q.toml", "--out", out, "--database", url
    with StartedService(*words, "--speed", 50, "--exposing-speed", 500) as service:
        wait_for(lambda: (service.asked("/api/v1/night") or {}).get("status") == "finished")
        shown = service.ask("/api/v1/night")["fields"]
        history = service.ask(f"/api/v1/positioners/{number}")
        wait_for(lambda: service.ask("/api/v1/commands")[0]["result"] == "done")
        assert service.end() == 0
    assert not (out / "store.sqlite").exists()
    assert (out / "night-0001" / "night.html").is_file()
    with Store.read(url) as store:
        visits = NightBook(store, 1).visits()
        assert [(v.field, v.state) for v in visits] == [("a", "done"), ("b", "done")]
        assert [(f["on_target"], f["rms_um"]) for f in shown] == [(v.on_target, v.rms_um) for v in visits]
        (address,) = arrays_of(store)
        assert ArrayBook(store, address).state().state == "parked"
        assert [c.command for c in CommandBook(ArrayBook(store, address)).last()] == ["night"]
        assert {v.run_id for v in visits} <= {m["run"] for m in history["measurements"]}
        assert check_store(store).faults == []


def test_a_database_that_is_not_there_is_told_in_one_line(fl, tmp_path):
    nowhere = f"postgresql+psycopg://fiberloom@/postgres?host={tmp_path}"
    code, _, said = fl("serve", "--positioners", N, "--out", tmp_path / "out", "--database", nowhere)
    assert (code, len(said.strip().splitlines())) == (2, 1)
