"""What is on record of one positioner over runs and nights: measurements, and what was said of it."""

from __future__ import annotations

from datetime import datetime
from statistics import median
from typing import Any

from sqlalchemy import Table, select

from fiberloom.store.database import Store
from fiberloom.store.schema import ALARMS, EVENTS, EXCLUSIONS, MEASUREMENTS, MOVES, SUM, VISITS
from fiberloom.store.sums import checked

MEASURED = ("x_mm", "y_mm", "seen", "alpha_deg", "beta_deg", "target_id", "error_um", "status")


def positioner_history(store: Store, positioner_id: int, most: int = 50) -> dict[str, list[dict[str, Any]]]:
    """The last measurements, events, exclusions and alarms of a positioner, newest first.

    At most so many of each. Angles in deg, places in mm, errors in um; None: not known. Measurements have
    the number of their night and the field of its queue, None: of no night.
    """
    return {
        "measurements": _measurements(store, positioner_id, most),
        "events": _events(store, positioner_id, most),
        "exclusions": _rows(store, EXCLUSIONS, EXCLUSIONS.c.positioner_id == positioner_id, most),
        "alarms": _rows(store, ALARMS, ALARMS.c.subject.in_(_subjects(positioner_id)), most),
    }


def nights_of(measurements: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row a night, the newest first: how often it was on a target, and its errors after last moves, um.

    `measurements`: newest first, as of `positioner_history`. Night None: runs of no night, together.
    """
    last: dict[int, dict[str, Any]] = {}
    for m in measurements:
        if m["error_um"] is not None:
            last.setdefault(m["run"], m)
    found: dict[int | None, list[float]] = {}
    for m in last.values():
        found.setdefault(m["night"], []).append(m["error_um"])
    return [
        {"night": night, "targets": len(errors), "median_um": median(errors), "worst_um": max(errors)}
        for night, errors in found.items()
    ]


def _subjects(positioner_id: int) -> tuple[str, str]:
    """As alarms of an array name it, and as those of a night do."""
    return str(positioner_id), f"positioner {positioner_id}"


def _rows(store: Store, table: Table, where: Any, most: int) -> list[dict[str, Any]]:
    with store.transaction() as connection:
        found = checked(connection, table, where)
    return [_plain(r) for r in found[::-1][:most]]


def _plain(row: Any) -> dict[str, Any]:
    values = {k: v for k, v in row.items() if k not in ("id", SUM)}
    return {k: v.isoformat() if isinstance(v, datetime) else v for k, v in values.items()}


def _measurements(store: Store, positioner_id: int, most: int) -> list[dict[str, Any]]:
    query = (
        select(MEASUREMENTS, MOVES.c.number, MOVES.c.kind, MOVES.c.utc, VISITS.c.night_id, VISITS.c.field)
        .join(MOVES, MEASUREMENTS.c.move_id == MOVES.c.id)
        .outerjoin(VISITS, VISITS.c.run_id == MEASUREMENTS.c.run_id)
        .where(MEASUREMENTS.c.positioner_id == positioner_id)
        .order_by(MEASUREMENTS.c.id.desc())
        .limit(most)
    )
    names = [c.name for c in MEASUREMENTS.columns]
    with store.transaction() as connection:
        found = connection.execute(query).all()
        ids = [row[names.index("id")] for row in found]
        checked(connection, MEASUREMENTS, MEASUREMENTS.c.id.in_(ids))
    return [
        _measured(dict(zip([*names, "move", "kind", "utc", "night", "field"], row, strict=True)))
        for row in found
    ]


def _measured(row: dict[str, Any]) -> dict[str, Any]:
    head = {"run": row["run_id"], "move": row["move"], "kind": row["kind"], "utc": row["utc"].isoformat()}
    head |= {"night": row["night"], "field": row["field"]}
    return head | {name: row[name] for name in MEASURED}


def _events(store: Store, positioner_id: int, most: int) -> list[dict[str, Any]]:
    with store.transaction() as connection:
        rows = checked(connection, EVENTS, EVENTS.c.positioner_id == positioner_id)
    return [
        {"run": row["run_id"], "utc": row["utc"].isoformat(), "kind": row["kind"], "text": row["text"]}
        for row in rows[::-1][:most]
    ]
