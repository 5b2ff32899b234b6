"""Hours that a list takes: lists whose answer is plain, and bounds."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fiberloom.design.survey import HoursSettings, survey_time
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.targets import write_targets
from fiberloom.targets.generate import random_targets

PFS = load_instrument("pfs")
ONE, SEVEN = (generate(PFS, 0, n_positioners=n) for n in (1, 7))


def around_one(n):
    """Targets of a single unit: however the list is turned, it reaches all of them."""
    targets = random_targets(ONE, n, seed=1)
    angle = 2.0 * np.pi * np.arange(n) / n
    x_mm, y_mm = (ONE.centres_mm + 2.5 * np.column_stack([np.cos(angle), np.sin(angle)])).T
    return replace(targets, x_mm=x_mm, y_mm=y_mm)


@pytest.mark.parametrize(("visits", "share", "exposures"), [(1, 1.0, 3.0), (2, 1.0, 6.0), (1, 0.5, 1.5)])
def test_one_unit_makes_one_visit_in_each_exposure(visits, share, exposures):
    settings = HoursSettings(visits=visits, share=share, exposure_s=840.0, most=8)
    found = survey_time(ONE, around_one(3), settings)
    assert found.exposures == pytest.approx(exposures)
    assert found.exposures_error == pytest.approx(0.0, abs=1e-12)
    assert settings.hours(found.exposures) == pytest.approx(exposures * 900.0 / 3600.0)
    assert found.reachable == 1.0
    assert [one.done for one in found.steps] == pytest.approx(
        [k / (3.0 * visits) for k in range(1, len(found.steps) + 1)]
    )
    assert all(one.used == pytest.approx(1.0) for one in found.steps)


def test_no_exposure_makes_more_visits_than_there_are_fibres():
    targets = random_targets(SEVEN, 30, seed=2)
    found = survey_time(SEVEN, targets, HoursSettings(share=1.0, most=3, turns=2))
    assert found.exposures is None
    done = np.array([one.done for one in found.steps])
    assert (np.diff(done) > 0.0).all()
    assert (done <= 7.0 * np.arange(1, 4) / (30.0 * found.reachable) + 1e-9).all()
    assert found.steps[0].done == pytest.approx(7.0 * found.steps[0].used / (30.0 * found.reachable), rel=0.1)


def test_the_command_tells_hours_or_that_they_do_not_do(fl, tmp_path):
    file = tmp_path / "list.csv"
    write_targets(around_one(3), file)
    words = ("--targets", file, "--positioners", 1)
    code, said, _ = fl("design", "survey", "pfs", *words, "--share", 1, "--json")
    found = json.loads(said)
    assert code == 0
    assert found["survey"]["hours"] == pytest.approx(3 * 960.0 / 3600.0)
    assert [row["exposures"] for row in found["steps"]] == [1, 2, 3]
    code, said, _ = fl("design", "survey", "pfs", *words, "--share", 1, "--most", 2)
    assert code == 1
    assert "not within 2 exposures" in said


def test_bad_input_says_what_would_do(fl, tmp_path):
    for asked, says in (
        ({"visits": 0}, "0 visits"),
        ({"share": 1.5}, "share 1.5"),
        ({"exposure_s": 0.0}, "exposures of 0 s"),
        ({"most": 99}, "up to 40"),
    ):
        with pytest.raises(InputError, match=says):
            HoursSettings(**asked)
    far = replace(around_one(2), x_mm=np.array([500.0, 600.0]))
    with pytest.raises(InputError, match="no fibre of pfs reaches"):
        survey_time(ONE, far, HoursSettings())
    empty = tmp_path / "empty.csv"
    empty.write_text("target_id,x_mm,y_mm\n")
    code, _, said = fl("design", "survey", "pfs", "--targets", empty)
    assert code == 2
    assert "empty" in said or "no target" in said
    code, _, said = fl("design", "survey", "pfs", "--targets", tmp_path / "nowhere.csv")
    assert code == 2
    assert "nowhere.csv" in said
