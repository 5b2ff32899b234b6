"""Boards of the twin within the process, in virtual time: the same bytes as over TCP, only sooner."""

from __future__ import annotations

import heapq

from fiberloom.drive.pfs.streams import Connect, Stream, StreamLost
from fiberloom.twin.cobras.array import CobraArray
from fiberloom.twin.cobras.boards import Boards


class VirtualBoards:
    """Boards with a clock that runs while a client waits."""

    def __init__(self, array: CobraArray, unpowered: set[int] | None = None) -> None:
        self.now_s = 0.0
        self.boards = Boards(array, lambda: self.now_s, unpowered or set())
        self.open: VirtualStream | None = None
        self.listening = True
        """False: no connection is answered."""

    def connector(self) -> Connect:
        """What a client connects by."""

        async def connect() -> Stream:
            if not self.listening:
                raise StreamLost("FPGA of the twin: it does not listen")
            self.boards.connected()
            self.open = VirtualStream(self)
            return self.open

        return connect

    def cut(self) -> None:
        """The connection drops now; motors that run go on."""
        if self.open is not None:
            self.open.lost = True


class VirtualStream:
    """One connection. Implements `fiberloom.drive.pfs.streams.Stream`."""

    def __init__(self, owner: VirtualBoards) -> None:
        self._owner, self.lost = owner, False
        self._coming: list[tuple[float, int, bytes]] = []
        self._order = 0
        self._here = b""

    @property
    def time_s(self) -> float:
        """Virtual."""
        return self._owner.now_s

    async def write(self, data: bytes) -> None:
        """To the boards, at once."""
        if self.lost:
            raise StreamLost("FPGA of the twin: the connection was cut")
        for answer in self._owner.boards.take(data):
            self._order += 1
            heapq.heappush(self._coming, (answer.at_s, self._order, answer.data))

    async def read(self, size: int, timeout_s: float) -> bytes:
        """Time runs to the answers, or to the end of the time given."""
        until_s = self._owner.now_s + max(timeout_s, 0.0)
        while len(self._here) < size:
            if self.lost:
                raise StreamLost("FPGA of the twin: the connection was cut")
            if not self._coming or self._coming[0][0] > until_s:
                self._owner.now_s = max(until_s, self._owner.now_s)
                raise TimeoutError
            at_s, _, data = heapq.heappop(self._coming)
            self._owner.now_s = max(at_s, self._owner.now_s)
            self._here += data
        data, self._here = self._here[:size], self._here[size:]
        return data

    async def sleep(self, duration_s: float) -> None:
        """Time runs."""
        self._owner.now_s += max(duration_s, 0.0)

    async def close(self) -> None:
        """Answers that come later are lost."""
        self.lost, self._coming = True, []
