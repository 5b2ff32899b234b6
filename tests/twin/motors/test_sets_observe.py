"""A whole observation with each set of motors: maps, assignment, a blind move and corrections."""

from importlib.resources import files

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.targets import random_targets
from fiberloom.twin.motors.sets import MOTOR_SETS
from fiberloom.units import AXES

OF_AXIS = {axis: [name for name, motor in MOTOR_SETS.items() if axis in motor.axes] for axis in AXES}
PAIRS = [(alpha, beta) for alpha in OF_AXIS["alpha"] for beta in OF_AXIS["beta"]]
SDSSV = files("fiberloom.instruments.presets").joinpath("sdssv.toml").read_text()
TABLES = '\n[twin.alpha]\nmotor = "{}"\n\n[twin.beta]\nmotor = "{}"\n'
SETTLED = 2.0
"""After two corrections the true rms is below the camera's noise times this, before them it is above."""


def test_there_is_a_choice():
    assert set(PAIRS) > {("paper", "paper"), ("10mm", "paper"), ("13mm", "6mm")}


@pytest.mark.slow
@pytest.mark.parametrize(("alpha", "beta"), PAIRS)
def test_all_fibres_arrive(alpha, beta, tmp_path):
    """The instrument is chosen as an operator does it: by a file of its own."""
    own = tmp_path / "own.toml"
    own.write_text(SDSSV + TABLES.format(alpha, beta))
    plane = fl.FocalPlane.of(own, n=7)
    field = fl.Field.twin(plane, 0, camera="noise")
    seen = field.run.observe(random_targets(plane, 140, 1), corrections=2, out=tmp_path)
    summary = seen.summary()
    for axis, name in (("alpha", alpha), ("beta", beta)):
        assert (f"motor of {axis}" in summary["put_in"]) == (name != "paper")
    assert summary["faults"] == {}
    assert not any(move.interrupted for move in seen.moves)
    true_um = seen.true_error_um(seen.final)
    assert np.isfinite(true_um).sum() == len(plane)
    assert true_um.max() < seen.requirement_um
    blind_um, last_um = (summary["moves"][k]["true_rms_um"] for k in (0, -1))
    assert last_um < SETTLED * plane.instrument.metrology.noise_rms_um < blind_um
