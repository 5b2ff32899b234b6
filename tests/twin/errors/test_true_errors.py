"""The benchmark of what errors of the tables do, and what calibrations leave of it: small, but in full."""

from argparse import Namespace

import pytest
from benchmarks.true_errors import GOAL_UM, met, of_seed, said

ROW = {"fibres": 19, "rms_um": 1.2, "p95_um": 2.0, "worst_um": 4.9, "within": 19, "absolute_rms_um": 2.5}


@pytest.mark.slow
def test_calibrations_remove_what_each_error_does():
    given = Namespace(positioners=19, size=1.0, camera="noise", gears="stages", only_calibrated=False)
    rows = {row["row"]: row for row in of_seed(0, given)}
    none, everything, calibrated = rows["none"], rows["all on"], rows["all on, calibrated"]
    assert none["rms_um"] < 1.0
    assert rows["fibre on"]["rms_um"] > 7.0
    assert everything["rms_um"] > 7.0
    assert calibrated["rms_um"] < 2.0
    assert calibrated["within"] == calibrated["fibres"] == none["fibres"]


@pytest.mark.parametrize(
    ("change", "reached"),
    [({}, True), ({"rms_um": GOAL_UM + 0.01}, False), ({"within": 18}, False), ({"fibres": 0}, False)],
)
def test_the_goal_is_missed_by_one_fibre_or_by_the_rms_of_one_seed(change, reached):
    assert met([ROW, ROW | change]) is reached


def test_a_line_has_a_figure_for_each_seed():
    line = said("all on", [ROW, ROW | {"rms_um": 13.456}])
    assert "rms   1.20  13.46" in line
    assert "19/19 19/19" in line
