"""Servers that misbehave, for clients of cameras."""

import json
import socket
import threading
import time
from contextlib import contextmanager

import numpy as np

from fiberloom.metrology.images import utc_text
from fiberloom.metrology.sources import imagebytes

SILENT_S = 60.0
"""So long a server that has nothing to say keeps a connection."""


@contextmanager
def server_that(answer):
    """`answer(connection, request)` serves each request of each connection; yields the port."""
    listening = socket.create_server(("127.0.0.1", 0))
    listening.settimeout(0.1)
    over = threading.Event()

    def serve(connection):
        with connection:
            connection.settimeout(SILENT_S)
            rest = b""
            while not over.is_set():
                try:
                    while b"\r\n\r\n" not in rest:
                        if not (piece := connection.recv(65536)):
                            return
                        rest += piece
                    head, _, rest = rest.partition(b"\r\n\r\n")
                    length = next(
                        (
                            int(x.split(b":")[1])
                            for x in head.split(b"\r\n")
                            if x.lower().startswith(b"content-le")
                        ),
                        0,
                    )
                    while len(rest) < length:
                        rest += connection.recv(65536)
                    body, rest = rest[:length], rest[length:]
                    answer(connection, head.split(b"\r\n")[0].decode(), body.decode())
                except OSError:
                    return

    def accept():
        while not over.is_set():
            try:
                connection, _ = listening.accept()
            except TimeoutError:
                continue
            threading.Thread(target=serve, args=(connection,), daemon=True).start()

    thread = threading.Thread(target=accept, daemon=True)
    thread.start()
    try:
        yield listening.getsockname()[1]
    finally:
        over.set()
        thread.join()
        listening.close()


def http(body: bytes, kind="application/json", status="200 OK", length=None):
    """An answer; `length` that it announces, when it lies."""
    n = len(body) if length is None else length
    return f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {n}\r\n\r\n".encode() + body


class FakeCamera:
    """An Alpaca camera of 6 x 4 px whose members can be overridden: `says[member] = answer(connection)`."""

    def __init__(self, shape=(4, 6)):
        self._count, self._shape = 0, shape
        self.says, self.asked = {}, []
        self.values = {
            "cameraxsize": shape[1], "cameraysize": shape[0], "sensortype": 0, "maxadu": 60000,
            "electronsperadu": 1.5, "imageready": True, "camerastate": 0, "lastexposureduration": 0.0,
        }  # fmt: skip
        self.begun = lambda: utc_text(time.time())

    def pixels(self):
        """A new image each time."""
        self._count += 1
        n = self._shape[0] * self._shape[1]
        return (np.arange(n, dtype=np.uint16) + 100 * self._count).reshape(self._shape)

    def __call__(self, connection, request, body):
        member = request.split()[1].split("?")[0].rsplit("/", 1)[1]
        self.asked.append(member)
        if member in self.says:
            self.says[member](connection)
        elif member == "imagearray":
            connection.sendall(http(b"".join(imagebytes.pack(self.pixels())), imagebytes.CONTENT_TYPE))
        elif member == "lastexposurestarttime":
            connection.sendall(value(self.begun()))
        else:
            connection.sendall(value(self.values.get(member)))


def value(said, number=0, text=""):
    answer = {"Value": said, "ErrorNumber": number, "ErrorMessage": text}
    return http(json.dumps(answer).encode())
