"""The truth of a twin: what a calibration is held against, and whether it is kinder than reality."""

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.targets import random_targets
from fiberloom.twin.source import KIND, TwinSource


def test_the_true_layout_has_the_true_fibres():
    plane = fl.FocalPlane.of("sdssv", n=7)
    source = TwinSource(plane, 0, "noise", "", "arm,fibre")
    true, here = source.true_plane, source.hardware.truth
    park = plane.park_deg
    for fibre in ("metrology", "BOSS"):
        at = true.forward(park[:, 0], park[:, 1], fibre)
        assert np.hypot(*(at - here.fibre_xy(fibre)).T).max() < 0.03  # the gears' own errors, folded
    assert np.abs(true.l_beta_mm - plane.l_beta_mm).max() > 0.003
    assert true.l_beta_mm - plane.l_beta_mm == pytest.approx(source.units.beta_longer_mm, abs=1e-6)


@pytest.mark.parametrize(
    ("errors", "kind"),
    [("none", True), ("gears=family", True), ("air", False), ("fibre=0.1", False), ("all", False)],
)
def test_a_twin_that_is_kinder_than_reality_says_so(errors, kind):
    plane = fl.FocalPlane.of("sdssv", n=7)
    assert ("notes" in TwinSource(plane, 0, "noise", "", errors).about()) is kind


def test_an_observation_on_a_kind_twin_notes_it(tmp_path):
    plane = fl.FocalPlane.of("sdssv", n=7)
    field = fl.Field.twin(plane, 0, camera="noise")
    summary = field.run.observe(random_targets(plane, 100, 1), 0, out=tmp_path).summary()
    assert summary["notes"][-1] == KIND
    assert "put_in" in summary
