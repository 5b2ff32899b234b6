"""Tokens and roles: a file of tokens, logins of browsers, and a limit on wrong tokens."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import stat
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

from fiberloom.errors import InputError
from fiberloom.files import read_text

SHORTEST = 24
"""Letters of a token: 24 of base 64 are 144 bits, which no guessing finds."""
LOGIN_S = 12 * 3600.0
"""A login lasts a night."""
MOST_LOGINS = 200
FAILURES, WITHIN_S = 5, 60.0
"""So many wrong tokens from one address in this time; then it is told to wait."""
MOST_ADDRESSES = 4096


class Role(IntEnum):
    """What a person or program may do; a higher one may do what a lower one may."""

    VIEWER = 1  # look
    OPERATOR = 2  # observe, park, stop, acknowledge
    ENGINEER = 3  # home, recover, exclude

    @property
    def word(self) -> str:
        """In words."""
        return self.name.lower()


@dataclass(frozen=True)
class Identity:
    """A person or program that was recognised."""

    name: str
    role: Role


def _digest(text: str) -> bytes:
    return hashlib.sha256(text.encode()).digest()


class TokenFile:
    """Tokens by a file of its owner alone: one line each, `ROLE NAME TOKEN`; # begins a remark."""

    def __init__(self, known: list[tuple[Identity, bytes]]) -> None:
        self._known = known

    @classmethod
    def read(cls, path: Path) -> TokenFile:
        """Reads a file. InputError where others may read it, and for a line that is not sound."""
        if not path.is_file():
            raise InputError(f"--token-file {path}: no such file; `fiberloom serve --help` shows its form")
        mode = stat.S_IMODE(path.stat().st_mode)
        if mode & 0o077:
            raise InputError(f"--token-file {path}: others may read it ({mode:04o}); chmod 600 {path}")
        lines = read_text(path, 1 << 20).splitlines()
        known = [
            _token_of(line, f"--token-file {path}, line {number}")
            for number, line in enumerate(lines, 1)
            if line.strip() and not line.lstrip().startswith("#")
        ]
        if not known:
            raise InputError(f"--token-file {path}: no token in it; a line is `ROLE NAME TOKEN`")
        return cls(known)

    def identity(self, token: str) -> Identity | None:
        """Whose token it is; None: it is not known. Takes as long for every token."""
        digest, found = _digest(token), None
        for identity, known in self._known:
            if hmac.compare_digest(digest, known):
                found = identity
        return found


def _token_of(line: str, where: str) -> tuple[Identity, bytes]:
    words = line.split()
    roles = {role.word: role for role in Role}
    if len(words) != 3 or words[0] not in roles:
        raise InputError(f"{where}: write `ROLE NAME TOKEN`, with a role of {', '.join(roles)}")
    if len(words[2]) < SHORTEST:
        raise InputError(f"{where}: a token of {len(words[2])} letters; take {SHORTEST} or more, at random")
    return Identity(words[1], roles[words[0]]), _digest(words[2])


class Logins:
    """Browsers that have shown a token: a secret of its own for each, in a cookie."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s, self._lock = clock_s, threading.Lock()
        self._known: dict[bytes, tuple[Identity, float]] = {}

    def begin(self, identity: Identity) -> str:
        """A new login; the content of its cookie. The oldest one ends where there are too many."""
        secret = secrets.token_urlsafe(32)
        with self._lock:
            while len(self._known) >= MOST_LOGINS:
                self._known.pop(next(iter(self._known)))
            self._known[_digest(secret)] = identity, self._clock_s() + LOGIN_S
        return secret

    def identity(self, secret: str) -> Identity | None:
        """Whose login it is; None: it is not known, or over."""
        with self._lock:
            found = self._known.get(_digest(secret))
            if found is None or found[1] < self._clock_s():
                self._known.pop(_digest(secret), None)
                return None
            return found[0]

    def end(self, secret: str) -> None:
        """Logs out."""
        with self._lock:
            self._known.pop(_digest(secret), None)


class Failures:
    """Wrong tokens by address: FAILURES within WITHIN_S, then no token of it is looked at."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s, self._lock = clock_s, threading.Lock()
        self._times: dict[str, deque[float]] = {}

    def count(self, address: str) -> None:
        """One more."""
        with self._lock:
            while len(self._times) >= MOST_ADDRESSES and address not in self._times:
                self._times.pop(next(iter(self._times)))
            self._times.setdefault(address, deque(maxlen=FAILURES)).append(self._clock_s())

    def wait_s(self, address: str) -> float:
        """So long this address has to wait; 0: not at all."""
        with self._lock:
            times = self._times.get(address)
            if times is None or len(times) < FAILURES:
                return 0.0
            return max(times[0] + WITHIN_S - self._clock_s(), 0.0)
