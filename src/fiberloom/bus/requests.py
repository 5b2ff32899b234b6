"""Asking positioners: requests, broadcasts, collisions, and the stop that reaches every one of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiberloom import units
from fiberloom.bus.exchange import Exchange
from fiberloom.bus.identifier import Identifier
from fiberloom.bus.links import Link
from fiberloom.bus.outcome import Outcome, Results, all_of, results_of
from fiberloom.bus.protocol import COMMANDS, Command, CommandFlag, CommandSpec
from fiberloom.bus.transport import Frame, Transport
from fiberloom.timing import part
from fiberloom.typing import Flags, Floats

POLL_TIMEOUT_S = 0.3
"""For the answer to a poll: a bus of 21 positioners needs some milliseconds."""

# The answer to a broadcast is not counted on for fewer positioners than this: unicast is as cheap.
_BROADCAST_FROM = 4
_STOP_ROUND_S = 0.1


@dataclass(frozen=True, slots=True)
class Collision:
    """A positioner said by itself that it collided."""

    positioner: int
    time_s: float


@part("bus")
def _payloads(spec: CommandSpec, values: list[NDArray[Any]], n: int) -> list[bytes]:
    """Of n requests; packed once where all get the same."""
    if all(v.ndim == 0 for v in values):
        return [spec.pack(*(v.item() for v in values))] * n
    columns = [np.broadcast_to(v, n).tolist() for v in values]
    return [spec.pack(*row) for row in zip(*columns, strict=True)]


class Requests:
    """Asks the positioners of one transport. Every answer is a `Results`; see `Client`."""

    def __init__(self, transport: Transport, *, retries: int = 3, bite: int = 10) -> None:
        self.exchange = Exchange(transport)
        self.exchange.on_unsolicited = self._on_collision
        self.exchange.on_link = self._on_link
        self.retries = retries
        self.bite = bite
        self.ids: list[int] = []
        """The positioners found by discover()."""
        self.collisions: list[Collision] = []
        """Every collision reported so far, oldest first."""
        self.collided: set[int] = set()
        """Positioners that reported a collision since the last stop()."""
        self._listeners: list[Callable[[Collision], None]] = []
        self._link_listeners: list[Callable[[Link], None]] = []

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

    def on_link(self, listener: Callable[[Link], None]) -> None:
        """Calls `listener` whenever a link has gone down or come up."""
        self._link_listeners.append(listener)

    def _on_link(self, link: Link) -> None:
        for listener in self._link_listeners:
            listener(link)

    def _on_collision(self, identifier: Identifier, frame: Frame) -> None:
        collision = Collision(identifier.positioner, self.time_s)
        self.collisions.append(collision)
        self.collided.add(identifier.positioner)
        for listener in self._listeners:
            listener(collision)

    # asking

    async def discover(self, timeout_s: float = 0.5) -> list[int]:
        """The positioners that answer GET_ID, sorted; it takes `timeout_s`, longer where some are new late.

        All are asked again until two rounds in a row bring no new one: a lost reply hides no positioner.
        """
        self.ids = sorted(await self.exchange.census(Command.GET_ID, timeout_s))
        return self.ids

    async def command(
        self,
        command: Command,
        ids: Iterable[int] | None = None,
        *values: ArrayLike,
        timeout_s: float | None = None,
    ) -> Results:
        """Sends a command to n positioners and waits for the replies.

        `command`: a row of the table in docs/bus.md; `ids`: positioners, all known ones when None;
        `values`: those of the request, in order, each one integer for all or (n,) for each; `timeout_s`:
        for each reply, above 0, by default that of the command. A repeatable command is sent again to
        those that do not answer, `retries` times. Raises InputError where values do not fit the request,
        ValueError where there are not n of them.
        """
        spec = COMMANDS[command]
        ids = self._chosen(ids)
        if not ids:
            return Results()
        payloads = _payloads(spec, [np.asarray(v) for v in values], len(ids))
        timeout_s = spec.timeout_s if timeout_s is None else timeout_s
        results = await self._unicast(command, ids, payloads, timeout_s)
        for _ in range(self.retries if spec.flags & CommandFlag.REPEATABLE else 0):
            await self._again(command, ids, payloads, timeout_s, results)
        return results

    def _chosen(self, ids: Iterable[int] | None) -> list[int]:
        return list(dict.fromkeys(self.ids if ids is None else map(int, ids)))

    async def _unicast(
        self, command: Command, ids: Sequence[int], payloads: Sequence[bytes], timeout_s: float
    ) -> Results:
        replies = await self.exchange.unicast(command, ids, payloads, timeout_s)
        return self._judged(command, ids, replies)

    @part("bus")
    def _judged(self, command: Command, ids: Sequence[int], replies: Iterable[Frame | None]) -> Results:
        results = results_of(ids, command, replies, self.exchange.cut_off(ids))
        return Results(zip(ids, results, strict=True))

    async def _again(
        self,
        command: Command,
        ids: Sequence[int],
        payloads: Sequence[bytes],
        timeout_s: float,
        results: Results,
    ) -> list[int]:
        """Asks those once more that have not answered; returns which it asked."""
        timed_out = Outcome.TIMED_OUT
        silent = [k for k, i in enumerate(ids) if results[i].outcome is timed_out]
        if silent:
            asked = [ids[k] for k in silent]
            data = [payloads[k] for k in silent]
            results.update(await self._unicast(command, asked, data, timeout_s))
        return [ids[k] for k in silent]

    async def broadcast(
        self, command: Command, ids: Iterable[int] | None = None, timeout_s: float | None = None
    ) -> Results:
        """Sends one frame to all positioners and collects the replies of `ids` (default: all known).

        Those that do not answer a repeatable command are asked again, one by one.
        """
        spec = COMMANDS[command]
        if not spec.flags & CommandFlag.BROADCAST:
            raise ValueError(f"{command.name} cannot be broadcast")
        chosen = self._chosen(ids)
        timeout_s = spec.timeout_s if timeout_s is None else timeout_s
        replies = await self.exchange.broadcast(command, spec.pack(), timeout_s, chosen)
        results = self._judged(command, chosen, map(replies.get, chosen))
        if spec.flags & CommandFlag.REPEATABLE:
            for _ in range(self.retries):
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

    async def poll(self, ids: Iterable[int]) -> Results:
        """Status words as `status` has them, with short time-outs: silent ones are asked once more."""
        asked = self._chosen(ids)
        answered: dict[int, Frame] = {}
        if len(asked) >= _BROADCAST_FROM:
            answered = await self.exchange.broadcast(Command.GET_STATUS, b"", POLL_TIMEOUT_S, asked)
        silent = [i for i in asked if i not in answered]
        rest = await self._unicast(Command.GET_STATUS, silent, [b""] * len(silent), POLL_TIMEOUT_S)
        polled = self._judged(Command.GET_STATUS, asked, map(answered.get, asked))
        polled.update(rest)
        return polled

    async def rest(self, ids: set[int], until_s: float, early_s: float = 0.0) -> bool:
        """Lets time pass, but no longer than to the first collision of these; True when there was one."""
        return await self.exchange.wait(lambda: not self.collided.isdisjoint(ids), until_s, early_s)

    async def positions(self, ids: Iterable[int] | None = None) -> Results:
        """Where the positioners say they are: `values` are alpha and beta in counts."""
        return await self.command(Command.GET_ACTUAL_POSITION, ids)

    async def positions_deg(self, ids: Iterable[int] | None = None) -> tuple[Floats, Flags]:
        """Reported wire positions (n, 2) in deg, and which answered (n,); zeros for the others."""
        results = await self.positions(ids)
        return results.values_array(2) / units.COUNTS_PER_DEG, results.ok

    # stopping

    async def abort(self, ids: Iterable[int] | None = None) -> Results:
        """Stops, drops trajectories and keeps the collision flags (13)."""
        return await self.command(Command.SEND_TRAJECTORY_ABORT, ids)

    async def stop(self, ids: Iterable[int] | None = None) -> Results:
        """Stops all positioners on the bus, drops trajectories and clears the collision flags (15)."""
        self.collided.clear()
        return await self.broadcast(Command.STOP_TRAJECTORY, ids)

    async def stop_all(self, within_s: float = 0.5, ids: Iterable[int] | None = None) -> Results:
        """Stop every positioner that can be reached (`ids`: only these); keeps the collision flags.

        ABORT (13) cannot be broadcast, so it goes to each known positioner, and again until it has
        answered or `within_s` is over: one short frame each. Where none is known yet, STOP (15) is
        broadcast, which clears the flags.
        """
        deadline_s = self.time_s + within_s
        asked = self._chosen(ids)
        if not asked:
            replies = await self.exchange.broadcast(Command.STOP_TRAJECTORY, b"", within_s)
            return self._judged(Command.STOP_TRAJECTORY, list(replies), replies.values())
        results = all_of(asked, Outcome.TIMED_OUT)
        while missing := [i for i, r in results.items() if not r.ok]:
            left_s = max(min(deadline_s - self.time_s, _STOP_ROUND_S), 1e-3)
            results.update(
                await self._unicast(Command.SEND_TRAJECTORY_ABORT, missing, [b""] * len(missing), left_s)
            )
            if self.time_s >= deadline_s or self.exchange.lost:
                break
            if self.exchange.cut_off(results).issuperset(results.failed):
                break
        return results
