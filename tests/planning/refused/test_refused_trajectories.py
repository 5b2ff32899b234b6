"""Files of trajectories that are JSON of another kind, and angles of another shape."""

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.planning.bodies import angles_rad, travel_rad
from fiberloom.planning.trajectories import read_plans


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[1, 2]", "a JSON object is expected, found list"),
        ('{"plans": [3]}', r"plans\[0\]: a JSON object is expected"),
        ('{"plans": 3}', "'plans' has the wrong type"),
        ('{"plans": [{}]}', "it has nothing"),
        ("{", "line 1, column 2: not JSON"),
    ],
)
def test_another_kind_of_json_is_told(tmp_path, text, words):
    path = tmp_path / "t.json"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as refused:
        read_plans(path)
    assert str(path) in str(refused.value)


def test_bytes_that_are_no_text_are_told(tmp_path):
    (tmp_path / "t.json").write_bytes(b"\xff\xfe\xfa")
    with pytest.raises(InputError, match="not a text file"):
        read_plans(tmp_path / "t.json")


def test_angles_need_a_row_for_each_positioner(patch):
    with pytest.raises(InputError, match=r"start: shape \(3, 2\), 37 positioners need \(37, 2\)"):
        angles_rad("start", np.zeros((3, 2)), patch)
    bad = np.zeros((37, 2))
    bad[4, 1] = np.nan
    with pytest.raises(InputError, match=f"goal: positioner {patch.positioner_id[4]} has"):
        angles_rad("goal", bad, patch)
    np.testing.assert_allclose(angles_rad("goal", np.full((37, 2), 180.0), patch), np.pi)


def test_travel_holds_every_target_with_its_approach(patch):
    travel = np.rad2deg(travel_rad(patch))
    range_deg = patch.limits_deg
    approach = [axis.approach_deg for axis in patch.instrument.axes]
    assert (travel[:, 0] <= range_deg[:, 0]).all()
    assert (travel[:, 1] >= range_deg[:, 1] + approach).all()
