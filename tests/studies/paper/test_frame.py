"""The frame of the reproduction: records, misses, report, interruptions. No experiment is run."""

import json
import re
import sys
import types

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.errors import InputError
from fiberloom.studies.paper import (
    Bound,
    Drawing,
    Figure,
    FigureOutcome,
    Kind,
    Settings,
    chosen,
    numbers,
    reproduce,
)
from fiberloom.studies.paper.parts import read_parts
from fiberloom.studies.paper.quantity import quantity
from fiberloom.studies.paper.registry import FIGURES
from fiberloom.studies.paper.report import report_html

PNG = b"\x89PNG\r\n\x1a\n" + b"not really a picture"


def quantities():
    return [
        quantity("fig19.move3.rms_um", "third move", [1.0, 1.2], "um", paper=1.12, note="camera"),
        quantity("fig19.far", "far off <&>", 2.0, "um", paper=1.0, note="because the motor is stronger"),
        quantity("fig19.blind", "blind", [9.0, 11.0], "um", Kind.TUNED, paper=10.36),
        quantity("fig19.better", "ours alone", 0.3, "um", beyond=True),
        quantity("fig19.unseen", "could not be measured", [1.0, float("nan")], "um", paper=1.0),
    ]


@pytest.fixture
def figures(monkeypatch):
    """Two figures whose modules are made here: 19 works, 17 is interrupted."""

    def works(settings):
        settings.say("at work")
        return FigureOutcome(
            quantities(), [Drawing("curve", "a curve", PNG)], "as told", "half the size", ["more"]
        )

    def interrupted(settings):
        raise KeyboardInterrupt

    def ends_well(settings):
        return FigureOutcome([quantity("fig17.rms", "rms", 160.0, "nm", paper=160.0)], [], "as told")

    for name, run in {"works": works, "interrupted": interrupted, "ends_well": ends_well}.items():
        module = types.ModuleType(f"fiberloom.studies.paper.{name}")
        module.run = run
        monkeypatch.setitem(sys.modules, module.__name__, module)
    return {
        "19": Figure("19", "Precision iterations", "works"),
        "17": Figure("17", "Repeatability", "interrupted"),
        "17 again": Figure("17", "Repeatability", "ends_well"),
    }


# -- records


def test_ratio_spread_and_figure():
    q = quantity("fig19.move3.rms_um", "third", [1.0, 1.2], "um", paper=1.1)
    assert q.figure == 19
    assert q.ours == pytest.approx(1.1)
    assert q.ratio == pytest.approx(1.0)
    assert q.spread == pytest.approx(0.2 / 2**0.5)  # sd of two values: their difference over root 2
    assert quantity("eq22.max_ms", "n", 3.0, "ms").figure == "eq22"
    assert quantity("eq22.max_ms", "n", 3.0, "ms").spread is None
    assert quantity("eq22.false", "n", 0.0, "1", paper=0.0).ratio is None


@given(paper=st.floats(0.1, 100.0), share=st.floats(-0.9, 3.0))
def test_a_prediction_off_by_more_than_a_quarter_misses(paper, share):
    q = quantity("fig19.x", "x", paper * (1.0 + share), "1", paper=paper)
    if abs(abs(share) - 0.25) > 1e-9:
        assert q.misses == (abs(share) > 0.25)
    for kind in (Kind.PUT_IN, Kind.TUNED):
        assert not quantity("fig19.x", "x", paper * (1.0 + share), "1", kind, paper=paper).misses


def test_bounds_have_one_side():
    below = quantity("eq22.x", "x", 3.0, "ms", paper=16.0, bound=Bound.AT_MOST)
    assert not below.misses
    assert below.ratio == pytest.approx(3.0 / 16.0)
    assert quantity("eq22.x", "x", 16.1, "ms", paper=16.0, bound=Bound.AT_MOST).misses
    assert quantity("eq22.x", "x", 0.9, "1", paper=1.0, bound=Bound.AT_LEAST).misses
    assert quantity("eq22.false", "x", 1.0, "1", paper=0.0, bound=Bound.AT_MOST).misses
    assert not quantity("eq22.false", "x", 0.0, "1", paper=0.0, bound=Bound.AT_MOST).misses


def test_what_could_not_be_measured_is_a_miss():
    q = quantity("fig19.x", "x", [1.0, float("nan")], "1", paper=1.0)
    assert (q.ours, q.ratio, q.misses) == (None, None, True)


