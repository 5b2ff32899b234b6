"""The wall before the service: hosts, origins, tokens, cookies, sizes; and headers on every answer.

Everything is refused here before a route sees it. A request that changes something needs the header
`X-Fiberloom`, which no form of a foreign page can send, and comes from an origin of ours.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from typing import Any

from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from fiberloom.service.guard.tokens import Failures, Identity, Logins, TokenFile

HEADER = b"x-fiberloom"
COOKIE = "fiberloom"
SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
BODY_BYTES, UPLOAD_BYTES = 1 << 16, 16 << 20
"""Of a command; of a target list that is sent."""
TARGETS = "/api/v1/targets/"
STOP = "/api/stop"
OPEN = frozenset({"/", "/healthz", "/readyz", "/openapi.json", "/api/v1/login", "/api/v1/whoami"})
"""Needs no identity: nothing of the array is in it, or it gives one."""
PAGE = "/page/"

HEADERS = (
    (b"content-security-policy", b"default-src 'self'; frame-ancestors 'none'; base-uri 'none'"),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)
"""On every answer."""

_log = logging.getLogger("fiberloom.service")


class TurnedAway(Exception):
    """A request that goes no further: status, what is wrong and what to do."""

    def __init__(self, status: int, text: str, more: dict[bytes, bytes] | None = None) -> None:
        super().__init__(text)
        self.status, self.text, self.more = status, text, more or {}


@dataclass
class Gate:
    """Decides on one request."""

    hosts: frozenset[str]
    """Names (with port) by which the service may be asked, in lower letters."""
    scheme: str
    """http or https."""
    tokens: TokenFile | None
    """None: on loopback alone, where each is the user of this machine."""
    local: Identity
    """Who asks without tokens."""
    logins: Logins = field(default_factory=Logins)
    failures: Failures = field(default_factory=Failures)

    def identity(self, scope: Scope) -> Identity | None:
        """Checks a request and says whose it is; None: unknown. TurnedAway where it may go no further."""
        headers = _headers(scope)
        self._check_host(headers)
        method = scope.get("method", "GET")
        token = _bearer(headers)
        changes = scope["type"] == "websocket" or method not in SAFE
        if changes:
            self._check_origin(headers, token is not None)
        if changes and scope["type"] == "http" and HEADER not in headers:
            raise TurnedAway(403, "the header X-Fiberloom is missing: send X-Fiberloom: 1")
        return self._who(scope, headers, token)

    def _check_host(self, headers: dict[bytes, bytes]) -> None:
        host = headers.get(b"host", b"").decode("latin-1").lower()
        if host not in self.hosts:
            raise TurnedAway(421, "unknown host: name it by --allow-host, if it is one of this machine's")

    def _check_origin(self, headers: dict[bytes, bytes], by_token: bool) -> None:
        origin = headers.get(b"origin")
        if origin is None and by_token:  # no browser: it shows a token that no foreign page has
            return
        ours = {f"{self.scheme}://{host}" for host in self.hosts}
        if origin is None or origin.decode("latin-1").lower() not in ours:
            raise TurnedAway(403, "the Origin is not that of this service")

    def _who(self, scope: Scope, headers: dict[bytes, bytes], token: str | None) -> Identity | None:
        if self.tokens is None:
            return self.local
        if token is not None:
            return self._by_token(scope, self.tokens, token)
        secret = cookie_of(headers)
        return self.logins.identity(secret) if secret else None

    def _by_token(self, scope: Scope, tokens: TokenFile, token: str) -> Identity:
        address = str((scope.get("client") or ("",))[0])
        # a stop is never made to wait, whatever was tried before it
        if scope["path"] != STOP and (wait_s := self.failures.wait_s(address)) > 0.0:
            again = str(int(wait_s) + 1).encode()
            raise TurnedAway(429, "too many wrong tokens; wait a minute", {b"retry-after": again})
        found = tokens.identity(token)
        if found is None:
            self.failures.count(address)
            _log.warning("wrong token from %s", address)
            raise TurnedAway(401, "this token is not known")
        return found


class Wall:
    """ASGI middleware: `gate` before an application."""

    def __init__(self, app: ASGIApp, gate: Gate) -> None:
        self._app, self._gate = app, gate

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request: `scope`, `receive` and `send` as of ASGI."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        guarded = _with_headers(send)
        try:
            identity = self._gate.identity(scope)
            if identity is None and not _is_open(scope["path"]):
                raise TurnedAway(401, "log in: show a token", {b"www-authenticate": b"Bearer"})
            scope.setdefault("state", {})["identity"] = identity
            limit = _limit_of(scope)
            _check_length(scope, limit)
        except TurnedAway as refusal:
            await _refuse(scope, receive, guarded, refusal)
            return
        if scope["type"] == "websocket":
            await self._app(scope, receive, send)
            return
        await self._limited(scope, receive, guarded, limit)

    async def _limited(self, scope: Scope, receive: Receive, send: Send, limit: int) -> None:
        """The application, with a body of no more than so many bytes, also where its length is not told."""
        taken = 0

        async def bounded() -> Message:
            nonlocal taken
            message = await receive()
            taken += len(message.get("body", b""))
            if taken > limit:
                raise HTTPException(413, f"larger than {limit} bytes")
            return message

        await self._app(scope, bounded, send)


def cookie_of(headers: dict[bytes, bytes]) -> str:
    """The secret of a login in the headers of a request; empty: none."""
    jar: SimpleCookie = SimpleCookie()
    try:
        jar.load(headers.get(b"cookie", b"").decode("latin-1"))
    except CookieError:
        return ""
    return jar[COOKIE].value if COOKIE in jar else ""


def hosts_of(listen: str, port: int, further: Iterable[str]) -> frozenset[str]:
    """Names with port by which a service is asked that listens at an address; `further`: by name."""
    names = {listen, *further, *(("localhost", "127.0.0.1", "[::1]") if is_loopback(listen) else ())}
    named = {f"[{n}]" if ":" in n and not n.startswith("[") and n.count(":") > 1 else n for n in names}
    whole = {n if ":" in n.rsplit("]", 1)[-1] else f"{n}:{port}" for n in named}
    default = {n.rsplit(":", 1)[0] for n in whole if n.endswith((":80", ":443"))}
    return frozenset(n.lower() for n in whole | default)


def is_loopback(listen: str) -> bool:
    """Whether only this machine can ask."""
    return listen in ("localhost", "::1", "[::1]") or listen.startswith("127.")


def _headers(scope: Scope) -> dict[bytes, bytes]:
    """By name. Of two of one name, as no browser sends, none counts."""
    found: dict[bytes, bytes] = {}
    twice: set[bytes] = set()
    for name, value in scope["headers"]:
        twice |= {name} & found.keys()
        found[name] = value
    return {name: value for name, value in found.items() if name not in twice}


def _bearer(headers: dict[bytes, bytes]) -> str | None:
    kind, _, token = headers.get(b"authorization", b"").decode("latin-1").partition(" ")
    return token.strip() if kind.lower() == "bearer" else None


def _is_open(path: str) -> bool:
    return path in OPEN or path.startswith(PAGE)


def _limit_of(scope: Scope) -> int:
    return UPLOAD_BYTES if scope["path"].startswith(TARGETS) else BODY_BYTES


def _check_length(scope: Scope, limit: int) -> None:
    said = dict(scope["headers"]).get(b"content-length", b"0")
    if not said.isdigit() or int(said[:20]) > limit:
        raise TurnedAway(413, f"larger than {limit} bytes")


def _with_headers(send: Send) -> Send:
    async def sent(message: Message) -> None:
        if message["type"] in ("http.response.start", "websocket.http.response.start"):
            there = [(k, v) for k, v in message.get("headers", [])]
            message = {**message, "headers": [*there, *HEADERS]}
        await send(message)

    return sent


Sender = Callable[[Message], Awaitable[None]]


async def _refuse(scope: Scope, receive: Receive, send: Sender, refusal: TurnedAway) -> None:
    _log.info("refused %s %s: %d %s", scope["type"], scope["path"][:200], refusal.status, refusal.text)
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 4000 + refusal.status, "reason": refusal.text})
        return
    body = json.dumps({"detail": refusal.text}).encode()
    head: dict[str, Any] = {"type": "http.response.start", "status": refusal.status}
    plain = {b"content-type": b"application/json", b"content-length": str(len(body)).encode()}
    # what is left of a body that is too large is not read: the connection ends
    closed = {b"connection": b"close"} if refusal.status == 413 else {}
    await send({**head, "headers": list((plain | closed | refusal.more).items())})
    await send({"type": "http.response.body", "body": body})
