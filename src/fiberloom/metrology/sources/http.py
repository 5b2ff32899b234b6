"""HTTP calls to a camera, each within the exposure's deadline."""

from __future__ import annotations

import http.client
import socket
from contextlib import suppress
from urllib.parse import urlencode

import numpy as np

from fiberloom.metrology.sources.deadline import Deadline
from fiberloom.metrology.sources.errors import CameraRefused, CameraSilent, ImageBroken

CALL_S = 10.0
"""A call other than for the image may take so long."""
ANSWER_BYTES = 1 << 20
"""Longest answer of such a call."""
_CHUNK_BYTES = 1 << 20
_TEXT_BYTES = 200

_Parameters = dict[str, str]


class CameraHttp:
    """One connection to `host` and `port`, for one exposure; ends with its `deadline`."""

    def __init__(self, host: str, port: int, deadline: Deadline) -> None:
        self.camera, self._deadline = deadline.camera, deadline
        self._connection = http.client.HTTPConnection(host, port, timeout=CALL_S)
        self._socket: socket.socket | None = None
        deadline.at_end(self._cut)

    @property
    def reached(self) -> bool:
        """Whether the host has taken a connection."""
        return self._socket is not None

    def close(self) -> None:
        """Hangs up."""
        self._connection.close()

    def get(
        self, path: str, query: _Parameters, *, accept: str = "application/json", limit: int = ANSWER_BYTES
    ) -> tuple[str, memoryview]:
        """Content type and body, at most `limit` bytes, of `path` with its `query`, in a form to `accept`.

        Raises CameraSilent, CameraRefused, ImageBroken.
        """
        target = f"{path}?{urlencode(query)}"
        whole = limit > ANSWER_BYTES
        try:
            return self._call("GET", target, None, {"Accept": accept}, limit)
        except CameraSilent:
            # an idle connection that the server has closed: a question may be asked twice
            if whole or self._socket is None:
                raise
            self._deadline.check()
            return self._call("GET", target, None, {"Accept": accept}, limit)

    def put(self, path: str, form: _Parameters) -> memoryview:
        """The body of the answer to a `form` sent to `path`. Raises as `get`."""
        headers = {"Content-Type": "application/x-www-form-urlencoded", "Accept": "application/json"}
        return self._call("PUT", path, urlencode(form), headers, ANSWER_BYTES)[1]

    def _call(
        self, verb: str, target: str, body: str | None, headers: _Parameters, limit: int
    ) -> tuple[str, memoryview]:
        try:
            self._connect(limit > ANSWER_BYTES)
            self._connection.request(verb, target, body, headers)
            response = self._connection.getresponse()
            data = self._read(response, limit)
        except (OSError, http.client.HTTPException, ValueError) as error:
            self._connection.close()
            self._deadline.check()
            what = type(error).__name__ if not str(error) else str(error)
            raise CameraSilent(
                f"{self.camera}: no answer ({what}); is its program running, and is this its address?"
            ) from None
        if response.status != http.client.OK:
            text = bytes(data[:_TEXT_BYTES]).decode(errors="replace").strip()
            raise CameraRefused(
                f"{self.camera}: answers {response.status} {response.reason} to {target.partition('?')[0]}: "
                f"{text or 'without a word'}"
            )
        return response.headers.get("Content-Type", ""), data

    def _connect(self, long: bool) -> None:
        left_s = self._deadline.left_s()
        allowed_s = left_s if long else min(left_s, CALL_S)
        if self._connection.sock is None:
            self._connection.timeout = allowed_s
            self._connection.connect()
            self._socket = self._connection.sock
        self._connection.sock.settimeout(allowed_s)

    def _read(self, response: http.client.HTTPResponse, limit: int) -> memoryview:
        """All of it, or an error: a body that ends early is no image."""
        length = response.length
        if length is not None and length > limit:
            self._connection.close()
            raise ImageBroken(f"{self.camera}: {length} bytes announced, at most {limit} are an image here")
        if length is None:
            return memoryview(self._read_unknown(response, limit))
        data = self._read_known(response, length)
        if len(data) < length:
            self._deadline.check()
            raise ImageBroken(
                f"{self.camera}: {len(data)} of {length} bytes came, then the connection ended: cut short"
            )
        return data

    def _read_known(self, response: http.client.HTTPResponse, length: int) -> memoryview:
        # not a bytearray: to fill that with zeros holds Python's lock for a tenth of a second
        data, there = np.empty(length, np.uint8).data, 0
        while there < length and (n := response.readinto(data[there : there + _CHUNK_BYTES])):
            there += n
            self._deadline.check()
        return data[:there]

    def _read_unknown(self, response: http.client.HTTPResponse, limit: int) -> bytearray:
        """In chunks, or to the end of the connection."""
        data = bytearray()
        while piece := response.read(_CHUNK_BYTES):
            self._deadline.check()
            data += piece
            if len(data) > limit:
                self._connection.close()
                raise ImageBroken(f"{self.camera}: more than {limit} bytes: no image of this camera")
        return data

    def _cut(self) -> None:
        """Ends a read that waits; the connection is of no use afterwards."""
        if self._socket is not None:
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
