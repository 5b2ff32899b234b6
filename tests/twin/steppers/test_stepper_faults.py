"""The table of failures of the steppers: what is told, what is not, and when the command says so."""

import pytest
from benchmarks.faults import steppers as stepper_faults
from benchmarks.faults.steppers import FaultField


def test_the_table_of_one_instrument(capsys, monkeypatch):
    kept = [one for one in stepper_faults.FAILURES if one.name in ("none", "lost steps", "dark fibres")]
    monkeypatch.setattr(stepper_faults, "FAILURES", tuple(kept))
    assert stepper_faults.main(["--units", "12", "--instrument", "megara"]) == 0
    none, lost, dark = capsys.readouterr().out.splitlines()[2:]
    assert none.startswith("| megara | none | - |")
    assert "(`slipping=2`) | 2 of 2: dead 2 |" in lost
    assert "(`dark=2`) | 0 of 2 |" in dark  # no camera looks
    assert all(line.split(" | ")[5] == "0" for line in (none, lost, dark))


@pytest.mark.parametrize(
    ("faults", "blind", "named", "contacts", "wrong"),
    [
        ("dead=1", True, {"dead": [3]}, 0, False),
        ("dead=1", True, {}, 0, True),
        ("dark=1", True, {}, 0, False),
        ("dark=1", False, {}, 0, True),
        ("dead=1", True, {"dead": [3]}, 1, True),
    ],
)
def test_a_line_is_wrong_where_arms_touched_or_a_fault_is_not_told(faults, blind, named, contacts, wrong):
    found = FaultField({3}, named, 9, 9, contacts, 0, blind)
    assert found.missed(stepper_faults.Failure("one", faults)) == wrong
