"""Arms and maps with which an observation begins, and where it keeps what it learns."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.assignment import Assignment
from fiberloom.calibration.adaptive.calibration import AdaptiveCalibration
from fiberloom.calibration.adaptive.learnt import origin, pack, unpack
from fiberloom.calibration.fibres.offsets import FibreOffsets
from fiberloom.calibration.focal_plane.arms_file import ArmsFile
from fiberloom.calibration.gravity.lead import led
from fiberloom.calibration.gravity.sag import ArmSag
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.pointing import ExposurePointing
from fiberloom.operation.care.warm_arms import WarmArms
from fiberloom.operation.learning import GrowthRecorder, LearningRecorder
from fiberloom.operation.move import Recorder
from fiberloom.operation.source import Doubting, Source
from fiberloom.store import Run, Store
from fiberloom.store.calibrations import note_calibration
from fiberloom.store.learnt import OBSERVE, Learnt, LearntHistory
from fiberloom.targets import TargetList
from fiberloom.typing import Floats, Ints


@dataclass
class Known:
    """Arms and maps with which an observation begins, and where it keeps what it learns."""

    plane: FocalPlane
    """The layout with the arms that are known best."""
    maps: TransmissionMaps
    map_sigma_deg: Callable[[Floats], Floats] | None = None
    """Standard errors (N, 2) of the maps at wire positions (N, 2) in deg, where moves have taught them."""
    keeper: Keeper | None = None
    """None: nothing is learnt."""
    recorder: LearningRecorder | None = None
    """Of the observation, once it has begun; None: nothing is learnt."""
    files: dict[str, Path] = field(default_factory=dict)
    """Files that were read, by kind of calibration."""
    fibres: FibreOffsets | None = None
    """Of the science fibres, and of the frame of the camera; None: as the layout says."""
    gravity: ArmSag | None = None
    """By which the arms turn with the pointing of the telescope; None: not at all."""
    warmth: WarmArms | None = None
    """None: arms are taken as they were measured."""
    doubtful: dict[int, str] = field(default_factory=dict)
    """By number why positioners got no targets: by their calibration they cannot be counted on."""
    scatter: Floats | None = None
    """(N, 2), dimensionless: rms by which moves of both motors miss, of their way; None: not known."""

    async def ask(self, source: Source, say: Callable[[str], None], moves: int | None = None) -> None:
        """What `source` tells before targets are assigned: how warm it is, and which motors not to count on.

        `say` is told what is being done, and why something is not known; `moves` of the field, None: those of
        the instrument.
        """
        await self.feel(source, say)
        await self.leave_out(source, say, moves)

    async def feel(self, source: Source, say: Callable[[str], None]) -> None:
        """Arms as long as the temperature of the positioners of `source` makes them.

        `say` is told why, where they are taken as they were measured.
        """
        if self.warmth is None:
            return
        await self.warmth.feel(source)
        self.plane = self.warmth.grown(self.plane)
        if self.warmth.why_not:
            say(f"arms are taken as they were measured: {self.warmth.why_not}")

    async def leave_out(self, source: Source, say: Callable[[str], None], moves: int | None = None) -> None:
        """Positioners that `source` does not count on get no targets: they stay where they are.

        `say` is told what is being done; `moves` as of `ask`.
        """
        if not isinstance(source, Doubting):
            return
        say("calibrating motors")
        self.doubtful, self.scatter = await source.doubtful(moves), source.scatter()
        if self.doubtful:
            from fiberloom.drive.pfs.calibration import left_out  # motors that few arrays have

            self.plane = left_out(self.plane, self.doubtful, source.standing_deg())

    def aims(self, targets: TargetList) -> TargetList:
        """The targets (N) as the frame of the camera has them, in mm: fibres are to be seen there."""
        return targets if self.fibres is None else self.fibres.aims(targets)

    def led(self, plane: FocalPlane, assignment: Assignment, pointing: ExposurePointing | None) -> Assignment:
        """The assignment with its fibres beside their targets, so that they sag onto them.

        `plane`: of the assignment; `pointing`: of image and exposure, without which nothing is known to sag.
        """
        if self.gravity is None or pointing is None:
            return assignment
        return led(plane, assignment, self.gravity, pointing)

    def record_used(self, run: Run) -> None:
        """Writes into the store which calibrations this run uses."""
        for kind, file in self.files.items():
            if file.exists():  # a cache that cannot be written has no file
                note_calibration(run, kind, file, self.plane.positioner_id)

    def record_learnt(self, run: Run) -> None:
        """Writes into the store what this run has taught: of the maps, where learning was asked for."""
        if self.warmth is not None:
            self.warmth.record(run)
        if self.keeper is not None:
            self.keeper.record(run)

    def learning(self, recorder: Recorder) -> Recorder:
        """The given recorder, or one around it that learns where that was asked for."""
        if self.warmth is not None:
            recorder = GrowthRecorder(recorder, self.warmth)
        if self.keeper is None:
            return recorder
        growth = 0.0 if self.warmth is None else self.warmth.growth
        self.recorder = LearningRecorder(recorder, self.keeper.learner, self.keeper.keep, growth)
        return self.recorder

    def summary(self) -> dict[str, Any]:
        """The entries of summary.json of what was calibrated and learnt."""
        known: dict[str, Any] = {}
        if self.doubtful:
            known["left_out"] = {str(number): why for number, why in sorted(self.doubtful.items())}
        if self.fibres is not None:
            frame_um = None if self.fibres.frame is None else self.fibres.frame.rms_um
            known["fibre_calibration"] = {"formal_um": self.fibres.formal_um, "frame_um": frame_um}
        if self.gravity is not None:
            known["gravity_calibration"] = {"formal_um": self.gravity.formal_um(self.plane)}
        if self.warmth is not None:
            known["temperature"] = self.warmth.summary()
        if self.keeper is None or self.recorder is None:
            return known
        return known | {
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
        """`store`: of `history`, the generations so far; `learner`: as it begins; `seed`: of the
        observation, noted with the generation."""
        self.store, self.learner = store, learner
        self.generation: int | None = None
        self._history, self._seed = history, seed
        self._begun_deg = learner.output_deg.copy()
        self._kept: dict[int, bytes] = {}

    def keep(self, learner: AdaptiveCalibration, rows: Ints) -> None:
        """Writes the states of these rows as they are now; the first call begins the generation."""
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
        """Notes in the store the states at the end of the run, by positioner, and their digest."""
        digest = hashlib.sha256(b"".join(self._kept[p] for p in sorted(self._kept))).hexdigest()[:16]
        note_calibration(run, "learnt", Path(self.store.name), self._kept, digest)


@dataclass(frozen=True)
class Learning:
    """Files that an observation uses beside layout and maps, and whether it learns itself."""

    arms: Path | str | None = None
    """Arms of `calibrate focal-plane`, in place of the layout's."""
    fibres: Path | str | None = None
    """Offsets of `calibrate fibres`: where the science fibres are on their arms."""
    gravity: Path | str | None = None
    """Sag of `calibrate gravity`: by how much the arms turn with the pointing."""
    learnt: str | None = None
    """Store of what was learnt; default with `adapt`: beside the maps."""
    adapt: bool = False
    """Learn from every measured move."""
    seed: int = 0
    """Of the observation; noted with the generation."""
    history: Path | None = None
    """Store of earlier observations: where maps are learnt, or what was learnt of them is used, the expansion
    of the arms is learnt from these."""

    def kept_by(self, source: Source, file: Path | None) -> Learning:
        """The same without `adapt`: motors without transmission maps learn by themselves, and the `source`
        keeps that in a `file`, None: in one of its own. InputError where it cannot.
        """
        if self.learnt is not None:
            raise InputError("--learnt: these motors keep what they learn in the file of --calibration")
        source.keep(file)
        return replace(self, adapt=False)


