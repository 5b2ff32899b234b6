"""The supervisor's table, for all states x inputs x conditions."""

import itertools

import pytest

import rig
from fiberloom._core import firmware as fw
from rig import ACCEPTED

S, INPUT, C = fw.STATES, fw.INPUTS, fw.CONDITIONS
RESTING = ("IDLE", "LOADING", "LOADED", "REFUSED")
TRAVELLING = ("MOVING", "STOPPING")
CALIBRATING = ("HOMING", "HALL_CALIBRATION", "DATUM_CALIBRATION", "COGGING_CALIBRATION")
ACTIVE = TRAVELLING + CALIBRATING
INSIDE = ("DONE", "COLLISION", "BAD_TRAJECTORY")
MOTION = ("GOTO", "HOME", "CALIBRATE_HALL", "CALIBRATE_DATUM", "CALIBRATE_COGGING", "START")
AT_REST_ONLY = (*MOTION, "NEW", "POINT", "END", "SETTING")
CONDITIONS = [sum(c) for n in range(6) for c in itertools.combinations(C.values(), n)]


def ask(state, name, conditions=0):
    following, code = fw.supervisor(S[state], INPUT[name], conditions)
    return {v: k for k, v in S.items()}[following], code


def every(states=S, inputs=INPUT, conditions=CONDITIONS):
    return itertools.product(states, inputs, conditions)


def test_a_refusal_never_changes_the_state():
    for state, name, conditions in every():
        following, code = ask(state, name, conditions)
        assert code == ACCEPTED or following == state, (state, name, conditions)


def test_motion_begins_only_at_rest_and_only_by_commands_of_motion():
    for state, name, conditions in every():
        following, _ = ask(state, name, conditions)
        if following in ACTIVE and state not in ACTIVE:
            assert state in RESTING
            assert name in MOTION
            assert not conditions & (C["COLLIDED"] | C["BAD_PARAMETERS"])


def test_a_trajectory_needs_new_points_end_start_in_that_order():
    assert ask("IDLE", "NEW") == ("LOADING", ACCEPTED)
    assert ask("LOADING", "POINT") == ("LOADING", ACCEPTED)
    assert ask("LOADING", "END") == ("LOADED", ACCEPTED)
    assert ask("LOADED", "START") == ("MOVING", ACCEPTED)
    # nothing else leads to LOADED, nothing but START leads from it into motion along the path
    for state, name, conditions in every():
        if ask(state, name, conditions)[0] == "LOADED" and state != "LOADED":
            assert (state, name) == ("LOADING", "END")


@pytest.mark.parametrize("state", RESTING)
@pytest.mark.parametrize("name", ["POINT", "END"])
def test_points_out_of_sequence_are_invalid(state, name):
    if state != "LOADING":
        assert ask(state, name) == (state, rig.INVALID_TRAJECTORY)


def test_start_without_a_trajectory_is_accepted_and_moves_nothing():
    for conditions in (0, C["DATUM_UNKNOWN"], C["HALL_UNCALIBRATED"]):
        assert ask("IDLE", "START", conditions) == ("IDLE", ACCEPTED)
    assert ask("REFUSED", "START") == ("REFUSED", rig.INVALID_TRAJECTORY)
    assert ask("LOADING", "START") == ("LOADING", rig.INVALID_TRAJECTORY)


def test_stop_is_accepted_in_every_state_but_the_bootloader():
    for state, conditions in itertools.product(S, CONDITIONS):
        following, code = ask(state, "STOP", conditions)
        if state == "BOOTLOADER":
            assert code == rig.INVALID_BOOTLOADER
        else:
            assert code == ACCEPTED
            assert following == ("STOPPING" if state in ACTIVE else "IDLE")


def test_nothing_else_while_something_moves():
    for state, name, conditions in every(ACTIVE, AT_REST_ONLY):
        code = rig.CALIBRATING if state in CALIBRATING else rig.IN_MOTION
        assert ask(state, name, conditions) == (state, code)


def test_a_collision_must_be_cleared_before_anything_moves():
    for state, name in itertools.product(RESTING, (*MOTION, "NEW")):
        assert ask(state, name, C["COLLIDED"]) == (state, rig.COLLISION)
    assert ask("IDLE", "SETTING", C["COLLIDED"]) == ("IDLE", ACCEPTED)


@pytest.mark.parametrize(
    ("condition", "name", "code"),
    [
        ("HALL_UNCALIBRATED", "GOTO", rig.MOTOR_NOT_CALIBRATED),
        ("HALL_UNCALIBRATED", "NEW", rig.MOTOR_NOT_CALIBRATED),
        ("HALL_UNCALIBRATED", "HOME", rig.MOTOR_NOT_CALIBRATED),
        ("HALL_UNCALIBRATED", "CALIBRATE_HALL", ACCEPTED),
        ("DATUM_UNCALIBRATED", "HOME", rig.DATUM_NOT_CALIBRATED),
        ("DATUM_UNCALIBRATED", "CALIBRATE_DATUM", ACCEPTED),
        ("DATUM_UNKNOWN", "GOTO", rig.NOT_INITIALIZED),
        ("DATUM_UNKNOWN", "NEW", rig.NOT_INITIALIZED),
        ("DATUM_UNKNOWN", "CALIBRATE_COGGING", rig.NOT_INITIALIZED),
        ("DATUM_UNKNOWN", "HOME", ACCEPTED),
        ("BAD_PARAMETERS", "GOTO", rig.INVALID),
        ("BAD_PARAMETERS", "CALIBRATE_HALL", rig.INVALID),
    ],
)
def test_what_must_be_known_before(condition, name, code):
    assert ask("IDLE", name, C[condition])[1] == code


def test_the_loaded_trajectory_needs_the_datum_still():
    assert ask("LOADED", "START", C["DATUM_UNKNOWN"]) == ("LOADED", rig.NOT_INITIALIZED)


def test_events_from_inside():
    for state, conditions in itertools.product(S, CONDITIONS):
        for name in INSIDE:
            if state != "BOOTLOADER":
                assert ask(state, name, conditions)[1] == ACCEPTED
        assert ask(state, "DONE", conditions)[0] == ("IDLE" if state in ACTIVE else state)
        assert ask(state, "COLLISION", conditions)[0] == ("STOPPING" if state in ACTIVE else state)
    assert ask("LOADING", "BAD_TRAJECTORY")[0] == "REFUSED"


def test_the_bootloader_knows_its_own_commands_only():
    for name, conditions in itertools.product(INPUT, CONDITIONS):
        code = ACCEPTED if name in ("BOOT", "QUERY") else rig.INVALID_BOOTLOADER
        assert ask("BOOTLOADER", name, conditions) == ("BOOTLOADER", code)
    for state in set(S) - {"BOOTLOADER"}:
        assert ask(state, "BOOT") == (state, rig.INVALID)
        assert ask(state, "IMPOSSIBLE") == (state, rig.INVALID)
        assert ask(state, "QUERY") == (state, ACCEPTED)
