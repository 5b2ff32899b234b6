"""Pages to be signed: parsed, each picture once and inside the file, each word escaped."""

import base64
import json
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest

from fiberloom.calibration.bench.acceptance import AcceptanceData, AcceptanceSettings, Check, UnitVerdict
from fiberloom.calibration.bench.estimate import Fitted, Residuals, estimate
from fiberloom.calibration.bench.repeatability import RepeatabilityData
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.instruments import generate
from fiberloom.report.acceptance import acceptance_html, found_text
from fiberloom.report.acceptance_records import BLANK, Paperwork, page_head, page_name, unit_record
from fiberloom.report.commissioning import commissioning_html, limits_text, number_text
from fiberloom.report.commissioning import found_text as found_in_record

VOID = {"meta", "img", "br", "link", "hr", "input"}


class Page(HTMLParser):
    """Title, table rows, pictures, and whether every element is closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.rows, self.pictures, self.text, self.kinds = [], [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == [], f"not closed: {self.open}"

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.kinds.append(attrs.get("class", ""))
        if tag == "img":
            self.pictures.append(attrs)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.text.append(data)
        if "td" in self.open or "th" in self.open:
            self.rows[-1][-1] += data


@pytest.fixture(scope="module")
def pair(sdssv):
    return generate(sdssv, seed=0, n_positioners=2)


def one(name, value, n=2):
    fitted = Fitted(np.full(n, value), np.full(n, 0.1))
    return estimate(name, "µm", fitted, Residuals(np.zeros((n, 3)), "µm"), [""] * n)


@pytest.fixture(scope="module")
def data(pair):
    """Two units with a gear of known deviations and visits on circles about three targets."""
    rng = np.random.default_rng(5)
    theta = np.broadcast_to(np.linspace(0.0, 180.0, 20), (2, 2, 2, 20)).copy()
    wire = theta + 0.2 * np.sin(np.deg2rad(theta)) + np.array([0.0, 0.1])[None, None, :, None]
    at = pair.centres_mm[:, None, None] + np.array([20.0, 0.0]) + rng.normal(0, 1e-3, (2, 3, 4, 2))
    visits = [RepeatabilityData(k, at, pair.centres_mm, np.full(2, 20.0), [""] * 2) for k in (0, 1)]
    own = SimpleNamespace(own=one("own", 0.8), measured=one("measured", 0.9))
    return AcceptanceData(
        pair,
        TransmissionMaps(pair.positioner_id, wire, theta),
        None,
        None,
        np.array([[30.0, 170.0], [60.0, 100.0], [90.0, 120.0]]),
        np.abs(rng.normal(20.0, 5.0, (2, 3, 4))),
        tuple(visits),
        (own, own),
        ["", ""],
    )


CHECKS = (
    Check("blind error, largest", 41.2, 0.5, 50.0, "µm"),
    Check("hysteresis, <alpha>", 0.31, 0.02, 0.3, "°", "a & b"),
    Check("tilt of the fibre", None, None, 0.15, "°"),
    Check("blind error, rms", 22.0, None, None, "µm"),
)


def test_an_accepted_page_shows_every_check_once_and_three_pictures(pair, data):
    verdict = UnitVerdict(int(pair.positioner_id[1]), 1, CHECKS, "")
    text = acceptance_html(verdict, data, {"Unit": "<positioner> & co", "Engineer": BLANK})
    page = Page(text)
    found = {row[0]: row[1:] for row in page.rows if row[0]}
    assert found["blind error, largest"] == ["41.20 ± 0.50 µm", "50 µm", "pass"]
    assert found["hysteresis, <alpha>a & b"] == ["0.310 ± 0.020 °", "0.3 °", "fail, near its limit"]
    assert found["tilt of the fibre"] == ["–", "0.15 °", "not measured"]
    assert found["blind error, rms"] == ["22 µm", "", ""]
    captions = [p["alt"] for p in page.pictures]
    assert len(captions) == len(set(captions)) == 3
    for picture in page.pictures:
        kind, code = picture["src"].split(",", 1)
        assert kind == "data:image/png;base64"
        assert base64.b64decode(code).startswith(b"\x89PNG")
        assert page.text.count(picture["alt"]) == 1
    assert "<positioner> & co" in page.text
    assert page.text.count("not accepted") == 1
    assert [w for w in ("Name", "Date", "Signature", "Remarks") if w in page.text] == [
        "Name",
        "Date",
        "Signature",
        "Remarks",
    ]


def test_a_unit_that_was_not_measured_has_a_reason_and_no_picture(data):
    page = Page(acceptance_html(UnitVerdict(4, 0, (), "no reply <on the bus>"), data, {}))
    assert page.pictures == []
    assert "no reply <on the bus>" in page.text
    assert "Requirements" not in page.text
    assert "not accepted" in page.text


def test_the_pictures_show_the_units_own_data(pair, data, written):
    verdict = UnitVerdict(int(pair.positioner_id[1]), 1, CHECKS[:1], "")
    acceptance_html(verdict, data, {})
    gear, blind, repeat = written
    for panel, name in zip(gear.axes[:2], ("alpha", "beta"), strict=True):
        assert panel.get_title() == name
        assert panel.get_ylabel() == "δ [deg]"
        negative, positive = panel.lines
        # contacts 0.1 deg apart; the deviation is 0.2 deg at most
        np.testing.assert_allclose(positive.get_ydata() - negative.get_ydata(), 0.1, atol=1e-9)
        assert np.max(negative.get_ydata()) == pytest.approx(0.2, abs=0.002)
    for panel in gear.axes[2:]:
        assert (panel.get_xlabel(), panel.get_ylabel()) == ("θ [deg]", "hysteresis [deg]")
        np.testing.assert_allclose(panel.lines[0].get_ydata(), 0.1, atol=1e-9)
    left, right, bar = blind.axes
    *targets, rms, limit = left.lines
    assert len(targets) == 3
    np.testing.assert_allclose(rms.get_ydata(), np.sqrt((data.error_um[1] ** 2).mean(axis=0)))
    assert limit.get_label() == "requirement 5 µm"
    assert right.collections[0].get_offsets().shape == (3, 2)
    assert (right.get_xlabel(), bar.get_ylabel()) == ("x from the centre [mm]", "blind error [µm]")
    assert [len(panel.lines) for panel in repeat.axes] == [3, 3]
    assert repeat.axes[0].get_title() == "alpha, lever 20.0 mm: 0.800 ± 0.100 µm"


@pytest.mark.parametrize(
    ("check", "text"),
    [
        (Check("", None, None, 1.0, "µm"), "–"),
        (Check("", 3.0, None, 4.0, ""), "3"),
        (Check("", 0.123456, 0.0, 4.0, "mm"), "0.123 mm"),
        (Check("", 0.123456, 0.0123, 4.0, "mm"), "0.123 ± 0.012 mm"),
        (Check("", 123.456, 12.3, 4.0, "°"), "123 ± 12 °"),
    ],
)
def test_a_value_is_told_to_two_digits_of_its_error(check, text):
    assert found_text(check) == text


def test_records_of_a_unit_are_json_even_where_a_target_was_never_seen():
    checks = (Check("blind error, largest", float("inf"), None, 50.0, "µm"), CHECKS[0])
    verdict = UnitVerdict(12, 0, checks, "")
    record = json.loads(json.dumps(unit_record(verdict, "SN-7"), allow_nan=False))
    assert (record["accepted"], record["serial"], record["report"]) == (False, "SN-7", "acceptance-SN-7.html")
    assert page_name(verdict) == page_name(verdict, "../") == "acceptance-12.html"
    assert page_name(verdict, "a/b c") == "acceptance-a-b-c.html"
    assert record["checks"][0]["value"] is None
    assert [c["verdict"] for c in record["checks"]] == ["fail", "pass"]


def test_the_head_says_with_what_a_unit_was_measured(pair):
    verdict = UnitVerdict(int(pair.positioner_id[0]), 0, CHECKS, "")
    head = page_head(verdict, Paperwork(pair, 3, AcceptanceSettings(), 0.5), "1.2.3")
    assert head["Unit"] == f"positioner {verdict.positioner_id}, hole {pair.hole[0]}"
    assert head["Serial number"] == head["Engineer"] == BLANK
    assert "twin, seed 3" in head["Bench"]
    assert "0.5 µm rms" in head["Bench"]
    assert head["Procedure"].startswith("200 points per axis and direction; 20 targets of 5 moves")
    assert (head["Firmware"], head["Configuration"]) == ("1.2.3", pair.config_hash())
    signed = page_head(verdict, Paperwork(pair, 3, AcceptanceSettings(), 0.5, "SN-7", "A. B."), "1.2.3")
    assert (signed["Serial number"], signed["Engineer"]) == ("SN-7", "A. B.")


def parameter(**changes):
    return {
        "axis": "alpha",
        "parameter": "Coulomb <torque>",
        "factory": 12.0,
        "value": 13.4567,
        "standard_error": 0.05,
        "unit": "µNm",
        "low": 1.0,
        "high": 30.0,
        "verdict": "good",
        "reason": "",
        "provenance": "break-away",
        "origin": "bench",
    } | changes


UNIT = {
    "positioner_id": 9,
    "commissioned": False,
    "reasons": ["beta drag: 99 is above 30 & refused"],
    "parameters": [
        parameter(),
        parameter(parameter="drag", verdict="refused", reason="99 > 30", value=99.0, standard_error=None),
        parameter(parameter="gear", origin="factory", verdict="kept", value=None, low=None, high=None),
    ],
    "checks": [
        {"check": "drag, two ways", "value": 0.1, "unit": "1", "low": None, "high": 3.0, "verdict": "pass"},
        {"check": "scale", "value": None, "unit": "1", "low": 0.9, "high": None, "verdict": "not measured"},
    ],
    "host": {
        "l_alpha": {"value": 7.41234, "standard_error": 1e-4, "unit": "mm", "reason": "", "source": "arms"}
    },
}


def test_a_commissioning_page_parts_what_was_found_from_what_was_kept():
    text = commissioning_html(UNIT, {"Unit": 9})
    page = Page(text)
    first, second = text.split("Kept from the factory")
    assert "drag" in first
    assert "alpha gear" not in first
    assert "alpha gear" in second
    found = {row[0]: row[1:] for row in page.rows if row[0]}
    assert found["alpha Coulomb <torque>break-away"] == ["12", "13.46 ± 0.05 µNm", "1 … 30", "good"]
    assert found["alpha drag99 > 30"] == ["12", "99 µNm", "1 … 30", "refused"]
    assert found["drag, two ways"] == ["0.1", "≤ 3", "pass"]
    assert found["scale"] == ["–", "≥ 0.9", "not measured"]
    assert found["l_alphaarms"] == ["7.4123 ± 0.0001 mm"]
    assert "beta drag: 99 is above 30 & refused" in page.text
    assert "not commissioned" in page.text
    good = Page(commissioning_html(UNIT | {"commissioned": True, "reasons": []}, {}))
    assert "commissioned" in good.text
    assert "not commissioned" not in good.text


def test_limits_and_numbers_in_words():
    assert [limits_text(*p) for p in ((None, None), (1.0, None), (None, 2.5), (-1.0, 1.0))] == [
        "",
        "≥ 1",
        "≤ 2.5",
        "-1 … 1",
    ]
    assert number_text({"value": 1234.5678, "standard_error": 0.0}) == "1235"
    assert found_in_record({"value": 2.0, "unit": "1"}) == "2"


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (7.4, 1e-4, "7.4000 ± 0.0001"),
        (-11.2503243, 1.14e-4, "-11.2503 ± 0.0001"),
        (0.1101745, 0.0124, "0.11 ± 0.01"),
        (1.0, 0.096, "1.0 ± 0.1"),  # the error is rounded before its digit counts
        (335.103, 2.04, "335 ± 2"),
        (123.456, 12.3, "120 ± 10"),
        (0.001, 0.01, "0.00 ± 0.01"),
        (-0.001, 0.01, "0.00 ± 0.01"),
        (4.34525e-5, 1.3e-7, "(4.35 ± 0.01)e-05"),
        (-8.7e-10, 2.65e-12, "(-8.70 ± 0.03)e-10"),
        (9.9996e-6, 1e-8, "(1.000 ± 0.001)e-05"),
        (2e-7, 3e-6, "(0 ± 3)e-06"),
        (1.5e7, 2e4, "(1.500 ± 0.002)e+07"),
    ],
)
def test_a_value_and_its_error_have_the_same_decimals(value, error, text):
    assert number_text({"value": value, "standard_error": error}) == text
