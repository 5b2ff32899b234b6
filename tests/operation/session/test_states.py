"""The two tables of a session: every state, every command, every step."""

import pytest

from fiberloom.errors import InputError
from fiberloom.operation.session.states import (
    INSTEAD,
    LEGAL,
    NEXT,
    Deed,
    SessionState,
    Step,
    after,
    require_legal,
)

MOVING_DEEDS = {Deed.OBSERVE, Deed.CALIBRATE, Deed.PARK, Deed.HOME}


def test_every_command_and_every_state_has_a_row():
    assert set(LEGAL) == set(Deed)
    assert set(NEXT) == set(SessionState)


@pytest.mark.parametrize("deed", [Deed.STOP, Deed.STATUS, Deed.EXCLUDE, Deed.DOCTOR])
@pytest.mark.parametrize("state", list(SessionState))
def test_what_is_always_legal(deed, state):
    require_legal(deed, state, "cannet://a:1")


@pytest.mark.parametrize("deed", sorted(Deed))
@pytest.mark.parametrize("state", sorted(SessionState))
def test_a_wrong_command_names_the_state_and_what_to_do(deed, state):
    if state in LEGAL[deed]:
        return
    with pytest.raises(InputError) as told:
        require_legal(deed, state, "cannet://a:1", "collision of 4, 9")
    line = str(told.value)
    assert line.startswith(f"cannet://a:1 is {state} (collision of 4, 9): {deed} is not possible now; ")
    assert line.endswith(INSTEAD[state])
    assert "\n" not in line


@pytest.mark.parametrize("deed", sorted(MOVING_DEEDS))
def test_nothing_moves_in_a_locked_array_or_beside_another_motion(deed):
    for state in (SessionState.LOCKED, SessionState.MOVING, SessionState.LOOKING, SessionState.CONNECTING):
        assert state not in LEGAL[deed]
    assert SessionState.LOCKED in LEGAL[Deed.RECOVER]


def test_every_state_can_be_reached_and_left():
    reached, waiting = set(), [SessionState.OFF]
    while waiting:
        state = waiting.pop()
        reached.add(state)
        waiting += [s for s in NEXT[state].values() if s not in reached]
    assert reached == set(SessionState)
    assert all(set(steps.values()) - {state} for state, steps in NEXT.items())


AFTER_A_COLLISION = {SessionState.LOCKED, SessionState.RECOVERING}


def test_from_every_state_but_off_everything_can_be_stopped():
    for state in set(SessionState) - {SessionState.OFF} - AFTER_A_COLLISION:
        assert after(state, Step.STOP) is SessionState.STOPPED
        assert after(state, Step.COLLIDE) is SessionState.LOCKED


def test_a_locked_array_stays_locked_until_nothing_touches():
    for state in AFTER_A_COLLISION:
        assert {after(state, step) for step in NEXT[state]} <= AFTER_A_COLLISION | {SessionState.IDLE}
        assert {after(state, step) for step in (Step.STOP, Step.LOSE, Step.COLLIDE)} == {SessionState.LOCKED}
    ends = [step for state in AFTER_A_COLLISION for step, s in NEXT[state].items() if s is SessionState.IDLE]
    assert ends == [Step.FREE]


def test_no_motion_before_the_begin_check():
    moving = {SessionState.IDLE, SessionState.LOOKING, SessionState.RECOVERING}
    assert {s for s, steps in NEXT.items() if Step.MOVE in steps} == moving
    with pytest.raises(RuntimeError, match="that is unknown cannot move"):
        after(SessionState.UNKNOWN, Step.MOVE)
    with pytest.raises(RuntimeError, match="that is off cannot move"):
        after(SessionState.OFF, Step.MOVE)
