"""Neighbours driven into each other on the twin: how soon both are off, and the torque on them.

Pairs of neighbours far from each other share a twin. In each meeting the axes that move do so at full speed
when the arms touch for the first time. What is told of it, from the last moment at which they were
still apart (the twin looks every 2 ms): when a positioner stopped, by its own watch or because the
host, told of a collision by frame 18, stopped every positioner; and the torque that the contact put on
each axis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fiberloom._core import geometry
from fiberloom.bus.identifier import decode, encode
from fiberloom.bus.protocol import Command
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import BODY_SHARE
from fiberloom.studies.legal_moves import FULL_SPEED_DEG_S, go_to, greased
from fiberloom.twin.draw import draw_units
from fiberloom.twin.twin import Twin
from fiberloom.typing import Floats, Ints, Records
from fiberloom.units import GEAR, TICK_S, deg_to_rad

KINDS: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {
    "both, both axes": ((1, 1), (1, 1)),
    "both, alpha": ((1, 0), (1, 0)),
    "both, beta": ((0, 1), (0, 1)),
    "one, both axes": ((1, 1), (0, 0)),
    "one, alpha": ((1, 0), (0, 0)),
    "one, beta": ((0, 1), (0, 0)),
}
"""Which axes move at full speed when two neighbours meet: (alpha, beta) of the first and of the second."""

SYNC_S = 0.002
THREADS = 2
"""Of the twin; what it finds does not depend on them."""
_RUN_UP_S = (0.7, 2.5)  # after the start: full speed is reached, the gaps are closed
_CLEAR_MM = 0.5  # before that
_MIDDLE_DEG = 180.0


@dataclass(frozen=True)
class Stop:
    """How one positioner that moved stopped after its arm had touched another."""

    positioner_id: int
    own_s: float
    """From the last moment apart to its own frame 18; infinite if its watch said nothing."""
    stopped_s: float
    """To the moment its phases went off: by its own watch, or by the host's stop."""
    torque_Nm: tuple[float, float]
    """Largest torque of the contact on its alpha and beta arm."""
    load_rate_Nm_s: tuple[float, float]
    """How fast the load on each motor grew in the first 8 ms; negative where it helps the motion."""

    @property
    def head_on(self) -> bool:
        """The contact resists one of its motors, not only pushes it from behind."""
        return max(self.load_rate_Nm_s) > 0.0


@dataclass(frozen=True)
class Meeting:
    """Two neighbours that met."""

    kind: str
    stops: list[Stop]
    """Of those that moved."""


def isolated_pairs(plane: FocalPlane) -> Ints:
    """(P, 2) rows of neighbours, no two pairs within reach of each other."""
    apart_mm = 2.0 * (plane.l_alpha_mm.max() + plane.beta_segment_mm[1] + plane.collision_buffer_mm)
    distance = np.linalg.norm(plane.centres_mm[:, None] - plane.centres_mm[None], axis=2)
    pitch = np.min(distance[distance > 0.0])
    pairs: list[tuple[int, int]] = []
    for i, j in np.argwhere(np.triu(distance < 1.05 * pitch, 1)):
        taken = [k for pair in pairs for k in pair]
        if not taken or distance[np.ix_([i, j], taken)].min() > apart_mm:
            pairs.append((int(i), int(j)))
    return np.array(pairs)


def pairs_of(plane: FocalPlane, pairs: Ints) -> FocalPlane:
    """These positioners alone, nothing else to bump into."""
    part = plane.select(pairs.ravel())
    return replace(part, fiducials=np.zeros((0, 3)), guide_cameras=np.zeros((0, 5)))


def _gap_mm(plane: FocalPlane, rows: Ints, angles_deg: Floats) -> Floats:
    """Free way between two real arms for paths (T, 2, 2) of both."""
    arms = plane.arms[rows]
    segments = [
        geometry.beta_segment(
            np.repeat(arms[k : k + 1], len(angles_deg), axis=0),
            *plane.beta_segment_mm,
            np.ascontiguousarray(deg_to_rad(angles_deg[:, k])),
        )
        for k in (0, 1)
    ]
    return geometry.segment_distance(*segments) - 2.0 * BODY_SHARE * plane.collision_buffer_mm


