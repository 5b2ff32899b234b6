"""The figures of summary.json that come from the moves."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np

from fiberloom.health.status import FAULTS, FibreStatus
from fiberloom.operation.move import Move
from fiberloom.operation.results.budget import budget
from fiberloom.typing import Floats

if TYPE_CHECKING:
    from fiberloom.operation.results.observed import ObservedField

TRULY_OFF = "truly_off_target"
"""On target as measured, not in truth: the twin knows."""


def summarise(observed: ObservedField) -> dict[str, Any]:
    """The figures of summary.json that come from the moves."""
    final = observed.final
    assigned = observed.assignment.n_assigned
    within = int(observed.on_target(final).sum())
    return {
        "n_positioners": len(observed.plane),
        "n_targets": len(observed.targets),
        "n_assigned": assigned,
        "n_valid": int(observed.counted(final).sum()),
        "n_within_requirement": within,
        "share_within_requirement": within / assigned if assigned else 0.0,
        "requirement_um": observed.requirement_um,
        "collisions_verified": observed.collisions_verified,
        "contacts_true": observed.contacts_true,
        "plan_cpu_s": sum(m.plan.cpu_s for m in observed.moves),
        "motion_s": sum(m.motion_s for m in observed.moves if not m.comparison),
        "stopped": observed.stopped,
        "moves": [_summarise_move(observed, move) for move in observed.moves],
        "faults": _faults(observed, final),
        "not_on_target": _not_on_target(observed, final),
        "budget": budget(observed),
    }


def _not_on_target(observed: ObservedField, move: Move) -> dict[str, int]:
    """How many of the assigned fibres are not on target, by their status; the most frequent first."""
    missed = (observed.assignment.target >= 0) & ~observed.on_target(move)
    why = [TRULY_OFF if status is FibreStatus.ON_TARGET else status.value for status in move.status]
    return dict(Counter(np.array(why, dtype=object)[missed].tolist()).most_common())


def _summarise_move(observed: ObservedField, move: Move) -> dict[str, Any]:
    counted = observed.counted(move)
    measured = move.measured_error_um[counted]
    true, metrology = observed.true_error_um(move), observed.true_metrology_error_um(move)
    guided, all_um = observed.guided_error_um(move), observed.error_um(move)
    error, left_out = all_um[counted], (observed.assignment.target >= 0) & ~counted
    worst = observed.worst_error_um(move)
    return {
        "move": move.number,
        "label": move.label,
        "interrupted": move.interrupted,
        "comparison": move.comparison,
        "motion_s": move.motion_s,
        "images": move.measurement.images,
        "n_fibres": int(counted.sum()),
        "n_within_requirement": int((error <= observed.requirement_um).sum()),
        "measured_rms_um": _rms(measured),
        "true_metrology_rms_um": None if metrology is None else _rms(metrology[counted]),
        "true_rms_um": None if true is None else _rms(true[counted]),
        "guided_rms_um": None if guided is None else _rms(guided[counted]),
        **({} if worst is None else {"worst_in_exposure_rms_um": _rms(worst[counted])}),
        "p95_um": _percentile(error, 95),
        "max_um": _percentile(error, 100),
        "healthy": _spread(error, observed.requirement_um),
        "not_healthy": _spread(all_um[left_out], observed.requirement_um),
    }


def _spread(error_um: Floats, requirement_um: float) -> dict[str, Any]:
    """How errors (n,) in um are spread; one that is not known is not within the requirement."""
    n = len(error_um)
    return {
        "n": n,
        "rms_um": _rms(error_um),
        "p95_um": _percentile(error_um, 95),
        "p99_um": _percentile(error_um, 99),
        "share_within_requirement": float((error_um <= requirement_um).mean()) if n else None,
    }


def _rms(values: Floats) -> float | None:
    good = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(good**2))) if len(good) else None


def _percentile(values: Floats, share: float) -> float | None:
    good = values[np.isfinite(values)]
    return float(np.percentile(good, share)) if len(good) else None


def _faults(observed: ObservedField, move: Move) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for positioner, status in zip(observed.plane.positioner_id, move.status, strict=True):
        if status in FAULTS or status is FibreStatus.BLOCKED:
            found.setdefault(status.value, []).append(int(positioner))
    return found
