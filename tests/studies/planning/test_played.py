"""`benchmarks.planning.played`: plans that the firmware of the twin carries out, and what counts as good."""

from argparse import Namespace
from types import SimpleNamespace

import numpy as np
from benchmarks.planning.played import __main__ as command

from fiberloom.planning import Plan, Trajectory


def asked(folder, **more):
    given = {"pairs": 1, "first_seed": 0, "buffer": 2.0, "array": "hexagon 7", "out": folder}
    return Namespace(**(given | more))


def test_a_pair_is_played_once_without_a_contact(tmp_path, monkeypatch, capsys):
    assert command.run(asked(tmp_path)) == 0
    said = capsys.readouterr()
    assert "| hexagon 7 | 2 | 1 of 1 | 7 | 0 | 0 | 0 | 0.0" in said.out
    assert said.err.startswith("pair 0: 0 contacts")
    monkeypatch.setattr(command, "one_pair", straight)  # kept: not played again
    assert command.run(asked(tmp_path)) == 0


def straight(plane, start_deg, goal_deg, **settings):
    """With no regard to others: all arms stretched towards the middle on the way."""
    middle_deg = np.column_stack(
        [np.rad2deg(np.arctan2(*-plane.centres_mm.T[::-1])) % 360.0, np.zeros(plane.n)]
    )
    robots = tuple(
        Trajectory(int(number), np.array([0.0, 60.0, 120.0]), *np.array(way).T)
        for number, *way in zip(plane.positioner_id, start_deg, middle_deg, goal_deg, strict=True)
    )
    return Plan(plane.instrument.name, 2.0, robots)


def test_contacts_are_those_of_the_twin_and_no_success(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(command, "plan", straight)
    monkeypatch.setattr(command, "verify", lambda *_, **__: SimpleNamespace(ok=True))
    assert command.run(asked(tmp_path)) == 1
    cells = [cell.strip() for cell in capsys.readouterr().out.splitlines()[-1].split("|")]
    assert int(cells[7]) > 0


def test_a_plan_that_is_not_verified_is_not_sent(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(command, "plan", straight)
    monkeypatch.setattr(command, "carried_out", None)
    assert command.run(asked(tmp_path)) == 1
    said = capsys.readouterr()
    assert "not verified; not sent" in said.err
    assert "| 0 of 1 | 0 |" in said.out
