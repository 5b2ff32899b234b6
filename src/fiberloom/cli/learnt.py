"""What operation has taught: read before an observation, kept during it, shown and undone by commands."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.calibration.adaptive.calibration import AdaptiveCalibration
from fiberloom.calibration.adaptive.learnt import origin, pack, unpack
from fiberloom.calibration.focal_plane.arms_file import load_arms, load_arms_covariance
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.operation.learning import LearningRecorder
from fiberloom.operation.loop import Recorder
from fiberloom.store import Run, Store
from fiberloom.store.calibrations import note_calibration
from fiberloom.store.learnt import OBSERVE, Learnt, LearntHistory, generations
from fiberloom.typing import Floats, Ints


@dataclass
class Known:
    """Arms and maps with which an observation begins, and where it keeps what it learns."""

    plane: FocalPlane
    maps: TransmissionMaps
    map_sigma_deg: Callable[[Floats], Floats] | None = None
    """How far the maps may be off at wire positions (N, 2), where operation has taught them."""
    keeper: Keeper | None = None
    recorder: LearningRecorder | None = None
    files: dict[str, Path] = field(default_factory=dict)
    """What was read, by kind of calibration."""

    def record_used(self, run: Run) -> None:
        """Which calibrations this run uses."""
        for kind, file in self.files.items():
            if file.exists():  # a cache that cannot be written has no file
                note_calibration(run, kind, file, self.plane.positioner_id)

    def record_learnt(self, run: Run) -> None:
        """What this run has taught, where learning was asked for."""
        if self.keeper is not None:
            self.keeper.record(run)

    def learning(self, recorder: Recorder) -> Recorder:
        """The recorder that learns, where that was asked for."""
        if self.keeper is None:
            return recorder
        self.recorder = LearningRecorder(recorder, self.keeper.learner, self.keeper.keep)
        return self.recorder

    def summary(self) -> dict[str, Any]:
        """What summary.json tells of it."""
        if self.keeper is None or self.recorder is None:
            return {}
        return {
            "learnt": {
                "store": self.keeper.store.name,
                "generation": self.keeper.generation,
                "moves": self.recorder.n_used,
                "refused": self.recorder.n_refused,
            }
        }


class Keeper:
    """Writes the states of one observation, all into one generation."""

    def __init__(self, store: Store, history: LearntHistory, learner: AdaptiveCalibration, seed: int) -> None:
        self.store, self.learner = store, learner
        self.generation: int | None = None
        self._history, self._seed = history, seed
        self._begun_deg = learner.output_deg.copy()
        self._kept: dict[int, bytes] = {}

    def keep(self, learner: AdaptiveCalibration, rows: Ints) -> None:
        """The states of these rows as they are now."""
        if self.generation is None:
            plane = learner.given
            name, config = plane.instrument.name, plane.config_hash()
            self.generation = self._history.begin(OBSERVE, name, config, self._seed)
        change = learner.output_deg[rows] - self._begun_deg[rows]
        shift_mdeg = 1e3 * np.sqrt((change**2).mean(axis=(1, 2)))
        packets = pack(learner, rows)
        moves = learner.moves[rows].tolist()
        states = {
            positioner: Learnt(moves[k], float(shift_mdeg[k]), data)
            for k, (positioner, data) in enumerate(packets.items())
        }
        self._history.put(self.generation, states)
        self._kept |= packets

    def record(self, run: Run) -> None:
        """The learnt states of these positioners as they are at the end of the run."""
        digest = hashlib.sha256(b"".join(self._kept[p] for p in sorted(self._kept))).hexdigest()[:16]
        note_calibration(run, "learnt", Path(self.store.name), self._kept, digest)


def known_so_far(
    plane: FocalPlane,
    maps: TransmissionMaps,
    maps_file: Path,
    arms: Path | None,
    learnt: str | None,
    adapt: bool,
    seed: int,
) -> Known:
    """Layout and maps, then the arms of a file, then what was learnt since."""
    host = plane if arms is None else load_arms(arms, plane)
    files = {"transmission": maps_file} | ({} if arms is None else {"focal-plane": arms})
    if not (adapt or learnt):
        return Known(host, maps, files=files)
    covariance = None if arms is None else load_arms_covariance(arms, plane)
    learner = AdaptiveCalibration(host, maps, arms_covariance_mm2=covariance)
    store = Store.open(learnt or maps_file.with_suffix(".learnt.sqlite"), create=adapt)
    history = LearntHistory(store, origin(maps, learner))
    known = {p: state for p, state in history.latest().items() if state.data is not None}
    packets = {p: state.data for p, state in known.items() if state.data is not None}
    unpack(learner, packets, {p: state.moves for p, state in known.items()})
    keeper = Keeper(store, history, learner, seed) if adapt else None
    # as it is now: what this observation teaches is not used in it
    begun = learner.copy()
    return Known(begun.plane, begun.maps, begun.sigma_deg, keeper, files=files)


def history_step(learnt: str, positioner: int | None) -> list[dict[str, Any]]:
    """One row per generation, or per generation of one positioner."""
    with Store.open(learnt, create=False) as store:
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


def undo_step(learnt: str, to: int, positioners: list[int] | None) -> dict[str, Any]:
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
