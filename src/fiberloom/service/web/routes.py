"""What can be asked of the service by HTTP: commands, and what is known."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, HTTPException, Request, Response
from fastapi import Path as InPath

from fiberloom.service.array import Author, ServedArray
from fiberloom.service.guard.tokens import Identity, Role
from fiberloom.service.live import plane_about
from fiberloom.service.night.served_night import ServedNight
from fiberloom.service.web.asked import (
    CommandAnswer,
    ExcludeAsked,
    HomeAsked,
    IncludeAsked,
    Number,
    ObserveAsked,
    RecoverAsked,
    RefusalAnswer,
    StopAnswer,
)
from fiberloom.service.web.target_root import TargetRoot

REFUSALS: dict[int | str, dict[str, Any]] = {
    status: {"model": RefusalAnswer, "description": why}
    for status, why in {
        400: "bad input: one line says what, where, what to do",
        401: "log in",
        403: "the role does not allow it, or the request comes from elsewhere",
        409: "the array is not free: who moves it, and since when",
        413: "the body is too large",
        421: "unknown host",
        429: "too many wrong tokens",
    }.items()
}


def needs(role: Role) -> Callable[[Request], Author]:
    """A dependency: who asks, with at least this role. 403 otherwise."""

    def author(request: Request) -> Author:
        who: Identity | None = request.state.identity
        if who is None or who.role < role:
            have = "none" if who is None else who.role.word
            raise HTTPException(403, f"this needs the role {role.word}; yours is {have}")
        return Author(who.name, who.role.word)

    return author


Viewer = Annotated[Author, Depends(needs(Role.VIEWER))]
Operator = Annotated[Author, Depends(needs(Role.OPERATOR))]
Engineer = Annotated[Author, Depends(needs(Role.ENGINEER))]
Key = Annotated[str, Header(alias="Idempotency-Key", max_length=100)]
PositionerPath = Annotated[int, InPath(ge=0, lt=2**31)]


def routes(array: ServedArray, root: TargetRoot, night: ServedNight | None) -> APIRouter:
    """All routes below /api of an `array`, with lists below a `root`; the snapshot has its `night` too."""
    router = APIRouter(prefix="/api", responses=REFUSALS)
    _stop(router, array)
    _commands(router, array, root)
    _at_once(router, array)
    _known(router, array, night)
    _lists(router, root)
    return router


def _stop(router: APIRouter, array: ServedArray) -> None:
    @router.post("/stop")
    async def stop(author: Operator) -> StopAnswer:
        """Brings everything to rest, at once: no confirmation, no limit. The record is written afterwards."""
        running = array.stop_own(author)
        if running is not None:
            text = f"stopping {running.name} of {running.author.name}"
        else:
            text = await asyncio.to_thread(array.stop_others, author)
        await asyncio.to_thread(array.record_stop, author, text)
        return StopAnswer(stopping="" if running is None else running.name, text=text)


def _commands(router: APIRouter, array: ServedArray, root: TargetRoot) -> None:
    @router.post("/v1/observe", status_code=202)
    def observe(asked: ObserveAsked, author: Operator, key: Key = "") -> CommandAnswer:
        """Begins to observe a target list; the answer tells the command's number."""
        found = array.observe(author, root.path(asked.targets), asked.corrections, key)
        return CommandAnswer(**found.as_dict())

    @router.post("/v1/park", status_code=202)
    def park(author: Operator, key: Key = "") -> CommandAnswer:
        """Begins to fold every positioner."""
        return CommandAnswer(**array.park(author, key).as_dict())

    @router.post("/v1/home", status_code=202)
    def home(asked: HomeAsked, author: Engineer, key: Key = "") -> CommandAnswer:
        """Begins to search datums, in an order in which no arms can meet."""
        return CommandAnswer(**array.home(author, asked.positioners, key).as_dict())

    @router.post("/v1/recover", status_code=202)
    def recover(asked: RecoverAsked, author: Engineer, key: Key = "") -> CommandAnswer:
        """After a collision: begins to take arms apart, and unlocks the array when nothing touches."""
        return CommandAnswer(**array.recover(author, asked.look, key).as_dict())


