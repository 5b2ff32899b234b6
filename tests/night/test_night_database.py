"""A whole night whose record is in a database: the same as in a file, and shown and checked from there."""

import json

import pytest
from databases import postgres
from nights import HEAD

from fiberloom import FocalPlane
from fiberloom.store import Store
from fiberloom.store.nights.book import NightBook
from fiberloom.store.upkeep.check import check_store
from fiberloom.targets import random_targets, write_targets

FIELDS = "".join(f'[[field]]\nid = "{k}"\ntargets = "{k}.csv"\nexposure_s = 60\n' for k in "abc")
ARRAY = "[array]\npositioners = 7\n"
FOUND = ("field", "state", "on_target", "assigned", "rms_um", "plan_from", "exposures", "run_id")


@pytest.fixture(scope="module")
def url():
    with postgres() as url:
        yield url


@pytest.fixture
def queue(tmp_path):
    for k, name in enumerate("abc"):
        write_targets(random_targets(FocalPlane.of("sdssv", n=7), 40, k), tmp_path / f"{name}.csv")
    file = tmp_path / "q.toml"
    file.write_text(HEAD + ARRAY + FIELDS)
    return file


def carried_out(fl, queue, out, *words):
    code, told, said = fl("night", queue, "--out", out, "--json", *words)
    assert code == 0, said
    return json.loads(told)


def test_a_night_in_postgresql_is_the_night_of_a_file(fl, queue, tmp_path, url):
    in_file = carried_out(fl, queue, tmp_path / "file")
    out = tmp_path / "database"
    figures = carried_out(fl, queue, out, "--database", url)
    assert not (out / "store.sqlite").exists()
    assert figures["totals"]["exposures"] == 3
    for one, other in zip(figures["visits"], in_file["visits"], strict=True):
        assert {k: one[k] for k in FOUND} == {k: other[k] for k in FOUND}
    with Store.open(url) as store:
        assert [v.state for v in NightBook(store, 1).visits()] == ["done"] * 3
        assert check_store(store).faults == []
    page = (out / "night-0001" / "night.html").read_text()
    code, told, _ = fl("show", 1, url, "--night", "--out", tmp_path / "shown")
    assert (code, "finished" in told) == (0, True)
    assert (tmp_path / "shown" / "night.html").read_text() == page
    code, _, said = fl("night", queue, "--out", out, "--database", url, "--resume")
    assert (code, "night 1 is finished" in said) == (2, True)


def test_what_is_no_url_is_told_before_anything_is_made(fl, queue, tmp_path):
    code, _, said = fl("night", queue, "--out", tmp_path / "out", "--database", "runs/night.sqlite")
    assert (code, "--database: 'runs/night.sqlite' is no URL" in said) == (2, True)
    assert not (tmp_path / "out").exists()
