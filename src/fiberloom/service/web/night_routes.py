"""What can be asked of a night by HTTP: how it goes, and orders of an operator."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter

from fiberloom.service.night.served_night import ServedNight
from fiberloom.service.web.asked import (
    AddFieldAsked,
    CommandAnswer,
    NightAsked,
    Number,
    PriorityAsked,
    SkipAsked,
)
from fiberloom.service.web.routes import REFUSALS, Key, Operator, Viewer
from fiberloom.service.web.target_root import TargetRoot


def night_routes(night: ServedNight, root: TargetRoot) -> APIRouter:
    """All routes below /api/v1/night; lists of added fields are below the `root`."""
    router = APIRouter(prefix="/api/v1/night", responses=REFUSALS)
    _whole(router, night)
    _fields(router, night, root)
    return router


def _whole(router: APIRouter, night: ServedNight) -> None:
    @router.get("")
    def view(_: Viewer) -> dict[str, Any]:
        """The night: its clock, stages as bars, what comes next, fields, alarms."""
        return night.view()

    @router.post("/begin", status_code=202)
    def begin(asked: NightAsked, author: Operator, key: Key = "") -> CommandAnswer:
        """Begins the night of the queue, or resumes the last one; `POST /api/stop` stops it."""
        return CommandAnswer(**night.begin(author, asked.resume, key).as_dict())

    @router.post("/pause")
    def pause(author: Operator) -> dict[str, Any]:
        """Nothing begins after what is under way, until `go_on`."""
        night.pause(author)
        return night.view()

    @router.post("/go_on")
    def go_on(author: Operator) -> dict[str, Any]:
        """The night goes on after a pause."""
        night.go_on(author)
        return night.view()

    @router.post("/park")
    def park(author: Operator) -> dict[str, Any]:
        """Ends what moves, folds all and ends the night; an exposure under way ends first, by itself."""
        night.park(author)
        return night.view()

    @router.post("/alarms/{number}/acknowledge")
    def acknowledge(number: Number, author: Operator) -> dict[str, Any]:
        """Says that a person knows of an alarm of the night."""
        night.acknowledge(author, number)
        return night.view()


def _fields(router: APIRouter, night: ServedNight, root: TargetRoot) -> None:
    @router.post("/skip")
    def skip(asked: SkipAsked, author: Operator) -> dict[str, Any]:
        """Leaves a field out; an exposure of it that is under way ends first."""
        night.skip(author, asked.field)
        return night.view()

    @router.post("/priority")
    def priority(asked: PriorityAsked, author: Operator) -> dict[str, Any]:
        """Moves a field in the queue: a higher priority comes first."""
        night.set_priority(author, asked.field, asked.priority)
        return night.view()

    @router.post("/fields")
    def add(asked: AddFieldAsked, author: Operator) -> dict[str, Any]:
        """Adds a field whose list is below the root of target lists."""
        path = root.path(asked.targets)
        night.add(author, asked.model_dump(mode="json", exclude_none=True, exclude={"targets"}), path)
        return night.view()
