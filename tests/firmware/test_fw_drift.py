"""Positions survive: random moves and power cuts lose no turn and no count.

`make check` makes 10 000 moves of it (FIBERLOOM_DRIFT_MOVES).
"""

import os

import numpy as np

from rig import COUNTS_PER_DEG, MOTOR_DEG, Rig

MOVES = int(os.environ.get("FIBERLOOM_DRIFT_MOVES", "400"))
LIMITS_DEG = (1.0, 350.0)
# hall noise of 2 counts in 1500 is 0.08 motor deg rms, and a rotor stands within 0.5 of its target
OFF_MOTOR_DEG = 1.0


def next_target(position_deg, rng):
    """Mostly a degree or so away, sometimes anywhere within a quarter turn."""
    step = rng.normal(0.0, 1.5, 2) if rng.random() < 0.97 else rng.uniform(-90.0, 90.0, 2)
    return np.clip(np.array(position_deg) + step, *LIMITS_DEG)


def cut_power(unit, true_deg):
    """Off and on at rest: restored, and the sensor tells the angle within the turn anew."""
    unit.unit.power_up()
    assert unit.status("restored", "estimated") == (True, False)
    assert unit.true_deg() == true_deg


def test_random_moves_do_not_drift():
    rng = np.random.default_rng(11)
    unit = Rig(position_deg=(170.0, 170.0))
    errors = []
    for move in range(MOVES):
        unit.unit.tick(20)  # the rotor stands
        if move % 50 == 49:
            cut_power(unit, unit.true_deg())
        assert unit.goto(*next_target(unit.position_deg, rng)) == 0
        unit.wait()
        counted = np.array(unit.unit.position_cnt)
        errors.append(counted - np.array(unit.true_deg()) * COUNTS_PER_DEG)
    assert not unit.unsolicited
    off = np.array(errors) / MOTOR_DEG
    assert np.abs(off).max() < OFF_MOTOR_DEG
    # no trend: ends of the run differ by what noise lets them
    part = max(MOVES // 5, 1)
    drift = off[-part:].mean(axis=0) - off[:part].mean(axis=0)
    assert np.abs(drift).max() < 5.0 * off.std() * np.sqrt(2.0 / part)


def test_a_power_cut_in_motion_among_random_moves_says_that_it_guesses():
    rng = np.random.default_rng(12)
    unit = Rig(position_deg=(170.0, 170.0))
    for _ in range(10):
        assert unit.goto(*next_target(unit.position_deg, rng)) == 0
        unit.unit.tick(int(rng.integers(60, 200)))
        unit.unit.power_up()
        assert unit.status("restored", "estimated", "datum_alpha") == (False, True, False)
        unit.unit.tick(400)
        unit.unit.declare_position()  # as the datum search would
        unit.unit.tick(10)
