"""The frame of the reproduction: records, misses, report, interruptions. No experiment is run."""

import json
import re
import subprocess
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
from fiberloom.studies.paper.quantity import ordering, quantity
from fiberloom.studies.paper.registry import FIGURES
from fiberloom.studies.paper.report import report_html
from fiberloom.studies.paper.spectra import SPECTRA, ordering_for_all

PNG = b"\x89PNG\r\n\x1a\n" + b"not really a picture"


def quantities():
    return [
        quantity("fig19.move3.rms_um", "third move", [1.0, 1.2], "um", paper=1.12, note="camera"),
        quantity("fig19.far", "far off <&>", 2.0, "um", paper=1.0, note="because the motor is stronger"),
        quantity("fig19.blind", "blind", [9.0, 11.0], "um", Kind.TUNED, paper=10.36),
        quantity("fig19.better", "ours alone", 0.3, "um", beyond=True),
        quantity("fig19.unseen", "could not be measured", [1.0, float("nan")], "um", paper=1.0),
        quantity("fig19.lost", "put in and lost", 0.5, "um", Kind.PUT_IN, paper=1.0),
        quantity("fig19.most", "a limit", 3.0, "um", Kind.BOUND, paper=5.0, bound=Bound.AT_MOST),
        quantity("fig19.asked", "asked for", 6.0, "um", Kind.REQUIREMENT, paper=5.0, bound=Bound.AT_MOST),
        quantity("fig19.same", "by arithmetic", 1.01, "um", Kind.IDENTITY, paper=1.0),
        quantity("fig19.curve", "no number printed", 7.0, "um"),
        ordering("fig19.order.yes", "a statement that holds", [True, True]),
        ordering("fig19.order.no", "a statement that fails on one seed", [True, False]),
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


@given(kind=st.sampled_from([Kind.PUT_IN, Kind.TUNED]), share=st.floats(-0.9, 3.0))
def test_what_was_put_in_has_to_come_back_within_a_quarter(kind, share):
    q = quantity("fig19.x", "x", 2.0 * (1.0 + share), "1", kind, paper=2.0)
    if abs(abs(share) - 0.25) > 1e-9:
        assert ("does not come back" in numbers.verdict(q)) == (abs(share) > 0.25)


@given(share=st.floats(-0.2, 0.2))
def test_an_identity_holds_but_for_the_papers_rounding(share):
    q = quantity("fig17.x", "x", 7.7 * (1.0 + share), "deg", Kind.IDENTITY, paper=7.7)
    if abs(abs(share) - 0.02) > 1e-9:
        assert ("does not hold" in numbers.verdict(q)) == (abs(share) > 0.02)


@pytest.mark.parametrize("kind", [Kind.BOUND, Kind.REQUIREMENT])
def test_bounds_have_one_side(kind):
    def limited(ours, paper, bound):
        return quantity("eq22.x", "x", ours, "ms", kind, paper=paper, bound=bound)

    below = limited(3.0, 16.0, Bound.AT_MOST)
    assert not below.misses
    assert below.ratio == pytest.approx(3.0 / 16.0)
    assert limited(16.1, 16.0, Bound.AT_MOST).misses
    assert limited(0.9, 1.0, Bound.AT_LEAST).misses
    assert limited(1.0, 0.0, Bound.AT_MOST).misses
    assert not limited(0.0, 0.0, Bound.AT_MOST).misses
    assert numbers.verdict(limited(16.1, 16.0, Bound.AT_MOST)) == f"{kind.value}, not met"
    with pytest.raises(ValueError, match="at most or at least"):
        limited(1.0, 1.0, Bound.EQUAL)


def test_a_limit_is_no_prediction():
    """Else a bound that nothing could miss would count as a hit."""
    with pytest.raises(ValueError, match="not a prediction"):
        quantity("eq22.x", "x", 3.0, "ms", paper=16.0, bound=Bound.AT_MOST)


def test_an_ordering_holds_for_all_or_misses():
    assert not ordering("fig16.order.x", "x", True).misses
    assert not ordering("fig16.order.x", "x", [True] * 9).misses
    almost = ordering("fig16.order.x", "x", [True] * 9 + [False])
    assert almost.misses
    assert almost.ours == pytest.approx(0.9)
    told = [numbers.ours(ordering("fig16.order.x", "x", h)) for h in (True, False, [True, False])]
    assert told == ["true", "false", "50 % of cases"]
    assert (numbers.paper(almost), numbers.ratio(almost), numbers.unit(almost)) == ("true", "–", "")


def test_an_ordering_is_shown_for_every_spectrum():
    q = ordering_for_all("fig26.order.x", "x", {"stages": [True, True], "teeth": [True, False]}, note="why")
    assert q.misses
    assert q.note == "gears 'stages': true; gears 'teeth': true for 1 of 2 seeds. why"
    assert ordering_for_all("fig26.order.x", "x", {g: [True] for g in SPECTRA}).ours == 1.0
    assert len(SPECTRA) >= 2


def test_the_headline_counts_real_predictions_alone():
    """Of the twelve: third, far, unseen and both orderings came out and stand beside the paper."""
    assert numbers.headline(quantities()) == "5 real predictions (3 numbers, 2 orderings), 2 hit"
    assert numbers.others(quantities()) == (
        "1 put in, 1 of them does not come back; 1 tuned; 1 identity; "
        "1 requirement, 1 of them not met; 1 bound"
    )
    assert numbers.headline([]) == "0 real predictions (0 numbers, 0 orderings), 0 hit"


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


def test_a_figure_costs_what_its_processes_cost_too(figures, tmp_path, monkeypatch):
    def hands_on(settings):
        busy = "import time\nwhile time.process_time() < 0.5: pass"
        subprocess.run([sys.executable, "-c", busy], check=True)
        return FigureOutcome(quantities(), [], "as told")

    monkeypatch.setattr(sys.modules["fiberloom.studies.paper.works"], "run", hands_on)
    (part,) = reproduce([figures["19"]], tmp_path, Settings())
    assert part.cpu_s >= 0.5


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
    assert {r["kind"] for r in records} == {kind.value for kind in Kind}
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
    assert "5 real predictions (3 numbers, 2 orderings), 2 hit" in opening
    wrong = [opening.index(word) for word in ("far off", "fails on one seed", "put in and lost", "asked for")]
    assert wrong[1] < wrong[2]  # predictions first
    for sound in ("a statement that holds", "a limit", "by arithmetic", "no number printed"):
        assert sound not in opening
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
    assert str(caught.value).startswith("figure 99: not among table1, section2, 5, 10,")
    assert "\n" not in str(caught.value)


def test_every_figure_has_its_module_and_its_own_name():
    assert len({f.name for f in FIGURES}) == len(FIGURES)
    for figure in FIGURES:
        assert callable(figure.run)
