"""Progress: a line for each stage and now and then one where no terminal is; a bar where one is."""

import io

import pytest

from fiberloom.cli import terminal
from fiberloom.cli.terminal import Lines, waiting
from fiberloom.instruments import generate, load_instrument
from fiberloom.planning import random_pair, write_configuration


def test_lines_come_with_each_stage_and_not_too_often():
    now, said = [0.0], []
    lines = Lines(said.append, every_s=10.0, clock_s=lambda: now[0])
    lines.say("calibrating")
    lines.say("calibrating")
    for done in range(1, 31):
        now[0] += 1.0
        lines.count(done, 30)
    lines.say("moving")
    lines.count(1, 3)
    assert said == ["calibrating\n", *(f"calibrating: {k} of 30\n" for k in (10, 20, 30)), "moving\n"]


def test_quiet_says_nothing(capsys):
    with waiting(quiet=True) as wait:
        wait.say("moving")
        wait.count(1, 2)
    assert capsys.readouterr() == ("", "")


def test_lines_go_to_stderr(capsys):
    with waiting() as wait:
        wait.say("moving")
    assert capsys.readouterr() == ("", "moving\n")


@pytest.mark.parametrize("words", [("measuring", 3, 4)])
def test_a_terminal_gets_a_bar_with_counts(monkeypatch, words):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    screen = Terminal()
    monkeypatch.setattr(terminal.sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    text, done, total = words
    with waiting() as wait:
        wait.say(text)
        wait.count(done, total)
    assert text in screen.getvalue()
    assert f"{done} of {total}" in screen.getvalue()


def test_plan_counts_while_it_plans(fl, monkeypatch, tmp_path):
    # a line for each count
    monkeypatch.setattr(Lines.__init__, "__defaults__", (0.0, *Lines.__init__.__defaults__[1:]))
    plane = generate(load_instrument("sdssv"), 0, n_positioners=37)
    for name, angles in zip(("start.csv", "goal.csv"), random_pair(plane, 3), strict=True):
        write_configuration(tmp_path / name, plane.positioner_id, angles)
    words = ("--start", tmp_path / "start.csv", "--goal", tmp_path / "goal.csv", "--out", tmp_path / "t.json")
    code, _, err = fl("plan", *words, "--positioners", 37)
    assert code == 0
    lines = err.splitlines()
    assert "finding paths: 37 of 37" in lines
    assert next(line for line in lines if line.startswith("finding paths: ")) == "finding paths: 1 of 37"
    assert "straightening paths: 37 of 37" in lines
    assert any(line.startswith("parting paths that meet: ") for line in lines)
    assert lines[-1] == "verifying them in continuous time"
    assert fl("plan", *words, "--positioners", 37, "--json")[2] == ""