def plan_meeting(plane: FocalPlane, rows: Ints, kind: str, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Start (2, 2) and goal (2, 2) in deg so that the two meet at full speed, `_RUN_UP_S` after the
    start.

    `rows` (2,) of the pair in the `plane`; `kind`: which axes of which positioner move; `rng` draws the
    place.
    """
    moves = np.array(KINDS[kind], dtype=float)
    time_s = np.arange(0.0, _RUN_UP_S[1], 0.01)
    for _ in range(100_000):
        start = np.column_stack([rng.uniform(30.0, 330.0, 2), rng.uniform(5.0, 175.0, 2)])
        sense = rng.choice([-1.0, 1.0], (2, 2)) * moves
        path = start + sense * (FULL_SPEED_DEG_S * np.maximum(time_s - 0.125, 0.0))[:, None, None]
        gap = _gap_mm(plane, rows, path)
        meets = np.flatnonzero(gap < 0.0)
        if not len(meets) or not _RUN_UP_S[0] < time_s[meets[0]] or gap[: meets[0] // 2].min() < _CLEAR_MM:
            continue
        goal = start + sense * 60.0
        if (np.abs(goal - _MIDDLE_DEG) < 175.0).all():
            return start, goal
    raise RuntimeError(f"no meeting of kind {kind!r} found")


def meetings(
    plane: FocalPlane,
    kind: str,
    *,
    seed: int,
    host_s: float | None = None,
    touch: bool = True,
    law: int = 0,
) -> list[Meeting]:
    """One meeting of every isolated pair of the `plane`, units and temperatures drawn from the `seed`.

    `kind`: which axes of which positioner move; `host_s`: time from a frame 18 until the host's stop
    (13) reaches the other; None without a host. Without `touch` Eq. 22 and the contact rule watch
    alone. `law`: the control law of all axes (0 or 1, docs/firmware.md).
    """
    rng = np.random.default_rng([seed, 0x3EE7, list(KINDS).index(kind)])
    pairs = isolated_pairs(plane)
    part = pairs_of(plane, pairs)
    units = greased(draw_units(part, seed), rng)
    units.firmware["law"] = law
    if not touch:
        units.firmware["touch_torque"] = 0.0
    plans = [plan_meeting(part, np.array([2 * k, 2 * k + 1]), kind, rng) for k in range(len(pairs))]
    start = np.concatenate([p[0] for p in plans])
    twin = Twin(part, units, seed=seed, threads=THREADS, start_deg=start)
    return _Meetings(twin, kind, host_s).run(np.concatenate([p[1] for p in plans]))


class _Meetings:
    """Runs the pairs of a twin into each other, with a host that listens every millisecond."""

    def __init__(self, twin: Twin, kind: str, host_s: float | None) -> None:
        self.twin, self.kind, self.host_s, self.start = twin, kind, host_s, twin.truth()
        self.ids = [int(i) for i in twin.plane.positioner_id]
        self.scopes = [[twin.scope(row, axis) for axis in (0, 1)] for row in range(len(self.ids))]
        self.touched: dict[int, float] = {}
        self.own: dict[int, float] = {}
        self.told: dict[int, float] = {}

    def run(self, goals_deg: Floats) -> list[Meeting]:
        """The meetings whose arms did touch."""
        moves = np.tile(np.array(KINDS[self.kind]), (len(self.ids) // 2, 1))
        for row, number in enumerate(self.ids):
            if moves[row].any():
                go_to(self.twin, number, self._wire_deg(row, goals_deg[row], moves[row]))
        while self.twin.time_s < _RUN_UP_S[1] + 1.0:
            self._step()
        logs = [[scope.take() for scope in row] for row in self.scopes]
        return [self._meeting(k, moves, logs) for k in range(len(self.ids) // 2) if 2 * k in self.touched]

    def _wire_deg(self, row: int, goal_deg: Floats, moves: Ints) -> list[float]:
        """An axis that is to stay gets its present wire position."""
        here = [self.twin.units.transmission(row, k, self.start[row, k])[0][0] for k in (0, 1)]
        return [float(goal_deg[k] if moves[k] else here[k]) for k in (0, 1)]

    def _step(self) -> None:
        for reply in self.twin.run(0.001):
            identifier = decode(reply.id)
            if identifier.command == Command.COLLISION_DETECTED:
                self.own.setdefault(self.ids.index(identifier.positioner), reply.time_s)
        for touch in self.twin.touches():
            row = self.ids.index(touch.positioner_id) & ~1
            self.touched.setdefault(row, touch.time_s - SYNC_S)
        self._stop_others()

    def _stop_others(self) -> None:
        if self.host_s is None:
            return
        for row, since_s in list(self.own.items()):
            other = row ^ 1
            if self.twin.time_s >= since_s + self.host_s and other not in self.told:
                self.told[other] = self.twin.time_s
                self.twin.send([(encode(self.ids[other], Command.SEND_TRAJECTORY_ABORT, 1), b"")])

    def _meeting(self, pair: int, moves: Ints, logs: list[list[Records]]) -> Meeting:
        rows = [row for row in (2 * pair, 2 * pair + 1) if moves[row].any()]
        return Meeting(self.kind, [self._stop(row, self.touched[2 * pair], logs[row]) for row in rows])

    def _stop(self, row: int, touched_s: float, logs: list[Records]) -> Stop:
        own = self.own.get(row, np.inf)
        stopped = min(own, self.told.get(row, np.inf))
        seen = logs[0]["time_s"] <= stopped + 0.02
        torque = [float(np.abs(log["torque_out_Nm"][seen]).max()) for log in logs]
        rates = [_load_rate_Nm_s(log, touched_s) for log in logs]
        return Stop(
            self.ids[row], own - touched_s, stopped - touched_s, (torque[0], torque[1]), (rates[0], rates[1])
        )


def _load_rate_Nm_s(log: Records, touched_s: float) -> float:
    """From what the contact did to one arm; a motor at rest feels nothing through its gear."""
    first = np.searchsorted(log["time_s"], touched_s)
    span = slice(first, first + round(0.008 / TICK_S))
    against = -np.sign(log["command_speed_rad_s"][span]) * log["torque_out_Nm"][span] / GEAR
    return float(np.polyfit(log["time_s"][span], against, 1)[0])
