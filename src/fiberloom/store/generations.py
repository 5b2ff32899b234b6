"""What operation has taught the maps, generation by generation; and the way back."""

from __future__ import annotations

from typing import Any

from fiberloom.errors import InputError
from fiberloom.store.database import Store
from fiberloom.store.learnt import LearntHistory, generations


def learnt_generations(learnt: str, positioner: int | None) -> list[dict[str, Any]]:
    """One row per generation, or per generation of one positioner."""
    with Store.read(learnt) as store:
        found = generations(store)
        if positioner is None:
            return [_shown(g, g.n_positioners, g.moves, g.rms_shift_mdeg) for g in found]
        rows = []
        for g in found:
            state = LearntHistory(store, g.origin).of_generation(g.id).get(positioner)
            if state is not None:
                rows.append(_shown(g, 1, state.moves, state.shift_mdeg))
    return rows


def _shown(g: Any, n_positioners: int, moves: int, shift_mdeg: float) -> dict[str, Any]:
    return {
        "generation": g.id,
        "utc": g.utc.isoformat(timespec="seconds"),
        "kind": g.kind,
        "positioners": n_positioners,
        "moves_learnt": moves,
        "rms_shift_mdeg": shift_mdeg,
        "calibration": g.origin,
        "seed": g.seed,
        "note": g.note,
    }


def go_back(learnt: str, to: int, positioners: list[int] | None) -> dict[str, Any]:
    """Goes back to a generation of the calibration that was learnt on last."""
    with Store.open(learnt, create=False) as store:
        found = generations(store)
        if not found:
            raise InputError(f"{learnt}: nothing was learnt yet; 'fiberloom observe --adapt' learns")
        chosen = next((g for g in found if g.id == to), found[-1])
        history = LearntHistory(store, chosen.origin)
        made = history.undo(to, positioners or None)
        changed = history.of_generation(made)
    return {"generation": made, "back_to": to, "positioners": len(changed), "store": learnt}
