"""`design report`: one page with all of it, and what is not known is said."""

from html import escape
from html.parser import HTMLParser

from fiberloom.cli.design.report import BUDGET_TABLES
from fiberloom.design.page import DesignSection, design_html


class Page(HTMLParser):
    """What a reader sees: headings and pictures; and what a page must not have."""

    def __init__(self, text):
        super().__init__()
        self.headings, self.pictures, self.foreign, self._in = [], [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self._in = tag
        source = dict(attrs).get("src") or dict(attrs).get("href") or ""
        if tag == "img":
            self.pictures.append(source[:30])
        if tag == "script" or source.startswith(("http", "//")):
            self.foreign.append(source)

    def handle_data(self, data):
        if self._in in ("h1", "h2"):
            self.headings.append(data)
            self._in = ""


def test_a_page_has_every_section_and_needs_nothing_else(fl, tmp_path, monkeypatch):
    monkeypatch.setattr("fiberloom.cli.design.report.RINGS", 2)
    out = tmp_path / "megara.html"
    code, _, _ = fl("design", "report", "megara", "--core", 600, "--scale", 800, "--fields", 2, "--out", out)
    assert code == 0
    text = out.read_text()
    page = Page(text)
    assert [heading.split(":")[0] for heading in page.headings[1:]] == [
        "Check",
        "Coverage",
        "Efficiency",
        "Gear",
        "Spring",
        "Error budget",
        "Power",
        "Throughput",
    ]
    assert page.pictures == ["data:image/png;base64,iVBORw0K"[:30]] * 3
    assert page.foreign == []
    assert "not looked at: megara: alpha is a stepper" in text
    assert "config_hash" in text
    # each heading says what was found
    assert "Check: nothing wrong" in text
    assert "Coverage: fibre reaches 100.00% of the plane" in text
    assert "Gear: both ratios are in their windows" in text
    assert " ± " in page.headings[3]


def test_the_budget_has_attitudes_nights_tilts_and_statistical_errors(fl, tmp_path, monkeypatch):
    monkeypatch.setattr("fiberloom.cli.design.report.RINGS", 2)
    out = tmp_path / "sdssv.html"
    words = ("--fields", 2, "--units", 7, "--focal-ratio", 5, "--out", out)
    assert fl("design", "report", "sdssv", *words)[0] == 0
    text = out.read_text()
    for caption in BUDGET_TABLES.values():
        assert f">{escape(caption)}</caption>" in text
    for column in ("rms error um twin", "zenith deg", "warmer K", "error of shares", "error within"):
        assert f"<th>{column}</th>" in text
    assert "um rms blind" in text


def test_what_is_written_is_text_and_no_markup():
    page = design_html(
        "<b>", {"a": "<i>"}, [DesignSection("x < y", ["wrong: <u>"], [[{"k_m": "<p>", "none": None}]])]
    )
    assert "<b>" not in page.replace("<body>", "")
    for raw in ("<i>", "<u>", "<td><p>"):
        assert raw not in page
    assert '<p class="fail">wrong: &lt;u&gt;</p>' in page
    assert "<th>k m</th>" in page
    assert "None" not in page


def test_half_of_the_light_options_is_refused(fl, tmp_path):
    code, _, said = fl("design", "report", "lamost", "--core", 320, "--out", tmp_path / "x.html")
    assert code == 2
    assert "needs both" in said
