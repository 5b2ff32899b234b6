"""Motion only ever results from a valid sequence: any order of commands against a model of the protocol."""

import struct

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

import rig
from fiberloom._core import firmware as fw

ANGLE = st.floats(-10.0, 370.0)
MOVES = {20: b"", 22: b"", 23: b"", 26: b"", 28: b"", 31: rig.pair(0.3, -0.2), 47: b""}


class Sequences(RuleBasedStateMachine):
    """Knows what a host knows: what it asked and what was answered."""

    def __init__(self):
        super().__init__()
        self.rig = rig.Rig(noise_cnt=0.0)
        self.announced = None  # points of (alpha, beta) still to come
        self.loaded = False
        self.driven = False

    def ask(self, command, data=b"", **kwargs):
        return self.rig.code(command, data, **kwargs) == rig.ACCEPTED

    def forget(self):
        self.announced, self.loaded = None, False

    @rule(alpha=st.integers(0, 3), beta=st.integers(0, 3))
    def new(self, alpha, beta):
        if self.ask(10, struct.pack("<II", alpha, beta)):
            assert alpha > 0
            assert beta > 0
            self.announced, self.loaded = alpha + beta, False

    @rule(way=st.floats(-1.0, 1.0), tick=st.integers(0, 4000), axis=st.integers(0, 1))
    def add_point(self, way, tick, axis):
        if self.ask(11, rig.point(tick / rig.TICKS_PER_S, self.rig.position_deg[axis] + way)):
            assert self.announced
            self.announced -= 1

    @rule()
    def end(self):
        good = self.ask(12)
        assert not good or self.announced == 0
        self.announced, self.loaded = None, good or (self.loaded and self.announced is None)

    @rule(everybody=st.booleans())
    def start(self, everybody):
        if self.ask(14, to=0 if everybody else None):
            self.driven |= self.loaded
            self.forget()

    @rule(command=st.sampled_from(sorted(MOVES)))
    def move(self, command):
        if self.ask(command, MOVES[command]):
            self.driven = True
            self.forget()

    @rule(alpha=ANGLE, beta=ANGLE)
    def go_to(self, alpha, beta):
        if self.ask(30, rig.pair(alpha, beta)):
            assert -4.01 < min(alpha, beta) <= max(alpha, beta) < 364.01
            self.driven = True
            self.forget()

    @rule(command=st.sampled_from([13, 15]))
    def stop(self, command):
        assert self.ask(command)
        self.forget()
        assert self.rig.unit.duty(0) == self.rig.unit.duty(1) == (0, 0, 0)
        self.driven = False

    @rule(command=st.sampled_from([13, 15]), waiting=st.integers(0, 20))
    def stop_while_nothing_is_sent(self, command, waiting):
        """Whatever waits for the bus, a stop acts at once; its answer comes when the bus is free again."""
        self.rig.frames()
        self.rig.unit.mailbox_open = False
        for uid in range(waiting):
            self.rig.unit.receive(fw.encode_identifier(self.rig.number, 32, uid + 1))
        self.rig.unit.receive(fw.encode_identifier(self.rig.number, command, 63))
        self.forget()
        assert self.rig.unit.duty(0) == self.rig.unit.duty(1) == (0, 0, 0)
        self.driven = False
        self.rig.unit.mailbox_open = True
        self.rig.unit.tick()
        assert [reply[:3] for reply in self.rig.frames()][-1] == (command, 63, rig.ACCEPTED)

    @rule(command=st.integers(0, 255), data=st.binary(max_size=8))
    def anything(self, command, data):
        """Whatever is left moves nothing; 112 would leave a holding current on after a move."""
        moves = command in (30, 31) or 20 <= command <= 28 or 47 <= command <= 49 or command >= 245
        if not moves and command not in (10, 11, 12, 13, 14, 15, 112):
            self.ask(command, data)

    @precondition(lambda self: self.driven)
    @rule(ticks=st.integers(1, 300))
    def let_run(self, ticks):
        self.rig.unit.tick(ticks)
        if self.rig.unit.status >> rig.BIT["completed"] & 1:
            self.driven = False

    @precondition(lambda self: not self.driven)
    @rule(ticks=st.integers(1, 100))
    def wait(self, ticks):
        """What was stopped coasts; but nothing drives it."""
        for _ in range(ticks):
            self.rig.unit.tick()
            assert self.rig.unit.duty(0) == self.rig.unit.duty(1) == (0, 0, 0)

    @invariant()
    def no_current_without_a_sequence(self):
        if not self.driven:
            assert self.rig.unit.duty(0) == self.rig.unit.duty(1) == (0, 0, 0)


Sequences.TestCase.settings = settings(max_examples=40, stateful_step_count=40)
test_motion_only_results_from_a_valid_sequence = Sequences.TestCase