def known_so_far(plane: FocalPlane, maps: TransmissionMaps, maps_file: Path, asked: Learning) -> Known:
    """Layout and maps, then the arms of a file, then what was learnt since.

    `plane`: layout of N positioners; `maps`: their transmission maps, read from `maps_file`; `asked`:
    the other files, and whether the observation learns. Raises InputError where a file is missing,
    cannot be read, or holds no positioner of the layout.
    """
    arms = None if asked.arms is None else ArmsFile.read(asked.arms, plane)
    host = plane if arms is None else arms.calibrated()
    files = {"transmission": maps_file} | ({} if asked.arms is None else {"focal-plane": Path(asked.arms)})
    fibres = None if asked.fibres is None else FibreOffsets.load(asked.fibres)
    if fibres is not None and asked.fibres is not None:
        host = fibres.applied(host)
        files["fibres"] = Path(asked.fibres)
    gravity = None if asked.gravity is None else ArmSag.load(asked.gravity, plane)
    if asked.gravity is not None:
        files["gravity"] = Path(asked.gravity)
    warmth = WarmArms.of(host, maps, _measured_C(plane, arms), plane.config_hash())
    if not (asked.adapt or asked.learnt):
        return Known(host, maps, files=files, fibres=fibres, gravity=gravity, warmth=warmth)
    if warmth is not None and asked.history is not None:
        warmth.learn(asked.history)
    covariance = None if arms is None else arms.covariance_mm2()
    learner = AdaptiveCalibration(host, maps, arms_covariance_mm2=covariance)
    store = Store.open(asked.learnt or maps_file.with_suffix(".learnt.sqlite"), create=asked.adapt)
    history = LearntHistory(store, origin(maps, learner))
    known = {p: state for p, state in history.latest().items() if state.data is not None}
    packets = {p: state.data for p, state in known.items() if state.data is not None}
    unpack(learner, packets, {p: state.moves for p, state in known.items()})
    keeper = Keeper(store, history, learner, asked.seed) if asked.adapt else None
    # as it is now: what this observation teaches is not used in it
    begun = learner.copy()
    begin = Known(begun.plane, begun.maps, begun.sigma_deg, keeper, files=files)
    return replace(begin, fibres=fibres, gravity=gravity, warmth=warmth)


def _measured_C(plane: FocalPlane, arms: ArmsFile | None) -> float | None:
    """Temperature at which the arms in use were measured: those of the file, or of the layout."""
    if arms is not None:
        return arms.measured_C
    expansion = plane.instrument.expansion
    return None if expansion is None else expansion.measured_C
