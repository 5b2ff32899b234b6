"""Fewer fibres on target than the queue requires: the place is made again, at last exposed, and not done."""

import nights
import pytest
from nights import Night

from fiberloom import FocalPlane
from fiberloom.night.figures import night_figures
from fiberloom.night.report import write_report

DARK = f"dark=#{FocalPlane.of('sdssv', n=7).positioner_id[3]}"
QUEUE = "".join(f'[[field]]\nid = "{k}"\ntargets = "{k}.csv"\nexposure_s = 60\n' for k in "ab")
SHORT = "6 of 7 fibres are within the requirement"


@pytest.fixture
def demanding(monkeypatch):
    """All fibres have to be on target."""
    monkeypatch.setattr(nights, "HEAD", nights.HEAD.replace("require = 0.5", "require = 1.0"))


def test_a_place_is_made_again_after_the_others_and_is_not_done(tmp_path, demanding):
    night = Night(tmp_path, QUEUE, faults=DARK)
    assert night.run().status == "finished"
    again, kept = f"{SHORT}: not exposed; made again later", f"{SHORT}: exposed, and not counted as done"
    visits = night.book.visits()
    assert [(v.field, v.state, v.note) for v in visits] == [
        *((name, "failed", again) for name in "ab"),
        *((name, "failed", kept) for name in "ab"),
    ]
    assert [e.visit_id for e in night.book.exposures()] == [3, 4]
    assert {(a.code, a.subject, a.text, a.count) for a in night.book.alarms()} == {
        ("on target", f"field {name}", SHORT, 2) for name in "ab"
    }
    reason = f"0 of 1 places done; exposed, and not counted: {SHORT}"
    told = [(f["state"], f["reason"]) for f in night_figures(night.book)["fields"]]
    assert told == [("failed", reason)] * 2
    page = write_report(night.book, tmp_path).read_text().replace("\u00a0", " ")
    assert reason in page
    assert kept in page


def test_what_was_exposed_counts_when_an_operator_asks_for_less(tmp_path, demanding):
    night = Night(tmp_path, QUEUE, faults=DARK)

    def lowered(text):
        if text == "expose 1":
            file = tmp_path / "queue.toml"
            file.write_text(file.read_text().replace("require = 1.0", "require = 0.8"))

    assert night.run(progress=lowered).status == "finished"
    assert [(v.field, v.state) for v in night.book.visits()] == [
        ("a", "failed"), ("b", "failed"), ("a", "done"), ("b", "done")
    ]  # fmt: skip
    assert {f.name: f.state for f in night.book.fields()} == {"a": "done", "b": "done"}
