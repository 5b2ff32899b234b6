"""Wheels are made by every Python that is promised, and what fails or is missing is said."""

import sys

import pytest

from tools.setup import wheels


@pytest.fixture
def folder(tmp_path):
    return str(tmp_path / "out")


def test_the_promised_pythons_are_those_of_the_builder():
    assert wheels.promised() == ["3.11", "3.12", "3.13"]


def test_a_python_is_found_by_its_version(tmp_path, monkeypatch):
    ours = f"{sys.version_info[0]}.{sys.version_info[1]}"
    place = tmp_path / ".pyenv" / "versions" / f"{ours}.99" / "bin"
    place.mkdir(parents=True)
    (place / "python").symlink_to(sys.executable)
    monkeypatch.setenv("PATH", "")
    assert wheels.found(ours, home=tmp_path) == str(place / "python")
    assert wheels.found("3.2", home=tmp_path) is None


def test_one_that_is_missing_is_named(folder, monkeypatch, capsys):
    monkeypatch.setattr(wheels, "found", lambda version: None if version == "3.13" else sys.executable)
    monkeypatch.setattr(wheels, "made", lambda python, out: "a.whl: manylinux_2_35; fiberloom 0.1.0")
    assert wheels.main([folder]) == 0
    said = capsys.readouterr().out
    assert "Python 3.13: not found here" in said
    assert said.count("a.whl") == 2
    monkeypatch.setattr(wheels, "found", lambda version: None)
    assert wheels.main([folder]) == 1


def test_one_that_fails_is_an_exit_code(folder, capsys):
    assert wheels.main([folder, "/no/such/python"]) == 1
    assert "/no/such/python: No such file" in capsys.readouterr().err


def test_what_a_program_said_is_in_the_error():
    with pytest.raises(wheels.WheelError, match=r"exit code 3\nit broke"):
        wheels.run(sys.executable, "-c", "print('it broke'); raise SystemExit(3)")