def _at_once(router: APIRouter, array: ServedArray) -> None:
    @router.post("/v1/exclude")
    def exclude(asked: ExcludeAsked, author: Engineer) -> list[dict[str, Any]]:
        """Leaves positioners where they are from the next command on; answers with all that are excluded."""
        array.exclude(author, asked.positioners, asked.why, asked.until)
        return array.exclusions()

    @router.post("/v1/include")
    def include(asked: IncludeAsked, author: Engineer) -> list[dict[str, Any]]:
        """Ends exclusions; answers with those that are left."""
        array.include(author, asked.positioners)
        return array.exclusions()

    @router.post("/v1/alarms/{number}/acknowledge")
    def acknowledge(number: Number, author: Operator) -> dict[str, Any]:
        """Says that a person knows of an alarm."""
        return array.acknowledge(author, number).as_dict()


def _known(router: APIRouter, array: ServedArray, night: ServedNight | None) -> None:
    about = plane_about(array.field.plane)

    @router.get("/v1/plane")
    def plane(_: Viewer) -> dict[str, Any]:
        """The layout: where positioners are, and their arms. mm and rad."""
        return about

    @router.get("/v1/state")
    def state(_: Viewer) -> dict[str, Any]:
        """All that is known now, with the number of the last event that is in it."""
        return snapshot(array) | {"night": None if night is None else night.view()}

    @router.get("/v1/plan", responses={200: {"content": {"application/octet-stream": {}}}})
    def plan(_: Viewer) -> Response:
        """The last plan that was executed: step in s (float32), T, N (uint32), then T x N alpha and beta in
        deg (float32), little-endian. Empty before the first."""
        found = array.live.plan()
        content = b"" if found is None else found.packed()
        return Response(content, media_type="application/octet-stream")

    @router.get("/v1/positioners/{positioner_id}")
    def positioner(positioner_id: PositionerPath, _: Viewer) -> dict[str, Any]:
        """What is on record of one positioner: measurements, events, exclusions, and health's verdict."""
        return array.history(positioner_id)

    @router.get(
        "/v1/positioners/{positioner_id}/image",
        responses={200: {"content": {"image/png": {}}}},
        response_class=Response,
    )
    def image(positioner_id: PositionerPath, _: Viewer) -> Response:
        """The last image around the metrology fibre of one positioner: a cross at its measured centroid, a
        ring at its goal."""
        return Response(array.cutout(positioner_id), media_type="image/png")

    @router.get("/v1/commands")
    def commands(_: Viewer) -> list[CommandAnswer]:
        """The last commands with their authors, the newest first."""
        return [CommandAnswer(**command.as_dict()) for command in array.commands.last()]

    @router.get("/v1/commands/{number}")
    def command(number: Number, _: Viewer) -> CommandAnswer:
        """One command: how it goes, or how it ended."""
        found = array.commands.get(number)
        if found is None:
            raise HTTPException(400, f"command {number}: there is none")
        return CommandAnswer(**found.as_dict())


def _lists(router: APIRouter, root: TargetRoot) -> None:
    @router.get("/v1/targets")
    def targets(_: Viewer) -> list[dict[str, Any]]:
        """Target lists that can be observed."""
        return root.names()

    @router.put("/v1/targets/{name}")
    async def put(name: str, request: Request, _: Operator) -> dict[str, Any]:
        """Keeps a target list (the body is the file) under a name; answers with how many targets it has."""
        content = await request.body()
        return {"name": name, "targets": await asyncio.to_thread(root.save, name, content)}


def snapshot(array: ServedArray) -> dict[str, Any]:
    """All that the page shows, with the number of the last event that is in it."""
    live, sequence = array.live, array.hub.sequence
    running = array.running
    return {
        "seq": sequence,
        "array": array.state(),
        "running": None if running is None else running.as_dict(),
        "states": live.states(),
        "seen": live.seen_about(),
        "plan": live.plan_about(),
        "stages": live.stages(),
        "alarms": [alarm.as_dict() for alarm in array.alarms.open()],
        "exclusions": array.exclusions(),
        "ready": array.ready(),
    }
