"""Goals of a field on the sky for an exposure that begins at some time, as a night needs them."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

from fiberloom.assignment import Assignment, AssignSettings, assign_relaxed
from fiberloom.drive.way_rules import way_rule
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.sky.earth import SkyTime
from fiberloom.sky.sky_field import SkyField
from fiberloom.targets import TargetList
from fiberloom.targets.sky_list import SkyList


@dataclass(frozen=True, eq=False)
class SkyGoals:
    """What an exposure of a field asks for."""

    field: SkyField
    """With the begin of this exposure."""
    targets: TargetList
    """In mm, placed for the middle of the exposure; `Field.observe` takes it."""
    plane: FocalPlane
    """With the collision buffer that holds."""
    assignment: Assignment
    """Of the N positioners: goals in deg, targets, fibres."""
    airmass: float
    """Of the centre of the field, at the moment of placing."""


def targets_at(
    stars: SkyList,
    field: SkyField,
    plane: FocalPlane,
    begin: SkyTime | datetime | None = None,
    exposure_s: float | None = None,
) -> TargetList:
    """The targets of a field in mm, for an exposure that begins at some time.

    `stars`, `field`, `plane`, `begin`: as of `goals_at`, and InputError as there; `exposure_s`: the duration,
    s, the field's own when left out.
    """
    field = field.begun(field.begin if begin is None else _time(begin), exposure_s)
    return stars.placed(field.chain(plane.instrument), field)


def goals_at(
    plane: FocalPlane,
    stars: SkyList,
    field: SkyField,
    begin: SkyTime | datetime | None = None,
    *,
    seed: int = 0,
    strict: bool = False,
) -> SkyGoals:
    """The goals of a field for an exposure that begins at some time, as `observe --field` has them.

    Parameters
    ----------
    plane : FocalPlane
        N positioners.
    stars : SkyList
        Targets, by `read_sky`.
    field : SkyField
        Centre, position angle, exposure, site and weather, by `SkyField.read`.
    begin : SkyTime or datetime, optional
        Of the exposure; a datetime has a time zone. When left out: the field's own time.
    seed : int
        Of the assignment.
    strict : bool
        No number of targets outweighs one of a higher priority.

    Returns
    -------
    SkyGoals
        Targets in mm for the middle of the exposure (or its begin, as the field says), and who takes what.

    Raises
    ------
    InputError
        A field or a target that is below the horizon or too low then; a datetime without a time zone;
        whatever `SkyList.placed` and `assign` refuse.
    """
    targets = targets_at(stars, field, plane, begin)
    settings = AssignSettings(strict=strict, ways=way_rule(plane))
    kept, assignment = assign_relaxed(plane, targets, seed=seed, settings=settings)
    assert targets.on_sky is not None
    chain, begun = targets.on_sky.chain, targets.on_sky.field
    return SkyGoals(begun, targets, kept, assignment, chain.airmass)


def _time(begin: SkyTime | datetime) -> SkyTime:
    if isinstance(begin, SkyTime):
        return begin
    if begin.tzinfo is None:
        raise InputError(f"begin {begin.isoformat()}: needs a time zone, e.g. datetime.now(UTC)")
    return SkyTime.of(begin.astimezone(UTC).replace(tzinfo=None).isoformat(timespec="milliseconds"), "utc")
