"""The client: what a host asks of positioners, whatever carries the frames.

Positions here are wire positions in deg (2^30 counts per turn): what the motor's position is called
on the bus. The transmission maps between them and the arm's angles are the caller's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fiberloom import units
from fiberloom.bus.exchange import Exchange
from fiberloom.bus.identifier import Identifier
from fiberloom.bus.outcome import Outcome, Result, Results, all_of, result_of
from fiberloom.bus.protocol import (
    COMMANDS,
    MAX_SPEED_RPM,
    Command,
    CommandFlag,
    CommandSpec,
    Response,
    Status,
    counts_of_deg,
)
from fiberloom.bus.trajectory import WireTrajectory, upload
from fiberloom.bus.transport import Frame, Transport
from fiberloom.errors import InputError
from fiberloom.typing import Flags, Floats, Ints

# The answer to a broadcast is not counted on for fewer positioners than this: unicast is as cheap.
_BROADCAST_FROM = 4
# Plain integers: a poll looks at every bit of 500 positioners ten times a second.
_COLLIDED = int(Status.COLLISION)
_COMPLETED = int(Status.DISPLACEMENT_COMPLETED)
# It has lost its supply on the way, and rests somewhere: that is no arrival.
_LOST_WAY = int(Status.ESTIMATED_POSITION)


@dataclass(frozen=True, slots=True)
class Collision:
    """A positioner said by itself that it collided."""

    positioner: int
    time_s: float


class Client:
    """Talks to the positioners of one transport.

    Every method returns Results: each positioner ends in an Outcome, none in an exception and none
    in a hang. Requests that can be repeated without harm are retried `retries` times.
    """

    def __init__(self, transport: Transport, *, retries: int = 1, bite: int = 10) -> None:
        self.exchange = Exchange(transport)
        self.exchange.on_unsolicited = self._on_collision
        self.retries = retries
        self.bite = bite
        self.ids: list[int] = []
        """The positioners found by discover()."""
        self.collisions: list[Collision] = []
        """Every collision reported so far, oldest first."""
        self._collided: set[int] = set()  # since the last stop()
        self._listeners: list[Callable[[Collision], None]] = []

    @property
    def time_s(self) -> float:
        """The transport's clock."""
        return self.exchange.time_s

    async def sleep(self, duration_s: float) -> None:
        """Lets time pass, still listening for collisions."""
        await self.exchange.sleep(duration_s)

    async def close(self) -> None:
        """Closes the transport."""
        await self.exchange.transport.close()

    def on_collision(self, listener: Callable[[Collision], None]) -> None:
        """Calls `listener` at every collision that a positioner reports."""
        self._listeners.append(listener)

    def _on_collision(self, identifier: Identifier, frame: Frame) -> None:
        collision = Collision(identifier.positioner, self.time_s)
        self.collisions.append(collision)
        self._collided.add(identifier.positioner)
        for listener in self._listeners:
            listener(collision)

    # asking

    async def discover(self, timeout_s: float = 0.5) -> list[int]:
        """The positioners that answer GET_ID within the timeout, sorted."""
        replies = await self.exchange.broadcast(Command.GET_ID, b"", timeout_s)
        self.ids = sorted(replies)
        return self.ids

    async def command(
        self,
        command: Command,
        ids: Iterable[int] | None = None,
        *values: ArrayLike,
        timeout_s: float | None = None,
    ) -> Results:
        """Sends a command to each positioner; a value is one number for all or one for each."""
        spec = COMMANDS[command]
        ids = self._chosen(ids)
        if not ids:
            return Results()
        columns = [np.broadcast_to(np.asarray(v), len(ids)).tolist() for v in values]
        payloads = [spec.pack(*row) for row in zip(*columns, strict=True)] or [spec.pack()] * len(ids)
        timeout_s = spec.timeout_s if timeout_s is None else timeout_s
        results = await self._unicast(command, ids, payloads, timeout_s)
        for _ in range(self.retries if spec.flags & CommandFlag.REPEATABLE else 0):
            await self._again(command, ids, payloads, timeout_s, results)
        return results

    def _chosen(self, ids: Iterable[int] | None) -> list[int]:
        return list(dict.fromkeys(self.ids if ids is None else (int(i) for i in ids)))

    async def _unicast(
        self, command: Command, ids: Sequence[int], payloads: Sequence[bytes], timeout_s: float
    ) -> Results:
        replies = await self.exchange.unicast(command, ids, payloads, timeout_s)
        lost = self.exchange.lost is not None
        pairs = zip(ids, replies, strict=True)
        return Results({i: result_of(i, command, reply, lost) for i, reply in pairs})

    async def _again(
        self,
        command: Command,
        ids: Sequence[int],
        payloads: Sequence[bytes],
        timeout_s: float,
        results: Results,
    ) -> list[int]:
        """Asks those once more that have not answered; returns which it asked."""
        silent = [k for k, i in enumerate(ids) if results[i].outcome is Outcome.TIMED_OUT]
        if silent:
            asked = [ids[k] for k in silent]
            data = [payloads[k] for k in silent]
            results.update(await self._unicast(command, asked, data, timeout_s))
        return [ids[k] for k in silent]

    async def broadcast(
        self, command: Command, ids: Iterable[int] | None = None, timeout_s: float | None = None
    ) -> Results:
        """Sends one frame to all positioners and collects the replies of `ids` (default: all known).

        Those that do not answer a repeatable command are asked once more, one by one.
        """
        spec = COMMANDS[command]
        if not spec.flags & CommandFlag.BROADCAST:
            raise ValueError(f"{command.name} cannot be broadcast")
        chosen = self._chosen(ids)
        timeout_s = spec.timeout_s if timeout_s is None else timeout_s
        replies = await self.exchange.broadcast(command, spec.pack(), timeout_s, chosen)
        lost = self.exchange.lost is not None
        results = Results({i: result_of(i, command, replies.get(i), lost) for i in chosen})
        if spec.flags & CommandFlag.REPEATABLE and self.retries:
            await self._again(command, chosen, [spec.pack()] * len(chosen), timeout_s, results)
        return results

    async def firmware_versions(self, ids: Iterable[int] | None = None) -> dict[int, str]:
        """Versions as "04.01.21", of those that answer."""
        results = await self.command(Command.GET_FIRMWARE_VERSION, ids)
        return {i: "{2:02d}.{1:02d}.{0:02d}".format(*r.values) for i, r in results.items() if r.ok}

    async def status(self, ids: Iterable[int] | None = None) -> Results:
        """The status words: `values[0]`, to be read as protocol.Status."""
        chosen = self._chosen(ids)
        if len(chosen) < _BROADCAST_FROM:
            return await self.command(Command.GET_STATUS, chosen)
        return await self.broadcast(Command.GET_STATUS, chosen)

    async def positions(self, ids: Iterable[int] | None = None) -> Results:
        """Where the positioners say they are: `values` are alpha and beta in counts."""
        return await self.command(Command.GET_ACTUAL_POSITION, ids)

    async def positions_deg(self, ids: Iterable[int] | None = None) -> tuple[Floats, Flags]:
        """Reported wire positions (n, 2) in deg, and which answered (n,); zeros for the others."""
        results = await self.positions(ids)
        return results.values_array(2) / units.COUNTS_PER_DEG, results.ok

    # settings

    async def set_speed(
        self, ids: Iterable[int] | None, alpha_rpm: ArrayLike, beta_rpm: ArrayLike
    ) -> Results:
        """Motor speeds for goto moves, 0 to 5000 rpm."""
        for name, rpm in (("alpha", np.asarray(alpha_rpm)), ("beta", np.asarray(beta_rpm))):
            if ((rpm < 0) | (rpm > MAX_SPEED_RPM)).any():
                raise InputError(f"{name} speed {rpm} rpm: must be 0 to {MAX_SPEED_RPM} rpm")
        alpha, beta = (np.rint(rpm).astype(int) for rpm in (alpha_rpm, beta_rpm))
        return await self.command(Command.SET_SPEED, ids, alpha, beta)

    async def set_loop(
        self,
        ids: Iterable[int] | None = None,
        *,
        closed: bool = True,
        collision_detection: bool = True,
    ) -> Results:
        """Closed or open loop, with or without collision detection, of both axes (118 to 125)."""
        step = (0 if closed else 2) + (0 if collision_detection else 1)
        return await self._both(
            Command(Command.ALPHA_CLOSED_LOOP_COLLISION_DETECTION + step),
            Command(Command.BETA_CLOSED_LOOP_COLLISION_DETECTION + step),
            ids,
        )

    async def set_precise_moves(self, ids: Iterable[int] | None = None, *, on: bool) -> Results:
        """Whether each move ends with an approach that closes the backlash (128 to 131)."""
        alpha, beta = (
            (Command.SWITCH_ON_PRECISE_MOVE_ALPHA, Command.SWITCH_ON_PRECISE_MOVE_BETA)
            if on
            else (Command.SWITCH_OFF_PRECISE_MOVE_ALPHA, Command.SWITCH_OFF_PRECISE_MOVE_BETA)
        )
        return await self._both(alpha, beta, ids)

    async def _both(self, alpha: Command, beta: Command, ids: Iterable[int] | None) -> Results:
        results = await self.command(alpha, ids)
        results.update(await self.command(beta, results.ok_ids))
        return results

    async def set_position(
        self, ids: Iterable[int] | None, alpha_deg: ArrayLike, beta_deg: ArrayLike
    ) -> Results:
        """Declares where the axes are (33)."""
        return await self.command(Command.SET_ACTUAL_POSITION, ids, _counts(alpha_deg), _counts(beta_deg))

    # moves

    async def goto(
        self,
        ids: Iterable[int] | None,
        alpha_deg: ArrayLike,
        beta_deg: ArrayLike,
        *,
        relative: bool = False,
    ) -> Results:
        """Start moves at the set speeds; DONE means begun, `values` the durations in ticks.

        `ids`: positioners, all known ones when None; `alpha_deg`, `beta_deg`: wire positions, one for
        all or one each; `relative`: from the present position, and never repeated.
        """
        command = Command.GO_TO_RELATIVE_POSITION if relative else Command.GO_TO_ABSOLUTE_POSITION
        counts = _counts(alpha_deg), _counts(beta_deg)
        results = await self.command(command, ids, *counts)
        silent = [i for i, r in results.items() if r.outcome is Outcome.TIMED_OUT]
        if relative or not silent or not self.retries:
            return results
        return await self._goto_again(results, silent, counts)

    async def _goto_again(self, results: Results, silent: list[int], counts: tuple[Ints, ...]) -> Results:
        """An absolute goal can be sent twice: a positioner in motion lost its reply and not the goal."""
        rows = [k for k, i in enumerate(results) if i in set(silent)]
        picked = (c[rows] if c.ndim else c for c in counts)
        again = await self.command(Command.GO_TO_ABSOLUTE_POSITION, silent, *picked)
        for i, result in again.items():
            moving = result.code is Response.ALREADY_IN_MOTION
            results[i] = Result(i, Outcome.DONE, values=(0, 0)) if moving else result
        return results

    async def home(self, ids: Iterable[int] | None = None, axis: str | None = None) -> Results:
        """Starts the search of the hard stops: of both axes, or of "alpha" or "beta" alone."""
        commands = {
            None: Command.GO_TO_DATUMS,
            "alpha": Command.GO_TO_DATUM_ALPHA,
            "beta": Command.GO_TO_DATUM_BETA,
        }
        if axis not in commands:
            raise ValueError(f"axis {axis!r}: 'alpha', 'beta', or None for both")
        return await self.command(commands[axis], ids)

    async def abort(self, ids: Iterable[int] | None = None) -> Results:
        """Stops, drops trajectories and keeps the collision flags (13)."""
        return await self.command(Command.SEND_TRAJECTORY_ABORT, ids)

    async def stop(self, ids: Iterable[int] | None = None) -> Results:
        """Stops all positioners on the bus, drops trajectories and clears the collision flags (15)."""
        self._collided.clear()
        return await self.broadcast(Command.STOP_TRAJECTORY, ids)

    async def send_trajectories(
        self, trajectories: Mapping[int, WireTrajectory], timeout_s: float = 5.0
    ) -> Results:
        """Loads a trajectory into each positioner, all at once; failures are tried once more.

        A positioner that fails in the end holds none: it stays where it is when the others start.
        """
        results = await upload(self.exchange, trajectories, self.bite, timeout_s)
        for attempt in range(self.retries + 1):
            failed = [i for i in results.failed if results[i].outcome is not Outcome.DISCONNECTED]
            if not failed:
                break
            await self.abort(failed)
            if attempt < self.retries:
                rest = {i: trajectories[i] for i in failed}
                results.update(await upload(self.exchange, rest, self.bite, timeout_s))
        return results

    async def start(self, ids: Iterable[int] | None = None) -> Results:
        """Starts every loaded trajectory on the bus with one frame.

        Never repeated: a late start would be out of step with the neighbours.
        """
        return await self.broadcast(Command.START_TRAJECTORY, ids)

    async def wait_until_done(
        self,
        ids: Iterable[int] | None = None,
        timeout_s: float = 60.0,
        *,
        expected_s: float = 0.0,
        poll_s: float = 0.1,
        stop_on_collision: bool = True,
    ) -> Results:
        """Poll until every motion has ended, or the timeout; the first poll after `expected_s`.

        `ids`: positioners, all known ones when None; `timeout_s`: from now on; `poll_s`: time between
        polls. With `stop_on_collision`, a collision stops all the others too: from there on none is
        where its neighbours expect it. A positioner that no longer answers ends as TIMED_OUT at once.
        """
        results = all_of(self._chosen(ids), Outcome.TIMED_OUT)
        active = set(results)
        deadline_s = self.time_s + timeout_s
        await self._rest(active, min(self.time_s + expected_s, deadline_s))
        while active:
            active = self._judge(active, await self.status(active), results)
            collided = any(r.outcome is Outcome.COLLIDED for r in results.values())
            if active and collided and stop_on_collision:
                await self.abort(active)
                results.update(all_of(active, Outcome.STOPPED))
                break
            if not active or self.time_s >= deadline_s:
                break
            await self._rest(active, min(self.time_s + poll_s, deadline_s))
        return results

    async def _rest(self, active: set[int], until_s: float) -> None:
        await self.exchange.wait(lambda: not self._collided.isdisjoint(active), until_s)

    def _judge(self, active: set[int], status: Results, results: Results) -> set[int]:
        """Books those whose motion has ended; returns those that still move."""
        moving = set()
        for i, answer in status.items():
            bits = answer.values[0] if answer.ok else 0
            if i in self._collided or bits & _COLLIDED:
                results[i] = Result(i, Outcome.COLLIDED)
            elif not answer.ok:
                results[i] = answer
            elif bits & _COMPLETED:
                results[i] = Result(i, Outcome.MISPLACED if bits & _LOST_WAY else Outcome.DONE)
            else:
                moving.add(i)
        return moving

    async def run_trajectories(
        self,
        trajectories: Mapping[int, WireTrajectory],
        *,
        partial: bool = False,
        margin_s: float = 3.0,
        tolerance_deg: float = 0.1,
    ) -> Results:
        """Load, start and wait for trajectories, then check the position that each positioner reports.

        `trajectories`: by positioner; `margin_s`: time allowed beyond the longest one; `tolerance_deg`:
        largest difference of the reported wire position from the end, beyond it MISPLACED. When one
        cannot be loaded, none starts (the others end as STOPPED), unless `partial`: a plan is valid
        only when all follow it.
        """
        results = await self.send_trajectories(trajectories)
        loaded = results.ok_ids
        if results.failed and not partial:
            await self.abort(loaded)
            results.update(all_of(loaded, Outcome.STOPPED))
            return results
        if not loaded:
            return results
        longest_s = max(trajectories[i].duration_s for i in loaded)
        started = await self.start(loaded)
        refused = Results({i: r for i, r in started.items() if r.outcome is Outcome.REFUSED})
        waited = await self.wait_until_done(
            [i for i in loaded if i not in refused], longest_s + margin_s, expected_s=longest_s
        )
        results.update(refused)
        results.update(waited)
        await self._check_ends(trajectories, waited.ok_ids, results, tolerance_deg)
        return results

    async def _check_ends(
        self,
        trajectories: Mapping[int, WireTrajectory],
        ids: list[int],
        results: Results,
        tolerance_deg: float,
    ) -> None:
        # an abort first: without it a positioner that never started may report its goal
        await self.abort(ids)
        limit = tolerance_deg * units.COUNTS_PER_DEG
        for i, where in (await self.positions(ids)).items():
            if not where.ok:
                results[i] = where
                continue
            off = np.abs(np.subtract(where.values, trajectories[i].end_counts))
            if (off > limit).any():
                results[i] = Result(i, Outcome.MISPLACED, values=where.values)


def _counts(angle_deg: ArrayLike) -> Ints:
    """Wire counts of one angle or of one for each positioner."""
    angles = np.asarray(angle_deg, dtype=float)
    counts = [counts_of_deg(a) for a in angles.ravel().tolist()]
    return np.array(counts, dtype=np.int64).reshape(angles.shape)


__all__ = ["Client", "Collision", "CommandSpec"]
