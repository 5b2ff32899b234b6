"""Of what the errors of the science fibres are made: parts that add up, each by the error that was put in."""

from dataclasses import replace

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.operation.results.budget import EXPECTED, IN_TRUTH, budget
from fiberloom.report.tables import budget_line
from fiberloom.targets.generate import random_targets


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """By the errors that are put in: a field after two corrections."""

    def observed(errors):
        plane = fl.FocalPlane.of("sdssv", n=19)
        field = fl.Field.twin(plane, camera="noise", errors=errors)
        targets = random_targets(plane, 40, 1)
        return field.run.observe(targets, corrections=2, out=tmp_path_factory.mktemp("run"))

    return {errors: observed(errors) for errors in ("none", "fibre", "fiducial=3")}


def test_with_right_tables_all_is_the_loops_and_the_cameras(seen):
    found = budget(seen["none"])
    assert found["known"] == IN_TRUTH
    assert found["fibre_um"] < 0.4  # the direction of the arm, as far as the maps know it
    assert 0.3 < found["camera_um"] < 1.5
    assert found["science_um"] == pytest.approx(seen["none"].summary()["moves"][-1]["true_rms_um"])


def test_an_error_shows_in_its_part_alone(seen):
    right, fibre, frame = (budget(seen[errors]) for errors in ("none", "fibre", "fiducial=3"))
    assert fibre["fibre_um"] > 8.0
    assert fibre["camera_um"] == pytest.approx(right["camera_um"], rel=0.5)
    assert frame["camera_um"] > 3.0
    assert frame["fibre_um"] == pytest.approx(right["fibre_um"], abs=0.2)
    assert frame["guider_takes_um"] > right["guider_takes_um"]


def test_on_hardware_the_parts_are_what_images_and_calibrations_tell(seen):
    true = seen["none"]
    noise = np.tile(0.49e-6 * np.eye(2), (19, 1, 1))
    last = true.moves[-1]
    move = replace(
        last, true_mm=None, true_metrology_mm=None, measurement=replace(last.measurement, noise_mm2=noise)
    )
    hardware = replace(true, moves=[*true.moves[:-1], move])
    found = budget(hardware)
    assert found["known"] == EXPECTED
    assert found["camera_um"] == pytest.approx(0.7 * np.sqrt(2.0))
    assert (found["fibre_um"], found["science_um"]) == (None, None)
    assert found["loop_um"] == pytest.approx(budget(true)["loop_um"])
    known = replace(hardware, about=true.about | {"fibre_calibration": {"formal_um": 0.8}})
    assert budget(known)["fibre_um"] == 0.8


def test_the_line_names_what_is_not_known(seen):
    found = budget(seen["fibre"])
    assert f"fibre on its arm {found['fibre_um']:.2f}" in budget_line(found)
    unknown = found | {"known": EXPECTED, "fibre_um": None, "guider_takes_um": None}
    assert "fibre on its arm not known" in budget_line(unknown)
    assert "guider" not in budget_line(unknown)
