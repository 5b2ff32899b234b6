"""Trajectories as they go over the wire, and their upload to many positioners at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiberloom import units
from fiberloom.bus.exchange import Exchange
from fiberloom.bus.outcome import Outcome, Result, Results, results_of
from fiberloom.bus.protocol import COMMANDS, Command, Status
from fiberloom.errors import InputError
from fiberloom.typing import Floats, Ints

_STATUS_ASKED, _STATUS_TIMEOUT_S = 4, 0.3
_RECEIVED = Status.TRAJECTORY_ALPHA_RECEIVED | Status.TRAJECTORY_BETA_RECEIVED


@dataclass(frozen=True, slots=True)
class WireTrajectory:
    """Points of both axes: rows of (position in counts, time in ticks), straight in between.

    Times count from the start signal and grow strictly. The axes may have different points.
    """

    alpha: NDArray[np.int32]
    beta: NDArray[np.int32]

    def __post_init__(self) -> None:
        for name, points in (("alpha", self.alpha), ("beta", self.beta)):
            if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:
                raise InputError(f"trajectory, {name}: needs rows of (counts, ticks), at least one")
            if points[0, 1] < 0 or (points[1:, 1] <= points[:-1, 1]).any():
                raise InputError(
                    f"trajectory, {name}: times must grow from point to point by at least one "
                    f"tick of {units.TICK_S * 1e3} ms"
                )

    @classmethod
    def from_deg(
        cls,
        time_s: ArrayLike,
        alpha_deg: ArrayLike,
        beta_deg: ArrayLike,
        corners: tuple[Ints, Ints] | None = None,
    ) -> WireTrajectory:
        """Rounds `alpha_deg` and `beta_deg`, positions on the wire, and `time_s` to counts and ticks.

        `corners`: rows of the points that alpha needs, and beta; without it, all points of both.
        """
        axes = _points("alpha", time_s, alpha_deg), _points("beta", time_s, beta_deg)
        if corners is None:
            return cls(*axes)
        return cls(*(points[rows] for points, rows in zip(axes, corners, strict=True)))

    @classmethod
    def all_from_deg(
        cls, times_s: Sequence[Floats], paths_deg: Sequence[Floats], corners: Sequence[tuple[Ints, Ints]]
    ) -> list[WireTrajectory]:
        """Of several positioners, each as of `from_deg`.

        `times_s` (M,) and `paths_deg` (M, 2), alpha and beta on the wire, of each; `corners`: of each the
        rows that alpha needs, and beta.
        """
        if not times_s:
            return []
        time_s, path_deg = np.concatenate(times_s), np.concatenate(paths_deg)
        alpha = _points("alpha", time_s, path_deg[:, 0])
        beta = _points("beta", time_s, path_deg[:, 1])
        starts = np.cumsum([0, *(len(time_s) for time_s in times_s)]).tolist()
        return [
            cls(alpha[start + rows], beta[start + others])
            for start, (rows, others) in zip(starts[:-1], corners, strict=True)
        ]

    @property
    def duration_s(self) -> float:
        """From the start signal to the last point."""
        return float(max(self.alpha[-1, 1], self.beta[-1, 1])) * units.TICK_S

    @property
    def end_counts(self) -> tuple[int, int]:
        """The last point of both axes."""
        return int(self.alpha[-1, 0]), int(self.beta[-1, 0])


def _points(name: str, time_s: ArrayLike, angle_deg: ArrayLike) -> NDArray[np.int32]:
    ticks = np.rint(np.atleast_1d(np.asarray(time_s, dtype=float)) / units.TICK_S)
    counts = np.rint(np.atleast_1d(np.asarray(angle_deg, dtype=float)) * units.COUNTS_PER_DEG)
    if ticks.shape != counts.shape:
        raise InputError(f"trajectory, {name}: {ticks.size} times but {counts.size} angles")
    points = np.column_stack([counts, ticks])
    if not (np.isfinite(points) & (np.abs(points) < 2.0**31)).all():
        raise InputError(f"trajectory, {name}: angles must be within -720 to 720 deg, and finite")
    return points.astype(np.int32)


async def upload(
    exchange: Exchange,
    trajectories: Mapping[int, WireTrajectory],
    bite: int,
    timeout_s: float,
) -> Results:
    """Send trajectories to all their positioners concurrently (commands 10, 11, 12).

    `exchange` carries the frames; `trajectories`: by positioner; `timeout_s`: for each reply. Per
    positioner: the point counts, then all alpha and all beta points in groups of `bite` frames, each
    group fully answered before the next, then the end mark. One that refuses is left out from there on, and
    so is one without an answer whose status does not show that it is still receiving; it may hold part of a
    trajectory, to be dropped by an abort. Points that were lost themselves, and not their replies, are
    found at the end mark: their number is wrong there.
    """
    ids = list(trajectories)
    loading = _Loading(exchange, timeout_s, Results())
    new = COMMANDS[Command.SEND_NEW_TRAJECTORY]
    counts = [new.pack(len(t.alpha), len(t.beta)) for t in trajectories.values()]
    alive = await loading.step(Command.SEND_NEW_TRAJECTORY, ids, counts)
    alive = await _send_points(loading, trajectories, alive, bite)
    await loading.step(Command.TRAJECTORY_DATA_END, alive, [b""] * len(alive))
    return Results({i: loading.results[i] for i in ids})


@dataclass(frozen=True)
class _Loading:
    """Rounds of frames, and the worst result of each positioner so far."""

    exchange: Exchange
    timeout_s: float
    results: Results

    async def step(self, command: Command, ids: Sequence[int], payloads: Sequence[bytes]) -> list[int]:
        """One round of frames; returns those all of whose frames were accepted."""
        replies = await self.exchange.unicast(command, ids, payloads, self.timeout_s)
        worst: dict[int, Result] = {}
        for result in results_of(ids, command, replies, self.exchange.cut_off(ids)):
            known = worst.setdefault(result.positioner, result)
            if known.ok or result.outcome is Outcome.REFUSED:
                worst[result.positioner] = result
        silent = [i for i, result in worst.items() if result.outcome is Outcome.TIMED_OUT]
        for positioner in await self._understood(command, silent):
            worst[positioner] = Result(positioner, Outcome.DONE)
        self.results.update(worst)
        return [i for i, result in worst.items() if result.ok]

    async def _understood(self, command: Command, silent: list[int]) -> list[int]:
        """Which of these show by their status that they took the command: their replies were lost."""
        taken = []
        for _ in range(_STATUS_ASKED):
            if not silent:
                break
            replies = await self.exchange.unicast(
                Command.GET_STATUS, silent, [b""] * len(silent), _STATUS_TIMEOUT_S
            )
            status = {r.positioner: r for r in results_of(silent, Command.GET_STATUS, replies, set())}
            taken += [i for i, r in status.items() if r.ok and _took(command, Status(r.values[0]))]
            silent = [i for i, r in status.items() if r.outcome is Outcome.TIMED_OUT]
        return taken


def _took(command: Command, status: Status) -> bool:
    receiving = Status.RECEIVING_TRAJECTORY in status
    if command is Command.TRAJECTORY_DATA_END:
        return not receiving and _RECEIVED in status
    return receiving


async def _send_points(
    loading: _Loading, trajectories: Mapping[int, WireTrajectory], alive: list[int], bite: int
) -> list[int]:
    points = {i: np.concatenate([trajectories[i].alpha, trajectories[i].beta]) for i in alive}
    longest = max((len(p) for p in points.values()), default=0)
    waiting = alive
    for first in range(0, longest, bite):
        waiting = [i for i in waiting if len(points[i]) > first]
        if not waiting:  # the longest one has been refused
            break
        bites = [points[i][first : first + bite] for i in waiting]
        owners = np.repeat(waiting, [len(b) for b in bites]).tolist()
        raw = np.concatenate(bites).astype("<i4").tobytes()
        payloads = [raw[k : k + 8] for k in range(0, len(raw), 8)]
        good = await loading.step(Command.SEND_TRAJECTORY_DATA, owners, payloads)
        failed = set(waiting) - set(good)
        alive = [i for i in alive if i not in failed]
        waiting = good
    return alive
