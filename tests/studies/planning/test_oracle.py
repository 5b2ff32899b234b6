"""The oracle finds what touches, and the mutants show a verifier that is wrong by hundredths of a mm."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.planning import mutants, pairs
from benchmarks.planning.bodies import Bodies, between, to_segment
from benchmarks.planning.goals import Verdict
from benchmarks.planning.oracle import Answer, Scene, answer, least_gap

from fiberloom.planning import Plan, Trajectory, verify

NONE = np.zeros((0, 5))
STOPS_DEG = np.array([[-4.0, 364.0], [-4.0, 364.0]])
APART_MM = 44.0
"""Two stretched arms that point at each other end 44 - 2 * 22.1276 + 2 * 2 mm of buffers from touching."""


def two(apart_mm: float = APART_MM, obstacles=NONE) -> Bodies:
    arms = np.array([0.0, apart_mm], dtype=complex), np.full(2, 7.4), np.zeros(2), np.zeros(2)
    return Bodies(np.array([1, 2]), *arms, (0.0, 14.7276), obstacles, STOPS_DEG)


def scene(bodies, *motions) -> Scene:
    robots = [Trajectory(k + 1, *np.array(m, dtype=float).T) for k, m in enumerate(motions)]
    return Scene.of(bodies, Plan("sdssv", 2.0, tuple(robots)), 10.0)


def passing(beta_deg: float) -> list[tuple[float, float, float]]:
    """Sweeps by the direction of the other within a thousandth of a second, away from any sample."""
    return [(0, 90, beta_deg), (3.0207, 4, beta_deg), (3.0217, -4, beta_deg), (6, -90, beta_deg)]


def test_distances_of_segments():
    p, q = np.array([0j]), np.array([10 + 0j])
    assert to_segment(np.array([5 + 3j]), p, q) == pytest.approx([3.0])
    assert to_segment(np.array([13 + 4j]), p, q) == pytest.approx([5.0])
    assert between(p, q, np.array([4 - 1j]), np.array([4 + 1j])) == [0.0]
    assert between(p, q, np.array([4 + 1j]), np.array([4 + 7j])) == pytest.approx([1.0])
    assert between(p, q, np.array([11 - 1j]), np.array([11 + 1j])) == pytest.approx([1.0])


@pytest.mark.parametrize(
    ("off_mm", "sure"), [(-1e-5, Answer.TOUCH), (1e-5, Answer.CLEAR), (-1e-6, Answer.OPEN)]
)
def test_a_short_and_shallow_touch_is_found(off_mm, sure):
    """Both stretched and in line at one moment; the centres are set so that they just touch then."""
    bodies = two(2 * (7.4 + 14.7276) + 4.0 + off_mm)
    found = scene(bodies, passing(0.0), [(0.0, 180.0, 0.0)])
    assert answer(found, [0]) == sure
    assert least_gap(found, [0], 1e-7) == pytest.approx(off_mm, abs=2e-7)


def test_an_obstacle_is_a_body_and_who_rests_does_not_collide():
    disc = np.array([[7.4, 16.0, 7.4, 16.0, 3.0]])
    turn = [(0.0, 0.0, 0.0), (1.0, 0.0, 90.0)]
    rest = [(0.0, 180.0, 180.0)]
    assert answer(scene(two(100.0, disc), turn, rest), [0, 1]) == Answer.TOUCH
    assert answer(scene(two(100.0), turn, rest), [0, 1]) == Answer.CLEAR
    overlapping = scene(two(30.0, disc), [(0.0, 0.0, 0.0)], [(0.0, 180.0, 0.0)])
    assert answer(overlapping, [0, 1]) == Answer.CLEAR  # contacts of bodies at rest are not a plan's fault


def of_a_plan(tmp_path, monkeypatch, plain=12, grazing=6):
    monkeypatch.setattr(mutants, "EACH", plain)
    monkeypatch.setattr(mutants, "GRAZING_EACH", grazing)
    return mutants.of_one_plan(tmp_path, True, True, 1, tmp_path / "log")


def test_the_verifier_agrees_with_the_oracle(tmp_path, monkeypatch):
    line = of_a_plan(tmp_path, monkeypatch)
    assert (line["missed"], line["false"], line["open"]) == (0, 0, 0)
    assert (line["mutants"], line["grazing"]) == (18, 6)
    assert 0 < line["touch"] < 18
    assert line["plan"] == Answer.CLEAR
    assert not (tmp_path / "wrong").exists()


@pytest.mark.parametrize(("off_mm", "wrong"), [(-0.05, "missed"), (0.05, "false")])
def test_a_verifier_with_another_buffer_is_found_out(tmp_path, monkeypatch, off_mm, wrong):
    def off(plane, made):
        limits = replace(pairs.ANY, collision_buffer_mm=made.collision_buffer_mm + off_mm)
        return verify(plane, made, limits=limits)

    monkeypatch.setattr(pairs, "clear", off)
    line = of_a_plan(tmp_path, monkeypatch, plain=0, grazing=8)
    assert line[wrong] > 0
    assert len(list((tmp_path / "wrong").iterdir())) == line[wrong]


def told(**found):
    numbers = {"mutants": mutants.MUTANTS + mutants.GRAZING, "grazing": mutants.GRAZING, "touch": 10}
    return [{"seed": 0, "missed": 0, "false": 0, "open": 0} | numbers | found]


def test_verdicts_of_the_mutants():
    asked = None
    good, one, few = told(), told(missed=1), told(mutants=100)
    assert [cell.verdict for cell in mutants.cells(good, asked)] == [Verdict.MET] * 3
    assert mutants.cells(one, asked)[0].verdict == Verdict.MISSED
    assert {cell.verdict for cell in mutants.cells(few, asked)} == {Verdict.FEW}
    assert mutants.cells(told(open=100), asked)[2].verdict == Verdict.MISSED
    assert {cell.verdict for cell in mutants.cells(told(hang=True), asked)} == {Verdict.MISSED}


@pytest.mark.parametrize("kind", [kind for kind in mutants.KINDS if kind != "swapped"])
def test_mutants_are_trajectories_that_differ(kind):
    robot = Trajectory(3, *np.array([(0.0, 10.0, 90.0), (2.0, 20.0, 80.0), (4.0, 15.0, 70.0)]).T)
    other = mutants.changed(robot, kind, 0.3, complex(0.6, 0.8))
    assert other.time_s[0] == 0.0
    assert (np.diff(other.time_s) > 0.0).all()
    assert other.time_s.shape == other.alpha_deg.shape == other.beta_deg.shape
    when_s = np.linspace(0.0, 4.0, 9)
    assert np.abs(other.at(when_s) - robot.at(when_s)).max() > 0.1
