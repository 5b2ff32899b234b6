"""The application: routes, page, stream and figures behind the wall."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.resources import files
from typing import Any

from fastapi import FastAPI, HTTPException, Request, Response
from fastapi.responses import JSONResponse
from starlette.websockets import WebSocket

from fiberloom.errors import InputError
from fiberloom.observatory.interfaces import Interfaces
from fiberloom.service.array import Busy, ServedArray
from fiberloom.service.guard.tokens import Identity
from fiberloom.service.guard.wall import COOKIE, Gate, Wall, cookie_of
from fiberloom.service.logs import log_event
from fiberloom.service.metrics import Metrics
from fiberloom.service.night.served_night import ServedNight
from fiberloom.service.port import ServedPort
from fiberloom.service.web.asked import WhoAnswer
from fiberloom.service.web.night_routes import night_routes
from fiberloom.service.web.routes import REFUSALS, Viewer, routes
from fiberloom.service.web.stream import serve_stream, show_pictures
from fiberloom.service.web.target_root import TargetRoot
from fiberloom.version import __version__

KINDS = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}


def application(
    array: ServedArray,
    gate: Gate,
    root: TargetRoot,
    night: ServedNight | None = None,
    interfaces: Interfaces | None = None,
) -> FastAPI:
    """The service of an `array`, behind a `gate`, with target lists below a `root`, and of its `night`.

    `interfaces`: of an observatory, which show the same array.
    """
    metrics = Metrics(array)
    array.hub.listeners += [metrics.event, log_event]

    @asynccontextmanager
    async def alive(_: FastAPI) -> AsyncIterator[None]:
        pictures = asyncio.create_task(show_pictures(array.hub, array.live, metrics))
        async with (interfaces or Interfaces()).shown(ServedPort(array, root, night)):
            yield
        pictures.cancel()

    app = FastAPI(
        title="fiberloom", version=__version__, lifespan=alive, docs_url=None, redoc_url=None,
        description="One array of fibre positioners: its state, its commands.",
    )  # fmt: skip
    app.add_middleware(Wall, gate=gate)
    app.include_router(routes(array, root, night))
    if night is not None:
        app.include_router(night_routes(night, root))
    _errors(app)
    _logins(app, gate)
    _page(app)
    _figures(app, array, metrics)

    @app.websocket("/api/v1/stream")
    async def stream(socket: WebSocket) -> None:
        await serve_stream(socket, array.hub, array.live)

    return app


def _errors(app: FastAPI) -> None:
    @app.exception_handler(Busy)
    async def busy(_: Request, error: Exception) -> JSONResponse:
        return JSONResponse({"detail": str(error)}, 409)

    @app.exception_handler(InputError)
    async def bad(_: Request, error: Exception) -> JSONResponse:
        return JSONResponse({"detail": str(error)}, 400)


def _logins(app: FastAPI, gate: Gate) -> None:
    def who(identity: Identity) -> WhoAnswer:
        return WhoAnswer(name=identity.name, role=identity.role.word, tokens=gate.tokens is not None)

    @app.post("/api/v1/login", responses=REFUSALS)
    async def login(request: Request, response: Response) -> WhoAnswer:
        """Takes a bearer token, and gives a cookie that scripts of a page cannot read."""
        identity: Identity | None = request.state.identity
        if identity is None:
            raise HTTPException(401, "show a token: Authorization: Bearer ...")
        if gate.tokens is not None:
            response.set_cookie(
                COOKIE, gate.logins.begin(identity), httponly=True, samesite="strict",
                secure=gate.scheme == "https", path="/",
            )  # fmt: skip
        return who(identity)

    @app.post("/api/v1/logout", responses=REFUSALS)
    async def logout(request: Request, response: Response, _: Viewer) -> dict[str, bool]:
        """Ends the login of this cookie."""
        gate.logins.end(cookie_of(dict(request.scope["headers"])))
        response.delete_cookie(COOKIE, httponly=True, samesite="strict", path="/")
        return {"out": True}

    @app.get("/api/v1/whoami", responses=REFUSALS)
    async def whoami(request: Request) -> WhoAnswer:
        """Who asks, and with which role: none where a token is to be shown first."""
        identity: Identity | None = request.state.identity
        return WhoAnswer(name="", role="none", tokens=True) if identity is None else who(identity)


def _page(app: FastAPI) -> None:
    page = {file.name: file.read_bytes() for file in (files("fiberloom.service") / "page").iterdir()}

    def answer(name: str) -> Response:
        kind = KINDS["." + name.rsplit(".", 1)[-1]]
        return Response(page[name], media_type=kind, headers={"x-fiberloom-version": __version__})

    @app.get("/", include_in_schema=False)
    async def index() -> Response:
        return answer("index.html")

    @app.get("/page/{name}", include_in_schema=False)
    async def file(name: str) -> Response:
        if name not in page:  # no path is ever made of it
            raise HTTPException(404, "no such file")
        return answer(name)


def _figures(app: FastAPI, array: ServedArray, metrics: Metrics) -> None:
    @app.get("/healthz")
    async def healthz() -> dict[str, bool]:
        """The process is alive."""
        return {"ok": True}

    @app.get("/readyz", responses={503: {"description": "a command could not begin now"}})
    def readyz() -> JSONResponse:
        """Whether a command could begin: store, bus, camera, maps; 503 where not."""
        found: dict[str, Any] = array.ready()
        return JSONResponse(found, 200 if all(found.values()) else 503)

    @app.get("/metrics", responses={200: {"content": {"text/plain": {}}}, **REFUSALS})
    def figures(_: Viewer) -> Response:
        """Figures for Prometheus."""
        return Response(metrics.text(), media_type="text/plain; version=0.0.4; charset=utf-8")
