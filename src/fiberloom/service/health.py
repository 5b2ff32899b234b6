"""Health's verdict on positioners, followed run by run while the service observes: a proposal, no more."""

from __future__ import annotations

import threading
from typing import Any

from fiberloom.assignment.relax import relaxed_planes
from fiberloom.health.history import passages
from fiberloom.health.monitor import Finding, HealthMonitor, State
from fiberloom.instruments import FocalPlane
from fiberloom.store import Store
from fiberloom.store.place import Place
from fiberloom.store.run import RUNNING

PROPOSED = (State.DEGRADED, State.DISABLED)
"""States in which a person is asked whether to exclude."""


class HealthFollower:
    """What past runs of a store say of every positioner; each run is read once."""

    def __init__(self, plane: FocalPlane, place: Place) -> None:
        """`plane`: of the positioners; `place`: where the runs are kept."""
        self._monitor, self._place, self._done = HealthMonitor(plane), place, 0
        self._lock = threading.Lock()
        self._hashes = {p.config_hash() for p in (plane, *relaxed_planes(plane))}
        self._found: dict[int, Finding] = {}
        self._states: dict[int, str] = {}

    def follow(self) -> None:
        """Reads the runs that have ended since. Threads may come together: each run counts once."""
        if self._place.begun:
            with self._lock:
                self._follow()

    def _follow(self) -> None:
        with Store.read(self._place.record) as store:
            for run in store.runs():
                if run.id <= self._done or run.status == RUNNING:
                    continue
                self._done = run.id
                if run.n_measurements and run.config_hash in self._hashes:
                    for passage in passages(store, run.id, self._monitor.plane):
                        self._monitor.update(passage)
        ids = self._monitor.plane.positioner_id.tolist()
        self._found = {finding.positioner_id: finding for finding in self._monitor.findings()}
        self._states = dict(zip(ids, map(str, self._monitor.states()), strict=True))

    def proposals(self) -> dict[int, tuple[str, str]]:
        """Evidence and advice of those that a person may want to exclude."""
        return {
            p: (f"{f.state}: {f.ailment}, {f.evidence}", f"{f.advice}; exclude it if you agree")
            for p, f in self._found.items()
            if f.state in PROPOSED
        }

    def of(self, positioner_id: int) -> dict[str, Any]:
        """State, and where it is not healthy ailment, axis, evidence and advice."""
        said: dict[str, Any] = {"state": self._states.get(positioner_id, ""), "moves": self._monitor.moves}
        if (finding := self._found.get(positioner_id)) is None:
            return said
        return said | {
            "ailment": str(finding.ailment),
            "axis": finding.axis,
            "evidence": finding.evidence,
            "advice": finding.advice,
        }
