"""The client: what a host asks of positioners, whatever carries the frames.

Positions here are wire positions in deg (2^30 counts per turn): what the motor's position is called
on the bus. The transmission maps between them and the arm's angles are the caller's.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.bus.motion import Arrivals, MotionRun, MotionWatch, Patience, Tolerance
from fiberloom.bus.outcome import Outcome, Result, Results, all_of
from fiberloom.bus.protocol import MAX_SPEED_RPM, Command, CommandSpec, Response, counts_of_deg
from fiberloom.bus.requests import Collision, Requests
from fiberloom.bus.trajectory import WireTrajectory, upload
from fiberloom.errors import InputError
from fiberloom.typing import Ints


class Client(Requests):
    """Talks to the positioners of one transport.

    Every method returns Results: each positioner ends in an Outcome, none in an exception and none
    in a hang. Requests that can be repeated without harm are retried `retries` times.
    """

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

    async def send_trajectories(
        self, trajectories: Mapping[int, WireTrajectory], timeout_s: float = 1.0
    ) -> Results:
        """Loads a trajectory into each positioner, all at once; `timeout_s`: for each reply.

        A lost reply is made up for by asking for the status. What refuses is loaded again from the
        beginning, as often as requests are repeated; what does not answer, once. A positioner that fails in
        the end holds none: it stays where it is when the others start.
        """
        results = await upload(self.exchange, trajectories, self.bite, timeout_s)
        for attempt in range(self.retries + 1):
            failed = [i for i in results.failed if results[i].outcome is not Outcome.DISCONNECTED]
            if not failed:
                break
            await self.abort(failed)
            again = [i for i in failed if attempt == 0 or results[i].outcome is Outcome.REFUSED]
            if attempt < self.retries and again:
                rest = {i: trajectories[i] for i in again}
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
        where its neighbours expect it. A positioner that no longer answers ends as TIMED_OUT after three
        polls over two seconds; the others do not wait for it.
        """
        waiting = Patience(timeout_s, expected_s, poll_s, stop_on_collision)
        return await Arrivals(self, self._chosen(ids), waiting).wait()

    async def run_trajectories(
        self,
        trajectories: Mapping[int, WireTrajectory],
        *,
        partial: bool = False,
        tolerance: Tolerance | None = None,
        watch: MotionWatch | None = None,
    ) -> Results:
        """Load, start, watch and wait for trajectories, then check the position that each reports.

        `trajectories`: by positioner; `tolerance`: what is still an arrival, beyond it MISPLACED; `watch`:
        how often all are polled on the way, and who says whether the others go on when one does not do
        its part. When one cannot be loaded, none starts (the others end as STOPPED), unless `partial`: a
        plan is valid only when all follow it.
        """
        results = await self.send_trajectories(trajectories)
        loaded = results.ok_ids
        if results.failed and not partial:
            await self.abort(loaded)
            results.update(all_of(loaded, Outcome.STOPPED))
            return results
        if not loaded:
            return results
        held = {i: trajectories[i] for i in loaded}
        run = MotionRun(self, held, watch or MotionWatch(), tolerance or Tolerance())
        results.update(await run.run())
        return results


def _counts(angle_deg: ArrayLike) -> Ints:
    """Wire counts of one angle or of one for each positioner."""
    angles = np.asarray(angle_deg, dtype=float)
    counts = [counts_of_deg(a) for a in angles.ravel().tolist()]
    return np.array(counts, dtype=np.int64).reshape(angles.shape)


__all__ = ["Client", "Collision", "CommandSpec"]
