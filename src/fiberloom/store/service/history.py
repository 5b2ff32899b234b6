"""What is on record of one positioner: its last measurements, and what was said of it."""

from __future__ import annotations

from typing import Any

from sqlalchemy import select

from fiberloom.store.database import Store
from fiberloom.store.schema import EventRow, MeasurementRow, MoveRow
from fiberloom.store.sums import checked

MEASURED = ("x_mm", "y_mm", "seen", "alpha_deg", "beta_deg", "target_id", "error_um", "status")


def positioner_history(store: Store, positioner_id: int, most: int = 50) -> dict[str, list[dict[str, Any]]]:
    """The last measurements and events of a positioner, newest first, at most so many of each.

    Angles in deg, places in mm, errors in um; None: not known.
    """
    return {
        "measurements": _measurements(store, positioner_id, most),
        "events": _events(store, positioner_id, most),
    }


def _measurements(store: Store, positioner_id: int, most: int) -> list[dict[str, Any]]:
    query = (
        select(MeasurementRow, MoveRow.number, MoveRow.kind, MoveRow.utc)
        .join(MoveRow, MeasurementRow.move_id == MoveRow.id)
        .where(MeasurementRow.positioner_id == positioner_id)
        .order_by(MeasurementRow.id.desc())
        .limit(most)
    )
    names = [c.name for c in MeasurementRow.__table__.columns]
    with store.transaction() as connection:
        found = connection.execute(query).all()
        ids = [row[names.index("id")] for row in found]
        checked(connection, MeasurementRow, MeasurementRow.id.in_(ids))
    return [_measured(dict(zip([*names, "move", "kind", "utc"], row, strict=True))) for row in found]


def _measured(row: dict[str, Any]) -> dict[str, Any]:
    head = {"run": row["run_id"], "move": row["move"], "kind": row["kind"], "utc": row["utc"].isoformat()}
    return head | {name: row[name] for name in MEASURED}


def _events(store: Store, positioner_id: int, most: int) -> list[dict[str, Any]]:
    with store.transaction() as connection:
        rows = checked(connection, EventRow, EventRow.positioner_id == positioner_id)
    return [
        {"run": row["run_id"], "utc": row["utc"].isoformat(), "kind": row["kind"], "text": row["text"]}
        for row in rows[::-1][:most]
    ]
