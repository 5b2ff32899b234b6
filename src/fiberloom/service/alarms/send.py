"""Alarms to people outside: by a webhook or by a command. What cannot be sent is in the log."""

from __future__ import annotations

import json
import logging
import queue
import shlex
import subprocess
import threading
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from urllib.parse import urlsplit

from fiberloom.errors import InputError, one_line
from fiberloom.store.service.alarms import Alarm

MOST_WAITING = 100
TIMEOUT_S = 10.0

_log = logging.getLogger("fiberloom.service")


def by_webhook(url: str) -> Callable[[bytes], None]:
    """Sends JSON by POST to an address. InputError where it is none of http or https."""
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise InputError(f"--alarm-webhook {url}: give an address, e.g. https://chat.example.org/hook/12")

    def send(body: bytes) -> None:
        request = urllib.request.Request(url, body, {"Content-Type": "application/json"}, method="POST")
        with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:  # the scheme is checked above
            answer.read(1)

    return send


def by_command(text: str) -> Callable[[bytes], None]:
    """Runs a command with the JSON as its input, without a shell. InputError where it cannot be read."""
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise InputError(f"--alarm-command {text}: {error}") from None
    if not words:
        raise InputError("--alarm-command: name a program, e.g. 'mail -s fiberloom night@example.org'")

    def send(body: bytes) -> None:
        subprocess.run(words, input=body, timeout=TIMEOUT_S, check=True, capture_output=True)

    return send


@dataclass(frozen=True)
class _End:
    """Ends the thread."""


class AlarmSender:
    """A thread that sends alarms; where too many wait, new ones are dropped, and the log says so."""

    def __init__(self, ways: list[Callable[[bytes], None]]) -> None:
        self._ways, self._queue = ways, queue.Queue[Alarm | _End](MOST_WAITING)
        self._thread = threading.Thread(target=self._run, name="fiberloom-alarms", daemon=True)
        if ways:
            self._thread.start()

    def send(self, alarm: Alarm) -> None:
        """Hands over an alarm; returns at once."""
        if not self._ways:
            return
        try:
            self._queue.put_nowait(alarm)
        except queue.Full:
            _log.error("alarm %s of %s not sent: too many wait", alarm.code, alarm.subject)

    def close(self) -> None:
        """Sends what waits, for some seconds, and ends."""
        if self._thread.is_alive():
            self._queue.put(_End())
            self._thread.join(TIMEOUT_S)

    def _run(self) -> None:
        while not isinstance(alarm := self._queue.get(), _End):
            body = json.dumps(alarm.as_dict()).encode()
            for way in self._ways:
                try:
                    way(body)
                except (OSError, subprocess.SubprocessError, ValueError) as error:
                    _log.error("alarm %s of %s not sent: %s", alarm.code, alarm.subject, one_line(error))
