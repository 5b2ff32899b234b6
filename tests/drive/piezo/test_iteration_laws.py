"""What is sent to cobras: the published rule by hand, and what the learning law makes of what it sees."""

import numpy as np
import pytest

from fiberloom.drive.piezo import LearningLaw, LearningSettings, MotorMaps, SpeedScalingLaw, pulse_factor

CURVE_US = np.array([88.0, 72.0])
ALL = np.ones(2, dtype=bool)
SIGMA_DEG = np.full(2, 0.01)


def even_maps(step_deg=0.1):
    """A theta and a phi motor, steps alike everywhere."""
    return MotorMaps(np.full((2, 2, 40), step_deg), 10.0, np.array([[44.0, 44.0], [22.0, 22.0]]))


def test_the_published_rule_by_hand():
    law = SpeedScalingLaw(even_maps())
    at, goal = np.array([100.0, 50.0]), np.array([110.0, 49.0])
    first = law.command(at, goal, SIGMA_DEG, ALL)
    assert first.steps.tolist() == [100, -10]
    assert first.pulse_us.tolist() == [44.0, 22.0]
    # theta went 8 of 10 deg; phi had 10 steps only, which tell nothing
    second = law.command(np.array([108.0, 49.4]), goal, SIGMA_DEG, ALL)
    assert second.steps.tolist() == [20, -4]
    assert law.scale[0].tolist() == [1.0 + 0.25 * (10.0 / 8.0 - 1.0), 1.0]
    assert law.scale[1].tolist() == [1.0, 1.0]
    assert second.pulse_us.tolist() == [np.rint(44.0 * 1.0625), 22.0]


def test_the_scale_of_a_pulse_stays_within_its_range():
    law, at = SpeedScalingLaw(even_maps()), np.array([10.0, 10.0])
    for _ in range(12):
        law.command(at, at + 20.0, SIGMA_DEG, ALL)
        at = at + 0.3  # hardly moves
    assert np.all(law.scale[:, 0] == 2.0)
    assert np.all(law.scale[:, 1] == 1.0)


def test_who_is_not_active_gets_no_steps():
    for law in (SpeedScalingLaw(even_maps()), LearningLaw(even_maps(), CURVE_US)):
        sent = law.command(np.zeros(2), np.full(2, 30.0), SIGMA_DEG, np.array([True, False]))
        assert sent.steps[0] > 0 == sent.steps[1]


def test_no_move_has_more_steps_than_the_board_takes():
    law = SpeedScalingLaw(even_maps(0.01))
    assert law.command(np.zeros(2), np.full(2, 180.0), SIGMA_DEG, ALL).steps.tolist() == [2000, 2000]
    law = LearningLaw(even_maps(0.0005), CURVE_US)
    assert law.command(np.zeros(2), np.full(2, 180.0), SIGMA_DEG, ALL).steps.tolist() == [2000, 2000]


def test_a_way_of_too_many_steps_is_made_by_longer_pulses():
    """Maps of 0.02 deg per step: 100 deg are 5000 steps, of which a move has 2000, each 2.5 times as long."""
    law = LearningLaw(even_maps(0.02), CURVE_US, LearningSettings(gain=1.0))
    sent = law.command(np.zeros(2), np.full(2, 100.0), SIGMA_DEG, ALL)
    longer = pulse_factor(sent.pulse_us, law.maps.pulse_us[:, 0], CURVE_US)
    assert longer == pytest.approx(2.5, rel=0.05)  # whole us: steps of 5 % at most
    assert sent.steps * longer == pytest.approx([5000.0, 5000.0], rel=0.05)
    # but by none that makes steps longer than those of the fast maps
    law.place_deg = None
    far = law.command(np.zeros(2), np.full(2, 350.0), SIGMA_DEG, ALL)
    longer = pulse_factor(far.pulse_us, law.maps.pulse_us[:, 0], CURVE_US)
    assert longer == pytest.approx(6.0, rel=0.05)


def driven(law, gain, moves, goal_deg=(60.0, 70.0)):
    """Angles after some moves of motors that go `gain` times what the map says, without any scatter."""
    at = np.array([20.0, 20.0])
    for _ in range(moves):
        sent = law.command(at, np.array(goal_deg), np.full(2, 1e-4), ALL)
        factor = pulse_factor(sent.pulse_us, law.maps.pulse_us[:, 0], CURVE_US)
        at = at + gain * law.maps.way_deg(at, sent.steps * factor)
    return at


def test_a_lasting_gain_is_learned():
    law = LearningLaw(even_maps(), CURVE_US)
    gain = np.array([0.7, 1.2])
    off = []
    for _ in range(6):
        law.place_deg = None  # from the same place once more
        driven(law, gain, 2)
        off.append(np.abs(law.gain[:, 0] / gain - 1.0).max())
    assert off[0] < 0.15
    assert off[5] < 0.02
    # nothing was seen of the way back
    assert np.all(law.gain[:, 1] == law.settings.gain)


def test_last_steps_are_shorter_than_a_usual_one():
    at = driven(LearningLaw(even_maps(), CURVE_US), np.array([0.9, 1.1]), 5)
    assert np.abs(at - [60.0, 70.0]).max() < 0.02  # a usual step is 0.1 deg


def test_a_motor_that_scatters_is_believed_less():
    quiet, wild = LearningLaw(even_maps(), CURVE_US), LearningLaw(even_maps(), CURVE_US)
    rng = np.random.default_rng(0)
    for law, scatter in ((quiet, 0.02), (wild, 0.6)):
        for _ in range(30):
            at = np.array([100.0, 100.0])
            law.place_deg = None
            sent = law.command(at, at + 20.0, SIGMA_DEG, ALL)
            law.see(at + sent.steps * 0.1 * (1.0 + scatter * rng.standard_normal(2)), SIGMA_DEG)
    assert np.all(wild.scatter.variance > 9.0 * quiet.scatter.variance)


def test_places_are_filtered():
    """A motor that stands and is seen again and again is known better than by one image."""
    rng, law = np.random.default_rng(1), LearningLaw(even_maps(), CURVE_US)
    true = np.array([50.0, 60.0])
    for _ in range(25):
        law.command(true + 0.01 * rng.standard_normal(2), true, SIGMA_DEG, np.zeros(2, dtype=bool))
    assert np.sqrt(law.place_variance) == pytest.approx([0.002, 0.002], rel=0.05)
    assert np.abs(law.place_deg - true).max() < 0.006


def test_a_wild_motor_aims_at_what_leaves_least_and_others_go_the_whole_way():
    """By trial: of all parts of a way that a motor of this scatter may aim at, none leaves less."""
    law = LearningLaw(even_maps(), CURVE_US)
    law.believe(np.array([100.0, 100.0]), np.zeros(2))
    law.trust_maps(np.array([0.05, 0.8]), ALL)
    scatter2, way = law.scatter.variance[1], np.array([10.0, -10.0])
    parts = np.linspace(0.0, 1.5, 1501)
    best = parts[((1.0 - parts) ** 2 + parts**2 * scatter2).argmin()]
    assert 0.5 < best < 0.8
    assert law.aimed_deg(way) == pytest.approx([10.0, -10.0 * best], abs=0.01)


def test_a_motor_that_is_not_known_yet_goes_the_whole_way():
    law = LearningLaw(even_maps(), CURVE_US)
    law.believe(np.array([100.0, 100.0]), np.zeros(2))
    assert law.aimed_deg(np.array([10.0, -10.0])).tolist() == [10.0, -10.0]
