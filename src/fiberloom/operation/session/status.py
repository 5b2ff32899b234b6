"""What is on record of an array: state and owner, positioners by how their place is known, exclusions."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from fiberloom.operation.session.array_lock import state_of
from fiberloom.store.arrays import ArrayBook, ArrayPlaces, ArrayState, Exclusion
from fiberloom.typing import Ints


@dataclass(frozen=True, eq=False)
class StatusReport:
    """Of one array, at one time."""

    address: str
    row: ArrayState
    exclusions: list[Exclusion]
    positioner_id: Ints
    places: ArrayPlaces
    with_places: bool

    @classmethod
    def of(cls, book: ArrayBook, with_places: bool = False) -> StatusReport:
        """Of an array; `with_places`: every positioner, not only how many."""
        ids = book.known_positioners()
        return cls(book.address, book.state(), book.exclusions(), ids, book.places(ids), with_places)

    def as_dict(self) -> dict[str, Any]:
        """For machines."""
        report: dict[str, Any] = self._summary() | {"exclusions": self._excluded()}
        if self.with_places:
            report["places"] = self._places()
        return report

    def tables(self) -> list[Any]:
        """What is printed, one after another."""
        shown: list[Any] = [self._summary()]
        if self.exclusions:
            shown.append(self._excluded())
        if self.with_places and len(self.positioner_id):
            shown.append(self._places())
        return shown

    def _summary(self) -> dict[str, Any]:
        owner = self.row.owner
        if owner and self.row.stale:
            owner = f"{owner}, which is gone"
        counts = Counter(self.places.how)
        return {
            "array": self.address,
            "state": str(state_of(self.row)),
            "since": _utc(self.row.since) if self.row.token or self.row.state != "off" else "",
            "text": self.row.text,
            "owner": owner or "none",
            "positioners": len(self.positioner_id),
            **{f"places {how}": n for how, n in sorted(counts.items())},
            "datum on record": int(self.places.datum.sum()),
            "excluded": len(self.exclusions),
        }

    def _excluded(self) -> list[dict[str, Any]]:
        return exclusion_rows(self.exclusions)

    def _places(self) -> list[dict[str, Any]]:
        return [
            {
                "positioner": int(p),
                "alpha_deg": round(float(self.places.angles_deg[i, 0]), 4),
                "beta_deg": round(float(self.places.angles_deg[i, 1]), 4),
                "how": self.places.how[i],
                "datum": bool(self.places.datum[i]),
                "utc": _utc(self.places.utc[i]),
            }
            for i, p in enumerate(self.positioner_id)
        ]


def exclusion_rows(exclusions: list[Exclusion]) -> list[dict[str, Any]]:
    """One row for each exclusion, as it is printed."""
    return [
        {
            "positioner": e.positioner_id,
            "since": _utc(e.since),
            "until": _utc(e.until) or "cleared by hand",
            "who": e.who,
            "why": e.why,
            "cleared": f"{_utc(e.cleared)} by {e.cleared_by}" if e.cleared else "",
        }
        for e in exclusions
    ]


def _utc(when: datetime | None) -> str:
    return "" if when is None else when.isoformat(timespec="seconds")
