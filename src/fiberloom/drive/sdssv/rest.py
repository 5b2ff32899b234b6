"""Nothing moves any more: what a host that was killed has left on its way is stopped."""

from __future__ import annotations

from collections.abc import Callable

from fiberloom.bus.client import Client
from fiberloom.bus.outcome import Result
from fiberloom.bus.protocol import Status

REST_TIMEOUT_S = 5.0
"""A stopped positioner is at rest after a fraction of a second."""

LONGEST_MOTION_S = 60.0
"""So long after a host has gone, one that does not answer may still follow its trajectory: plans of 500
positioners last 35 s."""

HEAR_S = 0.2
"""Between attempts to hear who does not answer, and who has collided."""


class AtRest:
    """Stops what still moves: places of before are no places.

    Not while one does not answer: it may move, too, and those that are stopped would be in its way. But
    where one has collided, and the others go on by plans that are not known any more, all are stopped
    that can be reached; then none moves again before the others have answered, or have had their time.
    """

    def __init__(self, client: Client, known: list[int], alarm: Callable[[str], None]) -> None:
        """`client`: of the bus; `known`: positioners that should answer; `alarm`: told of what was found."""
        self.client, self.known, self.alarm = client, known, alarm

    async def reach(self, left_moving: bool) -> None:
        """Returns when all is at rest; `left_moving`: the record says that something may move."""
        moving, collided = await self._on_the_way()
        until_s = self.client.time_s + LONGEST_MOTION_S
        if not (moving or left_moving):
            return
        if self._unheard and not collided:
            self._waits(
                f"{len(moving)} positioners are still moving at the begin; ", "none is stopped", until_s
            )
            while not collided and await self._not_all_heard(until_s):
                collided = (await self._on_the_way())[1]
        await self._stop_the_moving()
        if self._unheard and self.client.time_s < until_s:
            self._waits("", "none may come", until_s)
            while await self._not_all_heard(until_s):
                await self._stop_the_moving()
            await self._stop_the_moving()

    def _waits(self, before: str, so: str, until_s: float) -> None:
        silent = ", ".join(map(str, self._unheard))
        left_s = until_s - self.client.time_s
        self.alarm(f"{before}no answer from {silent}, in whose way {so}: waiting up to {left_s:.0f} s")

    async def _not_all_heard(self, until_s: float) -> bool:
        """After another try: whether one has not answered yet that may still be on its way."""
        if not self._unheard or self.client.time_s >= until_s:
            return False
        await self.client.sleep(HEAR_S)
        await self.client.discover()
        return bool(self._unheard)

    async def _stop_the_moving(self) -> None:
        moving, _ = await self._on_the_way()
        if moving:
            self.alarm(f"{len(moving)} positioners were still moving at the begin; all are stopped")
            # one that gives no answer may hear nevertheless
            await self.client.stop_all(ids=sorted({*self.client.ids, *self._unheard}))
            await self.client.wait_until_done(moving, REST_TIMEOUT_S, stop_on_collision=False)

    async def _on_the_way(self) -> tuple[list[int], bool]:
        """Those that move, and whether one has collided."""
        answers = await self.client.poll(self.client.ids)
        collided = any(answer.ok and answer.values[0] & Status.COLLISION for answer in answers.values())
        return [i for i, answer in answers.items() if _moves(answer)], collided

    @property
    def _unheard(self) -> list[int]:
        """Positioners that should answer and that the bus does not have now."""
        return sorted(set(self.known) - set(self.client.ids))


def _moves(answer: Result) -> bool:
    """Whether a positioner says that it is on its way."""
    return answer.ok and not answer.values[0] & Status.DISPLACEMENT_COMPLETED
