"""What a calibration of the twin's arms is held against."""

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.twin.source import TwinSource


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
