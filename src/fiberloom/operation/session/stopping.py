"""Stopping an array from another process than the one that moves it.

1. The owner is asked through the store. It looks ten times a second, and stops by the connection that it has.
2. Meanwhile, where the bus takes a second talker (socketcan), this process sends the stop itself: that of the
   instrument, ABORT of SDSS-V.
3. Where the owner does not answer in time, or there is none, this process connects and sends it. A gateway
   with one connection (CAN@net) refuses it as long as the owner holds that; then, on the same machine, the
   owner is interrupted as by Ctrl-C. A second connection is not tried first: to open one restarts the ports
   of the gateway, which would cut the owner's frames.
"""

from __future__ import annotations

import asyncio
import os
import signal
from dataclasses import dataclass

from fiberloom.bus.transport import TransportLost
from fiberloom.drive.pfs.streams import StreamLost
from fiberloom.errors import InputError
from fiberloom.operation.outside.stops import Halt
from fiberloom.operation.session.array_lock import state_of
from fiberloom.operation.session.states import SessionState
from fiberloom.store.arrays import ArrayBook, ArrayState
from fiberloom.store.process import host_name

ASKED_S = 1.5
"""So long the owner has to answer; it needs a tenth of a second."""

AT_REST_S = 10.0
"""So long it has to bring all to rest and to give the array back."""

_LOOK_S = 0.05


@dataclass(frozen=True)
class StopReport:
    """How an array was stopped."""

    stopped: bool
    by: str
    """owner, own connection, signal; empty where nothing worked."""
    text: str


@dataclass(frozen=True)
class Stopper:
    """Stops one array."""

    book: ArrayBook
    halt: Halt
    """Stops it over a connection of its own."""
    shared: bool
    """Whether the bus takes a second one beside the owner's."""
    who: str
    """For the record: user and machine."""

    async def stop(self) -> StopReport:
        """Stops everything, by the first way that works."""
        state = self.book.state()
        if not state.owned:
            return await self._own_connection()
        self.book.ask_stop(self.who)
        if self.shared:
            await self._own_connection(owned=True)
        if await self._given_back(state, ASKED_S) or await self._heard(state, AT_REST_S):
            now = self.book.state()
            return StopReport(True, "owner", f"{state.owner} has stopped it: {now.text or now.state}")
        own = await self._own_connection(owned=True)
        return own if own.stopped else await self._interrupt(state, own)

    async def _given_back(self, owner: ArrayState, within_s: float) -> bool:
        end_s = asyncio.get_running_loop().time() + within_s
        while asyncio.get_running_loop().time() < end_s:
            if self.book.state().token != owner.token:
                return True
            await asyncio.sleep(_LOOK_S)
        return False

    async def _heard(self, owner: ArrayState, within_s: float) -> bool:
        """The owner says that it has stopped; then it has some time to close."""
        heard = self.book.state().state in (SessionState.STOPPED, SessionState.LOCKED)
        return heard and await self._given_back(owner, within_s)

    async def _own_connection(self, owned: bool = False) -> StopReport:
        try:
            halted = await self.halt()
        except (InputError, TransportLost, StreamLost) as error:
            return StopReport(False, "", str(error))
        text = f"stopped by {self.who}: {halted.text}"
        if not halted.sent:
            return StopReport(False, "", halted.text)
        if not owned:
            self._book_stopped(text)
        return StopReport(halted.stopped, "own connection", text)

    def _book_stopped(self, text: str) -> None:
        """A locked array stays locked: a stop does not move arms apart."""
        if state_of(self.book.state()) is not SessionState.LOCKED:
            self.book.note_stopped(text, SessionState.STOPPED)

    async def _interrupt(self, owner: ArrayState, own: StopReport) -> StopReport:
        if owner.host == host_name() and owner.owned:
            os.kill(owner.pid, signal.SIGINT)
            if await self._given_back(owner, AT_REST_S):
                return StopReport(True, "signal", f"{owner.owner} was interrupted: {self.book.state().text}")
        return StopReport(
            False,
            "",
            f"not stopped: {owner.owner} does not answer, and {own.text}; end that process on "
            f"{owner.host}, or cut the power of the positioners",
        )
