"""What requests hold, and what answers hold: the schemas of the OpenAPI document."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

Number = Annotated[int, Field(ge=0, lt=2**31)]
"""Of a positioner, an alarm, a command."""
Positioners = Annotated[list[Number], Field(min_length=1, max_length=10_000)]


class Asked(BaseModel):
    """The body of a request: a key that is not known is a mistake."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ObserveAsked(Asked):
    """Observe a target list."""

    targets: Annotated[str, Field(min_length=1, max_length=200)]
    """Name of a file below the root of target lists."""
    corrections: Annotated[int, Field(ge=0, le=20)] | None = None
    """Moves after the blind one, exactly so many; left out: by the instrument's stop rule."""


class HomeAsked(Asked):
    """Search datums."""

    positioners: Positioners | None = None
    """Left out: all."""


class RecoverAsked(Asked):
    """Take arms apart that touch."""

    look: bool = False
    """Only say what touches and what would be done."""


class ExcludeAsked(Asked):
    """Leave positioners where they are."""

    positioners: Positioners
    why: Annotated[str, Field(min_length=1, max_length=500, pattern=r"\S")]
    until: AwareDatetime | None = None
    """Left out: until it is cleared."""


class IncludeAsked(Asked):
    """End exclusions."""

    positioners: Positioners


FieldName = Annotated[str, Field(min_length=1, max_length=80)]


class NightAsked(Asked):
    """Begin the night, or go on with it."""

    resume: bool = False
    """Go on with the last night of this queue."""


class SkipAsked(Asked):
    """Leave a field out."""

    field: FieldName


class PriorityAsked(Asked):
    """Move a field in the queue."""

    field: FieldName
    priority: Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
    """Higher first."""


class AddFieldAsked(Asked):
    """Add a field to the queue of the night."""

    id: FieldName
    targets: Annotated[str, Field(min_length=1, max_length=200)]
    """Name of a file below the root of target lists, in mm."""
    exposure_s: Annotated[float, Field(gt=0.0, le=86400.0)] = 900.0
    exposures: Annotated[int, Field(ge=1, le=200)] = 1
    priority: Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)] = 0.0
    not_before: AwareDatetime | None = None
    not_after: AwareDatetime | None = None
    notes: Annotated[str, Field(max_length=200)] = ""


class CommandAnswer(BaseModel):
    """A command as it is on record."""

    id: int
    utc: datetime
    author: str
    role: str
    command: str
    parameters: dict[str, Any]
    key: str
    utc_end: datetime | None
    result: str
    """running, done, failed, stopped, refused."""
    text: str


class StopAnswer(BaseModel):
    """How a stop went."""

    stopping: str
    """The command that is being stopped; empty: none of this process."""
    text: str


class WhoAnswer(BaseModel):
    """Who asks."""

    name: str
    role: str
    tokens: bool
    """False: on loopback without tokens: no log-in is needed."""


class RefusalAnswer(BaseModel):
    """Why something was refused."""

    detail: str
