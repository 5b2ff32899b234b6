"""Which lateness of one positioner a plan bears: the proof against dense samples in numpy."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fields import SDSSV, field
from late_oracle import LateOracle

from fiberloom.errors import InputError
from fiberloom.instruments import generate
from fiberloom.planning import Plan, Trajectory, plan, random_pair, verify, verify_late

CASES = [(7, 0), (7, 1), (13, 2)]
STEP_S = 0.1


@cache
def planned(n: int, seed: int) -> Plan:
    return plan(field(n), *random_pair(field(n), seed), seed=seed)


@cache
def oracle(n: int, seed: int) -> LateOracle:
    return LateOracle(field(n), planned(n, seed), STEP_S)


@pytest.mark.parametrize(("n", "seed"), CASES)
def test_no_sample_touches_at_a_lateness_that_a_pair_is_said_to_bear(n, seed):
    found = {(p.late_id, p.other_id): p.bears_s for p in verify_late(field(n), planned(n, seed)).touching}
    names, said = field(n).positioner_id, []
    for late, other in oracle(n, seed).pairs():
        bears_s = found.get((int(names[late]), int(names[other])), np.inf)
        by_samples_s = oracle(n, seed).bears_s(late, other)
        assert by_samples_s >= bears_s
        said.append(by_samples_s - bears_s if np.isfinite(bears_s) else 0.0)
    assert found
    print(f"\n{len(found)} orders touch, found by samples up to {max(said):.2f} s later")
    assert np.median(said) < STEP_S


@pytest.mark.parametrize(("n", "seed"), CASES)
def test_a_millisecond_more_than_a_pair_bears_makes_it_touch(n, seed):
    plane = field(n)
    for pair in verify_late(plane, planned(n, seed), 0.0).touching:
        late, other = plane.index_of([pair.late_id, pair.other_id])
        assert 0.0 <= pair.other_at_s - pair.late_at_s - pair.bears_s <= 1.0001e-3
        assert oracle(n, seed).gap_at_mm(late, other, pair.late_at_s, pair.other_at_s) < 0.0


@pytest.mark.parametrize("late_s", [0.7, 2.0, np.inf])
@pytest.mark.parametrize(("n", "seed"), CASES)
def test_the_deepest_moment_is_the_deepest_of_the_samples(n, seed, late_s):
    plane, names = field(n), field(n).positioner_id
    checked = verify_late(plane, planned(n, seed), late_s)
    found = {(p.late_id, p.other_id): p for p in checked.failing}
    for late, other in oracle(n, seed).pairs():
        pair = found.get((int(names[late]), int(names[other])))
        least = oracle(n, seed).gaps_mm(late, other, late_s)[0].min()
        assert (least >= 0.0) if pair is None else (-least <= pair.depth_mm + 0.01 + 1e-9)
        if pair is None:
            continue
        at = oracle(n, seed).gap_at_mm(late, other, pair.late_at_s, pair.other_at_s)
        assert at == pytest.approx(-pair.depth_mm, abs=1e-9)
        assert -1e-9 <= pair.other_at_s - pair.late_at_s <= late_s + 1e-9


def test_who_is_on_time_touches_nobody():
    for n, seed in CASES:
        assert verify(field(n), planned(n, seed)).ok
        checked = verify_late(field(n), planned(n, seed), 0.0)
        assert checked.ok
        assert checked.failing_pairs == ()


def two(times: tuple[float, ...], alphas: tuple[float, ...], other: tuple[float, ...]) -> Plan:
    """Two neighbours with folded arms but for alpha: straight lines, so that lateness can be told by hand."""
    plane = pair_plane()
    beta = np.full(len(times), 0.0)
    robots = [
        Trajectory(int(plane.positioner_id[k]), np.array(times), np.array(alpha, dtype=float), beta)
        for k, alpha in enumerate((alphas, other))
    ]
    return Plan("sdssv", 2.0, tuple(robots))


@cache
def pair_plane():
    return replace(generate(SDSSV, 0, n_positioners=2), fiducials=np.zeros((0, 3)))


def towards_deg(row: int) -> float:
    """Alpha of a stretched arm that points at the other positioner."""
    plane = pair_plane()
    dx, dy = plane.centres_mm[1 - row] - plane.centres_mm[row]
    return float(np.degrees(np.arctan2(dy, dx) - plane.arms[row, 3] - plane.arms[row, 4]) % 360.0)


def test_one_that_leaves_before_the_other_comes_is_late_by_the_time_between():
    """The first sweeps out of the middle from 0 s to 5 s; the other comes into it from 8 s to 13 s."""
    first, second = towards_deg(0), towards_deg(1)
    times = (0.0, 5.0, 8.0, 13.0)
    made = two(times, (first, first + 60.0, first + 60.0, first + 60.0), (second + 60.0,) * 3 + (second,))
    plane = pair_plane()
    checked = verify_late(plane, made)
    assert verify(plane, made).collisions == ()
    names = plane.positioner_id
    assert [(p.late_id, p.other_id) for p in checked.touching] == [(int(names[0]), int(names[1]))]
    samples = LateOracle(plane, made, 0.05)
    assert checked.bears_s == pytest.approx(samples.bears_s(0, 1), abs=0.06)
    assert 3.0 < checked.bears_s < 13.0
    later = replace(made, robots=(made.robots[0], shifted(made.robots[1], 2.0)))
    assert verify_late(plane, later).bears_s == pytest.approx(checked.bears_s + 2.0, abs=2e-3)


def shifted(robot: Trajectory, by_s: float) -> Trajectory:
    times = np.concatenate([[0.0], robot.time_s[1:] + by_s])
    return replace(robot, time_s=times)


def test_what_rests_is_no_matter():
    first, second = towards_deg(0), towards_deg(1)
    made = two((0.0, 5.0), (first + 60.0, first + 90.0), (second, second))
    assert verify_late(pair_plane(), made).touching == ()
    assert verify_late(pair_plane(), made).n_pairs == 0


@pytest.mark.parametrize("late_s", [-1.0, np.nan])
def test_a_lateness_that_is_none(late_s):
    with pytest.raises(InputError, match="late_s"):
        verify_late(field(7), planned(7, 0), late_s)


def test_times_that_do_not_rise_are_refused():
    robot = planned(7, 0).robots[0]
    broken = replace(robot, time_s=robot.time_s[::-1])
    with pytest.raises(InputError, match="times must rise"):
        verify_late(field(7), replace(planned(7, 0), robots=(broken, *planned(7, 0).robots[1:])))


def test_it_says_which_and_where():
    checked = verify_late(field(13), planned(13, 3), 1.0)
    worst = checked.failing[0]
    assert f"positioner {worst.late_id} meets {worst.other_id}" in str(checked)
    assert f"in all pairs but {len(checked.failing_pairs)} of {checked.n_pairs}" in str(checked)
    assert "of up to 1 s" in str(checked)
