"""A fibre that was dark and is seen again is well again, and is corrected; the record keeps both."""

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.operation.safety.seen import InARow, is_there
from fiberloom.store import Store
from fiberloom.targets import random_targets

PLANE = fl.FocalPlane.of("sdssv", seed=0, n=7)
VICTIM = int(PLANE.positioner_id[3])


@pytest.mark.parametrize(
    ("there", "well"),
    [([True], []), ([True, True], [0]), ([True, False, True], []), ([False, True, True], [0])],
)
def test_two_images_in_a_row_are_needed(there, well):
    lit = InARow(1)
    assert [lit.rows(np.array([True]), np.array([seen])).tolist() for seen in there][-1] == well


def test_what_is_not_seen_or_is_elsewhere_is_not_there():
    seen_mm = np.array([[0.1, 0.0], [0.3, 0.0], [np.nan, np.nan]])
    assert is_there(seen_mm, np.zeros((3, 2)), np.full(3, 0.2)).tolist() == [True, False, False]


def observed(folder, faults, corrections):
    field = fl.Field.twin(PLANE, seed=0, camera="noise", faults=faults)
    seen = field.run.observe(random_targets(PLANE, 40, seed=1), corrections, out=folder / "run")
    with Store.read(folder / "run" / "store.sqlite") as store:
        events = store.events(seen.about["run"])
    return seen.summary(), events["kind"][events["positioner_id"] == VICTIM].tolist()


@pytest.mark.parametrize(("corrections", "dark_s"), [(4, 20), (6, 33)])
def test_a_fibre_that_was_dark_for_a_while_ends_on_its_target(tmp_path, corrections, dark_s):
    """Dark from the begin on, its datum on record: it moves blind, and is corrected once it is seen twice."""
    summary, kinds = observed(tmp_path, f"dark=#{VICTIM}+{dark_s}", corrections)
    assert kinds.index("dark") < kinds.index("seen again")
    assert summary["faults"] == {}
    assert summary["n_within_requirement"] == summary["n_assigned"]


def test_one_that_stays_dark_is_told_at_the_end(tmp_path):
    summary, kinds = observed(tmp_path, f"dark=#{VICTIM}", 4)
    assert "seen again" not in kinds
    assert summary["faults"] == {"dark": [VICTIM]}


@pytest.mark.parametrize(("worse", "told"), [("lying", "lying"), ("dead", "dead")])
def test_one_that_was_dark_and_does_not_follow_either_is_told_so(tmp_path, worse, told):
    """While it is dark it is planned round where it reports: no more once it is seen elsewhere, or silent."""
    summary, kinds = observed(tmp_path, f"dark=#{VICTIM}+20,{worse}=#{VICTIM}@14", 4)
    assert kinds.index("dark") < kinds.index(told)
    assert summary["faults"] == {told: [VICTIM]}
