"""The trial of the health monitor: what its rows say, and that healthy units stay unsuspected."""

from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.health.monitor import Ailment, Finding, HealthMonitor, State
from fiberloom.studies import health
from fiberloom.studies.health import TrialSettings, health_trial
from fiberloom.twin.faults.ailments import AilmentModel

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


SOON = AilmentModel(rate_per_year=400.0, weights={"stuck": 1.0, "dark": 1.0, "slipping": 1.0})
"""Of twelve units some are ill from the start, and nearly all before the end of 180 moves."""


def test_what_ails_is_found_soon_after_it_began_and_by_its_name():
    rows = health_trial(range(12), 4, TrialSettings(fields=60, look_every=4, ailments=SOON))
    for kind, name in (("dark", "dark"), ("stuck", "stuck")):
        ill = (rows["truth"] == kind) & (rows["onset"] < 150)
        assert np.count_nonzero(ill) >= 3
        late = rows["found"][ill] - rows["onset"][ill]
        assert (late > 0).all()
        assert (late <= 12).all()  # moves from one look to the next
        assert set(rows["last"][ill]) == {name}
    slipping = rows["truth"] == "slipping"
    assert (rows["found"][slipping] >= rows["suspected"][slipping]).all()
    # of three that slip from the start not one ends unnamed
    assert (rows["found"][slipping] >= 0).all()
    assert not rows["false"].any()


class Alarmist(HealthMonitor):
    """Suspects the second unit, and is certain of the third, at every look."""

    forgotten: ClassVar[list[int]] = []

    def findings(self):
        ids = self.plane.positioner_id
        return [
            Finding(int(ids[1]), State.SUSPECT, Ailment.SCATTER, "", "", 0),
            Finding(int(ids[2]), State.DEGRADED, Ailment.TOOTH, "", "", 0),
        ]

    def forget(self, positioner_id):
        self.forgotten.append(positioner_id)


def test_a_false_alarm_is_counted_at_every_look_and_begun_anew(monkeypatch):
    monkeypatch.setattr(health, "HealthMonitor", Alarmist)
    Alarmist.forgotten.clear()
    rows = health_trial(range(4), 3, replace(SHORT, ailments=AilmentModel(rate_per_year=0.0)))
    looks = SHORT.fields // SHORT.look_every
    assert rows["false"].tolist() == [0, 0, looks, 0]
    assert rows["false_name"].tolist() == ["", "", "tooth", ""]
    assert (rows["found"] == -1).all()
    assert (rows["suspected"] == -1).all()
    assert len(Alarmist.forgotten) == looks
    assert len(set(Alarmist.forgotten)) == 1
