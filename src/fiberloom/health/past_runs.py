"""What the stores of past runs say of every positioner."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fiberloom.assignment.relax import relaxed_planes
from fiberloom.errors import InputError
from fiberloom.health.history import passages
from fiberloom.health.monitor import Finding, HealthMonitor, State
from fiberloom.instruments import FocalPlane
from fiberloom.store import Store
from fiberloom.store.find import stores_below


def health_report(where: str, plane: FocalPlane) -> dict[str, Any]:
    """Follow all runs in the order in which they began; the state of every positioner at the end.

    `where`: a store, a database URL, or a folder with stores below it. Raises InputError where no run is
    of this focal plane.
    """
    monitor, runs = HealthMonitor(plane), 0
    for store, run_id in _runs(where, plane):
        with Store.read(store) as opened:
            for passage in passages(opened, run_id, plane):
                monitor.update(passage)
        runs += 1
    if runs == 0:
        raise InputError(
            f"{where}: no run of this focal plane ({plane.instrument.name}, {len(plane)} positioners); "
            "give the --instrument, --layout and --seed that it was observed with"
        )
    states = monitor.states()
    return {
        "runs": runs,
        "moves": monitor.moves,
        "states": {str(state): states.count(state) for state in State},
        "findings": [_row(finding) for finding in monitor.findings()],
    }


def _runs(where: str, plane: FocalPlane) -> Iterator[tuple[str, int]]:
    """Runs of this plane, or of it with a smaller collision buffer, oldest first."""
    hashes = {p.config_hash() for p in (plane, *relaxed_planes(plane))}
    found = []
    for store in stores_below(where):
        with Store.read(store) as opened:
            found += [
                (run.utc_start, store, run.id)
                for run in opened.runs()
                if run.n_measurements and run.config_hash in hashes
            ]
    yield from ((store, run_id) for _, store, run_id in sorted(found))


def _row(finding: Finding) -> dict[str, Any]:
    return {
        "positioner_id": finding.positioner_id,
        "state": str(finding.state),
        "ailment": str(finding.ailment),
        "axis": finding.axis,
        "evidence": finding.evidence,
        "since_move": finding.since_move,
        "advice": finding.advice,
    }