def test_ids_name_their_figure():
    with pytest.raises(ValueError, match="pattern"):
        quantity("move3.rms_um", "x", 1.0, "um")


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (36.0, "36"), (10.357, "10.4"), (0.0350123, "0.0350"), (1.234e-12, "1.23e-12"), (None, "–")],
)
def test_numbers_as_people_read_them(value, text):
    assert numbers.number(value) == text


# -- runs


def test_a_run_leaves_results_table_report_and_pictures(figures, tmp_path):
    heard = []
    settings = Settings(seed=4, n_seeds=2, say=heard.append)
    (part,) = reproduce([figures["19"]], tmp_path, settings)
    assert "at work" in heard
    assert part.seeds == [4, 5]
    assert part.seconds >= 0.0
    assert part.cpu_s >= 0.0
    records = json.loads((tmp_path / "results.json").read_text())
    assert [r["id"] for r in records] == [q.id for q in quantities()]
    wanted = {"id", "figure", "paper", "ours", "spread", "unit", "kind", "ratio", "note"}
    assert all(wanted <= r.keys() for r in records)
    assert {r["kind"] for r in records} <= {"put in", "tuned", "predicted"}
    assert records[1]["ratio"] == pytest.approx(2.0)
    assert (tmp_path / "figures" / "fig19_curve.png").read_bytes() == PNG
    assert len((tmp_path / "results.md").read_text().splitlines()) == 2 + len(records)


def test_the_report_hides_nothing(figures, tmp_path):
    reproduce([figures["19"]], tmp_path, Settings())
    page = (tmp_path / "report.html").read_text()
    for q in quantities():
        assert f'id="{q.id}"' in page
    # self-contained: no script, nothing fetched, the picture inside
    assert not re.search(r"<script|https?://|<link", page)
    assert 'src="data:image/png;base64,' in page
    assert "width=device-width" in page
    opening = page[: page.index("<h2")]
    assert "far off &lt;&amp;&gt;" in opening
    assert "because the motor is stronger" in opening
    assert "could not be measured" in opening
    assert "No reason found yet" in opening  # a miss without a note says so
    assert "third move" not in opening
    assert "half the size" in page
    assert "fiberloom reproduce 19 --seed 0 --seeds 3" in page


def test_an_interrupted_run_keeps_what_is_done_and_a_later_one_adds(figures, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        reproduce([figures["19"], figures["17"]], tmp_path, Settings())
    assert [p.key for p in read_parts(tmp_path)] == ["19"]
    assert "Precision iterations" in (tmp_path / "report.html").read_text()
    reproduce([figures["17 again"]], tmp_path, Settings(seed=7))
    assert [(p.key, p.seeds[0]) for p in read_parts(tmp_path)] == [("17", 7), ("19", 0)]
    ids = [r["id"] for r in json.loads((tmp_path / "results.json").read_text())]
    assert ids[0] == "fig17.rms"
    assert "fig19.far" in ids


def test_a_broken_part_is_named(figures, tmp_path):
    reproduce([figures["19"]], tmp_path, Settings())
    (tmp_path / "parts" / "fig17.json").write_text('{"key": "17"')
    with pytest.raises(InputError, match=r"fig17\.json: .*remove it"):
        read_parts(tmp_path)


def test_a_lost_picture_does_not_break_the_report(figures, tmp_path):
    reproduce([figures["19"]], tmp_path, Settings())
    (tmp_path / "figures" / "fig19_curve.png").unlink()
    assert "fig19_curve.png is not there" in report_html(read_parts(tmp_path), tmp_path)


# -- which


def test_figures_are_chosen_in_any_spelling():
    assert [f.key for f in chosen(["19", "Fig16", "fig. 5", "EQ22"])] == ["5", "16", "eq22", "19"]
    assert chosen([]) == list(FIGURES)


def test_an_unknown_figure_is_one_line_with_those_there_are():
    with pytest.raises(InputError) as caught:
        chosen(["99", "16"])
    assert str(caught.value).startswith("figure 99: not among table1, 5, 10,")
    assert "\n" not in str(caught.value)


def test_every_figure_has_its_module_and_its_own_name():
    assert len({f.name for f in FIGURES}) == len(FIGURES)
    for figure in FIGURES:
        assert callable(figure.run)
