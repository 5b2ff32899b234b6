"""What the figures of the lifetime test make of a study that is made up: numbers and curves are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from fiberloom.studies.lifetime import DELTAS, WAYS
from fiberloom.studies.paper import Settings
from fiberloom.studies.paper.lifetime import fig21_arms as fig21
from fiberloom.studies.paper.lifetime import fig22_wear as fig22
from fiberloom.studies.paper.lifetime import fig25_adaptive as fig25
from fiberloom.studies.paper.lifetime import fig26_blind as fig26
from fiberloom.studies.paper.lifetime import wearing

ANGLES = np.linspace(0.0, 180.0, 181)
CYCLES = wearing.DEFAULT.simulated
KEPT = wearing.DEFAULT.kept
UNITS = 4


def mark_deg(share):
    """A mark of wear of 0.15 deg, of which a share is known."""
    return share * 0.15 * np.exp(-(((ANGLES - 90.0) / 10.0) ** 2))


@pytest.fixture
def study(monkeypatch):
    """Wear that grows with the snapshots; the improved estimator follows all of it, Eq. 33 half."""
    delta = np.zeros((UNITS, len(KEPT), len(DELTAS), 2, len(ANGLES)))
    known = {"true": 1.0, "recalibrated": 1.0, "adaptive": 1.0, "adaptive_paper": 0.5}
    for name, share in known.items():
        for place in range(len(KEPT)):
            delta[:, place, DELTAS.index(name), 1] = mark_deg(share * place / (len(KEPT) - 1))
    true = np.full((UNITS, len(CYCLES), 2), 7.4) + 1e-4 * np.arange(len(CYCLES))[None, :, None]
    measured = np.zeros((UNITS, len(WAYS), len(CYCLES)))
    measured += 10.0 + np.arange(len(WAYS))[None, :, None]
    rows = {"delta_deg": delta, "arms_mm": true + 2e-4, "true_arms_mm": true, "measured_um": measured}
    asked, on_teeth = [], {}

    def made(seed, settings):
        asked.append((seed, settings))
        worse = on_teeth if settings.gears == "teeth" else {}
        um = measured * np.array([worse.get(way, 1.0) for way in WAYS])[None, :, None]
        return wearing.Study(wearing.DEFAULT, ANGLES, rows | {"measured_um": um})

    monkeypatch.setattr(wearing, "study", made)
    return SimpleNamespace(asked=asked, on_teeth=on_teeth)


def made(figure, full=False):
    said = []
    outcome = figure.run(Settings(seed=2, n_seeds=2, full=full, say=said.append))
    number = int(figure.__name__.rpartition("fig")[2][:2])
    assert said[:2] == [f"Figure {number}: lifetime test, seed {seed}" for seed in (2, 3)]
    assert bool(outcome.smaller) != full
    return {q.id: q.ours for q in outcome.quantities}


@pytest.mark.parametrize("full", [False, True])
def test_the_size_of_the_test_is_asked_for_and_told(study, written, full):
    made(fig22, full)
    assert study.asked == [(seed, wearing.FULL if full else wearing.DEFAULT) for seed in (2, 3)]


def test_figure_21_shows_two_units_with_two_arms_each(study, written):
    found = made(fig21)
    assert found["fig21.span_um"] == pytest.approx(0.1 * (len(CYCLES) - 1))
    assert found["fig21.calibration_um"] == pytest.approx(0.2)
    (axes,) = written[0].axes
    assert len(axes.lines) == 8
    true, seen = axes.lines[:2]
    assert true.get_ydata()[0] == 0.0
    np.testing.assert_allclose(seen.get_ydata() - true.get_ydata(), 0.2, atol=1e-9)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("cycle", "change of length [µm]")


def test_figure_22_shows_every_snapshot(study, written):
    assert made(fig22)["fig22.largest_change_deg"] == pytest.approx(0.15)
    panels = written[0].axes
    assert [p.get_title() for p in panels] == ["unit 1", "unit 2"]
    for panel in panels:
        assert [line.get_label() for line in panel.lines] == [f"cycle {c}" for c in KEPT]
        assert panel.get_ylabel() == "δ of beta [deg]"
    assert panels[1].get_xlabel() == "θ [deg]"


def test_figure_25_tells_the_share_that_was_followed(study, written):
    found = made(fig25)
    assert found["fig25.followed"] == pytest.approx(0.5)
    assert found["fig25.followed_inside"] == pytest.approx(0.5)
    assert found["fig25.adaptive.followed"] == pytest.approx(1.0)
    assert found["fig25.adaptive.error_mdeg"] == pytest.approx(0.0, abs=1e-6)
    assert found["fig25.adaptive_paper.error_mdeg"] > 1.0
    panels = written[0].axes
    assert panels[1].get_title() == f"cycle {KEPT[-1]}"
    for panel in panels:
        assert panel.lines[-1].get_label() == "true"
        assert len(panel.lines) == 1 + len(fig25.NAMES)
    np.testing.assert_allclose(panels[1].lines[-1].get_ydata(), mark_deg(1.0), atol=1e-12)


def test_figure_26_shows_every_way_with_its_rms(study, written):
    found = made(fig26)
    expected = {way: 10.0 + k for k, way in enumerate(WAYS)}
    assert [s.gears for _, s in study.asked] == ["stages", "stages", "teeth", "teeth"]
    ratio = expected["adaptive"] / expected["recalibrated_fine"]
    assert found["fig26.adaptive_over_fine"] == pytest.approx(ratio)
    (axes,) = written[0].axes
    assert len(axes.lines) == len(fig26.CURVES)
    for way, line in zip(fig26.CURVES, axes.lines, strict=True):
        np.testing.assert_allclose(line.get_ydata(), expected[way])
        np.testing.assert_array_equal(line.get_xdata(), CYCLES)
    assert axes.get_ylabel() == "blind error, rms [µm]"


@pytest.mark.parametrize(("factor", "share"), [(1.0, 0.0), (1.25, 0.5), (2.0, 0.0)])
def test_figure_26_slightly_worse_is_neither_better_nor_much_worse(study, written, factor, share):
    """Eq. 33 leaves 12 against 14 of recalibrating; with the second spectrum 12, 15 or 24."""
    study.on_teeth["adaptive_paper"] = factor
    assert made(fig26)["fig26.order.adaptive_paper_slightly_worse"] == share


def test_figure_26_orders_the_others(study, written):
    """As made up: linear 10, fixed 11, Eq. 33 12."""
    study.on_teeth.update(linear=2.0, fixed=1.2)
    found = made(fig26)
    assert found["fig26.order.linear_worst"] == 0.5
    assert found["fig26.order.adaptive_paper_better_than_fixed"] == 0.5
