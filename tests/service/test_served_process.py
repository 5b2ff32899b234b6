"""`fiberloom serve` as it is started: what it refuses, and how a signal ends it in the middle of a motion."""

import json

import pytest
from served import N, StartedService, plane_of, wait_for

from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook, arrays_of
from fiberloom.store.service.commands import CommandBook
from fiberloom.targets import random_targets, write_targets


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        (("--listen", "0.0.0.0:8080"), "--token-file"),
        (("--listen", "here"), "HOST:PORT"),
        (("--token-file", "none"), "no such file"),
        (("--bus", "cannet://10.1.10.31"), "--camera"),
        (("--alarm-webhook", "ftp://x"), "--alarm-webhook"),
        (("--tls-cert", "pyproject.toml"), "--tls-key"),
        (("--database", "night.sqlite"), "is no URL"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(fl, tmp_path, words, fragment):
    code, _, err = fl("serve", "--positioners", N, "--out", tmp_path, *words)
    assert (code, len(err.strip().splitlines())) == (2, 1)
    assert fragment in err


@pytest.mark.slow
def test_a_signal_stops_what_moves_and_then_the_service(tmp_path):
    (tmp_path / "targets").mkdir()
    write_targets(random_targets(plane_of(), 20 * N, 1), tmp_path / "targets" / "t.csv")
    with StartedService("--positioners", N, "--camera", "noise", "--out", tmp_path) as service:
        wait_for(service.ready)
        service.ask("/api/v1/observe", {"targets": "t.csv"})
        wait_for(lambda: service.ask("/api/v1/state")["array"]["state"] == "moving")
        assert service.end() == 0
    with Store.read(tmp_path / "store.sqlite") as store:
        (address,) = arrays_of(store)
        book = ArrayBook(store, address)
        assert book.state().state == "stopped"
        last = CommandBook(book).last()[0]
        assert (last.command, last.result) == ("observe", "stopped")
        assert store.runs()[-1].status == "interrupted"
        assert "7 positioners at rest" in store.events(store.runs()[-1].id)["text"][-1]
    lines = (tmp_path / "serve.log").read_text().splitlines()
    assert {"utc", "level", "text"} <= set(json.loads(lines[-1]))
