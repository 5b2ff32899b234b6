"""The twin's Alpaca camera says where it is when a host asks the whole network (Alpaca discovery by UDP)."""

from __future__ import annotations

import json
import socket
import threading
from contextlib import suppress

from fiberloom.metrology.sources.alpaca import DISCOVERY_KEY, DISCOVERY_PORT, DISCOVERY_QUESTION
from fiberloom.twin.server.address import Address, reachable_from_outside

_QUESTION_BYTES = 64
_LOOK_S = 0.1
"""How often it is looked whether it is closed."""


class DiscoveryAnswer:
    """Answers for the camera at `alpaca` on UDP `port`, until `close`; port 0: one that the system chooses.

    The port is shared with other servers of the machine. A camera at a loopback address answers hosts of the
    same machine alone. OSError where the port cannot be had.
    """

    def __init__(self, alpaca: Address, port: int = DISCOVERY_PORT) -> None:
        self._answer = json.dumps({DISCOVERY_KEY: alpaca.port}).encode()
        self._only_here = not reachable_from_outside([alpaca])
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind(("", port))  # a question to all reaches no narrower address
        except OSError:
            self._socket.close()
            raise
        self.port = int(self._socket.getsockname()[1])
        self._socket.settimeout(_LOOK_S)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Answers no longer."""
        self._over.set()
        self._thread.join()
        self._socket.close()

    def _serve(self) -> None:
        while not self._over.is_set():
            with suppress(OSError):  # of the time-out, or of a host that has gone
                said, host = self._socket.recvfrom(_QUESTION_BYTES)
                if said.startswith(DISCOVERY_QUESTION) and self._is_meant(host[0]):
                    self._socket.sendto(self._answer, host)

    def _is_meant(self, host: str) -> bool:
        return not (self._only_here and reachable_from_outside([Address(host, self.port)]))
