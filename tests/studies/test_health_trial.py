"""The trial of the health monitor: what its rows say, and that healthy units stay unsuspected."""

from dataclasses import replace

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.studies.health import TrialSettings, health_trial

SHORT = TrialSettings(fields=30, look_every=5)
COLUMNS = {"truth", "suspected", "found", "false", "named", "last", "false_name", "onset", "healthy_moves"}


@pytest.mark.parametrize("name", ["fields", "look_every"])
def test_a_trial_needs_fields_and_looks(name):
    with pytest.raises(InputError, match=f"health trial: {name} = 0, must be at least 1"):
        replace(SHORT, **{name: 0})


def test_a_row_for_each_unit_and_the_same_from_the_same_seed():
    first, again = (health_trial(range(6), 3, SHORT) for _ in range(2))
    assert set(first) == COLUMNS
    assert all(len(rows) == 6 for rows in first.values())
    for name in COLUMNS:
        np.testing.assert_array_equal(first[name], again[name])
    moves = SHORT.fields * (1 + SHORT.corrections)
    ill = first["truth"] != ""
    assert (first["onset"][~ill] == -1).all()
    assert (first["healthy_moves"][~ill] == moves).all()
    assert (first["onset"][ill] == first["healthy_moves"][ill]).all()
    # nothing is found of what has not begun
    for name in ("suspected", "found"):
        seen = first[name] >= 0
        assert (first[name][seen] >= first["healthy_moves"][seen]).all()
    assert ((first["named"] != "") == (first["found"] >= 0)).all()
