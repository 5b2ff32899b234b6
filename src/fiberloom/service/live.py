"""The live picture of an array: where every positioner is, what it is, what it is to do.

Told by the motion (`operation.session.witness`) in its thread, read by the server in another one.
"""

from __future__ import annotations

import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fiberloom.health.status import FibreStatus
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.arms import ALPHA_OFF, BETA_OFF, L_ALPHA
from fiberloom.instruments.model import METROLOGY
from fiberloom.metrology import Measurement
from fiberloom.metrology.pipeline import Reduction
from fiberloom.operation.move import Goals, Move
from fiberloom.operation.session.witness import BegunMove
from fiberloom.planning import Plan
from fiberloom.service.last_image import KeptImage
from fiberloom.service.stamps import Stamps
from fiberloom.typing import Array, Flags, Floats
from fiberloom.units import UM_PER_MM

STATES = ("unknown", *(str(s) for s in FibreStatus), "collided", "excluded")
"""What a positioner is shown as; the byte of a picture is the place in this list."""
CODE = {name: code for code, name in enumerate(STATES)}

FRAME = struct.Struct("<4sIIf")
"""Head of a picture: "FLP1", its number, N, time in the plan in s (NaN: at rest). Then N alpha, N beta as
float32 in deg (NaN: not known), and N states as uint8."""
MAGIC = b"FLP1"

_STEP_S, _MOST_STEPS = 0.1, 600
_MOST_STAGES = 200


@dataclass(frozen=True, eq=False)
class SampledPlan:
    """A plan at equal steps of time."""

    number: int
    label: str
    step_s: float
    angles_deg: Array
    """(T, N, 2) float32 alpha and beta."""

    @classmethod
    def of(cls, number: int, label: str, plan: Plan) -> SampledPlan:
        """Of the plan of a move, with its `number` and `label`."""
        n = int(min(max(np.ceil(plan.duration_s / _STEP_S), 1), _MOST_STEPS))
        time_s = np.linspace(0.0, max(plan.duration_s, _STEP_S), n + 1)
        angles = np.stack([robot.at(time_s) for robot in plan.robots], axis=1)
        return cls(number, label, float(time_s[1]), angles.astype(np.float32))

    @property
    def duration_s(self) -> float:
        """Until the last one has arrived."""
        return self.step_s * (len(self.angles_deg) - 1)

    def at(self, time_s: float) -> Array:
        """(N, 2) float32 alpha and beta in deg at one time; as at the end afterwards."""
        place = min(max(time_s / self.step_s, 0.0), len(self.angles_deg) - 1.0)
        k = min(int(place), len(self.angles_deg) - 2)
        part = np.float32(place - k)
        return np.asarray((1 - part) * self.angles_deg[k] + part * self.angles_deg[k + 1])

    def packed(self) -> bytes:
        """For the page: step in s as float32, T and N as uint32, then the angles."""
        t, n, _ = self.angles_deg.shape
        return struct.pack("<fII", self.step_s, t, n) + np.ascontiguousarray(self.angles_deg).tobytes()


@dataclass
class LiveStage:
    """One stage of a command, as a bar of the night."""

    name: str
    command: str
    begun: float
    """UTC, s since 1970."""
    ended: float | None = None
    done: int = 0
    total: int = 0

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return dict(self.__dict__)


@dataclass
class _Underway:
    plan: SampledPlan
    clock: Callable[[], float]
    started_s: float | None = None


@dataclass
class _Seen:
    """What the last move has shown. Arrays over N positioners."""

    target_mm: Floats
    """(N, 2) where fibres are to go; NaN: no target."""
    off_mm: Floats
    """(N, 2) of the fibre in the image from its goal; NaN: not seen, or no target."""
    number: int = 0
    label: str = ""
    utc: float = field(default_factory=time.time)


class Live:
    """The picture. Implements `Witness`, and `Watcher` for the stages."""

    def __init__(
        self,
        plane: FocalPlane,
        tell: Callable[[str, dict[str, Any]], None],
        fault: Callable[[str, str, int | None], None] = lambda *_: None,
        judged: Callable[[dict[int, str]], None] = lambda _: None,
    ) -> None:
        """`plane`: layout of N positioners; `tell`: publishes events; `fault`: told of every event of the
        record; `judged`: told of the status of every positioner after a move."""
        n = len(plane)
        self.plane, self.tell, self.fault, self.judged = plane, tell, fault, judged
        self.command = ""
        """The one that runs now."""
        self._lock = threading.RLock()
        self._angles_deg = np.full((n, 2), np.nan, dtype=np.float32)
        self._status = np.zeros(n, dtype=np.uint8)
        self._excluded = np.zeros(n, dtype=bool)
        nowhere = np.full((n, 2), np.nan)
        self._seen = _Seen(nowhere, nowhere.copy())
        self._goals: Goals | None = None
        self._underway: _Underway | None = None
        self._plan: SampledPlan | None = None
        self._image: KeptImage | None = None
        self.keep: Callable[[KeptImage], None] = lambda _: None
        """Told of every image."""
        self._stages: deque[LiveStage] = deque(maxlen=_MOST_STAGES)
        self._changed = 1
        self.heard = False
        """Positioners have answered in this command, and an image was looked at."""
        self.moves, self.image_utc = 0, 0.0
        """Moves that were made and the time of the last image, s since 1970; for the metrics."""

    # the stages: a Watcher

    def say(self, text: str) -> None:
        """A stage begins."""
        now = time.time()
        with self._lock:
            self._end_stage(now)
            self._stages.append(LiveStage(text, self.command, now))
        self.tell("stage", {"name": text, "command": self.command, "begun": now})

    def count(self, done: int, total: int) -> None:
        """`done` of `total` parts of the stage are done."""
        with self._lock:
            if not self._stages:
                return
            stage = self._stages[-1]
            told = total and 100 * done // total != 100 * stage.done // total
            stage.done, stage.total = done, total
        if told:
            self.tell("progress", {"done": done, "total": total})

    def ended(self) -> None:
        """The command has ended, and its last stage with it."""
        with self._lock:
            self._end_stage(time.time())
            self._underway, self.command = None, ""
            self._changed += 1

    def _end_stage(self, now_s: float) -> None:
        if self._stages and self._stages[-1].ended is None:
            self._stages[-1].ended = now_s

    # the motion: a Witness

    def begins(self, move: BegunMove) -> None:
        """A verified `move` is sent to the positioners: from now on its plan can be seen."""
        plan = SampledPlan.of(move.number, move.label, move.plan)
        with self._lock:
            self._underway, self._plan = _Underway(plan, move.clock), plan
            self._goals = move.goals
            targets_mm = self._targets_mm(move.goals)
            if move.number == 1:  # of another field: what was seen before is not of these
                self._seen = _Seen(targets_mm, np.full_like(targets_mm, np.nan), 1, move.label)
            self._seen.target_mm = targets_mm
            self._changed += 1
        self.tell("plan", self.plan_about() | {"targets": rounded(self._seen.target_mm)})

    def started(self, time_s: float) -> None:
        """Positioners go, since `time_s` of the bus."""
        with self._lock:
            if self._underway is not None:
                self._underway.started_s = time_s

    def start(self, here_deg: Floats, wire_deg: Floats, image: Measurement) -> None:
        """The begin check: reported angles and wire positions (N, 2) in deg, and the image."""
        with self._lock:
            self._status[:] = CODE["unknown"]
            self.heard = True
            self._stood(here_deg)
            self.image_utc = time.time()
        self._told_states()

    def move(self, move: Move) -> None:
        """A move has ended, and its image is reduced."""
        status = np.array([CODE[str(s)] for s in move.status], dtype=np.uint8)
        seen = self._seen_by(move)
        with self._lock:
            self._underway, self._status, self._seen = None, status, seen
            self._changed += 1
            self.moves, self.image_utc = self.moves + 1, seen.utc
        self.tell("move", self.seen_about())
        self._told_states()
        self.judged(dict(zip(self.plane.positioner_id.tolist(), map(str, move.status), strict=True)))

    def image(self, reduction: Reduction) -> None:
        """What is kept of an image: cut-outs around the fibres."""
        image = KeptImage(Stamps.of(reduction), self._metrology_goals_mm(), time.time())
        with self._lock:
            self._image = image
        self.keep(image)

    def restore(self, image: KeptImage) -> None:
        """Shows the last image of a process before this one."""
        with self._lock:
            self._image, self.image_utc = image, image.utc

    def rests(self, angles_deg: Floats) -> None:
        """Where all are now, as the store has it; `angles_deg` (N, 2), NaN: not known."""
        with self._lock:
            self._underway = None
            self._stood(angles_deg)

    def left(self, here_deg: Floats, wire_deg: Floats, answered: Flags, why: str) -> None:
        """After a stop: where each was left.

        `here_deg`, `wire_deg`: (N, 2) angles and wire positions as reported; `answered` (N,): which have;
        `why`: for the operator.
        """
        with self._lock:
            self._underway = None
            self._stood(np.where(answered[:, None], here_deg, np.nan))
        self.tell("stopped", {"text": why})

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """A fault or a remark of the record."""
        if kind in CODE and positioner_id is not None:
            with self._lock:
                self._status[self.plane.index_of(positioner_id)] = CODE[kind]
                self._changed += 1
            self._told_states()
        self.tell("event", {"event": kind, "text": text, "positioner_id": positioner_id})
        self.fault(kind, text, positioner_id)

    def _stood(self, angles_deg: Floats) -> None:
        self._angles_deg = angles_deg.astype(np.float32)
        self._changed += 1

    def _targets_mm(self, goals: Goals) -> Floats:
        """(N, 2) where the fibres of these goals are to go; NaN: no target."""
        target_mm = np.full((len(self.plane), 2), np.nan)
        for name in set(goals.fibre[goals.has_target].tolist()):
            rows = np.flatnonzero(goals.has_target & (goals.fibre == name))
            alpha_deg, beta_deg = goals.angles_deg[rows].T
            target_mm[rows] = self.plane.forward(alpha_deg, beta_deg, name or METROLOGY, rows)
        return target_mm

    def _seen_by(self, move: Move) -> _Seen:
        target_mm, goals = self._seen.target_mm, self._goals
        if goals is None:
            return _Seen(target_mm, np.full_like(target_mm, np.nan), move.number, move.label)
        goal_mm = move.metrology_goal_mm
        if goal_mm is None:
            goal_mm = self.plane.forward(goals.angles_deg[:, 0], goals.angles_deg[:, 1], METROLOGY)
        known = np.isfinite(move.measured_error_um)
        off_mm = np.where(known[:, None], move.measurement.xy_mm - goal_mm, np.nan)
        return _Seen(target_mm, off_mm, move.number, move.label)

    def exclude(self, positioner_id: Iterable[int]) -> None:
        """These are excluded now, and no others; what is not in the layout is left out."""
        with self._lock:
            self._excluded = np.isin(self.plane.positioner_id, list(positioner_id)) | self.plane.offline
            self._changed += 1
        self._told_states()

    def place(self, angles_deg: Floats) -> None:
        """Where all were when the service began; (N, 2), NaN: not known."""
        with self._lock:
            self._stood(angles_deg)

    # what the server reads

    def _told_states(self) -> None:
        self.tell("states", {"states": self.states()})

    def states(self) -> list[int]:
        """Of every positioner, as places in `STATES`."""
        with self._lock:
            shown = np.where(self._excluded, CODE["excluded"], self._status)
        return [int(code) for code in shown]

    def frame(self, number: int) -> tuple[int, bytes]:
        """The picture now: which change it shows (-1: it moves), and its bytes with this `number`."""
        with self._lock:
            changed, angles, time_s = self._changed, self._angles_deg, float("nan")
            if (moving := self._underway) is not None:
                begun_s = moving.started_s
                time_s = 0.0 if begun_s is None else max(moving.clock() - begun_s, 0.0)
                changed, angles = -1, moving.plan.at(time_s)
            shown = np.where(self._excluded, CODE["excluded"], self._status).astype(np.uint8)
        head = FRAME.pack(MAGIC, number & 0xFFFFFFFF, len(shown), time_s)
        return changed, head + np.ascontiguousarray(angles.T, dtype="<f4").tobytes() + shown.tobytes()

    def plan(self) -> SampledPlan | None:
        """The last plan that was executed; None before the first."""
        return self._plan

    def cutout(self, row: int) -> tuple[Stamps, Floats] | None:
        """Cut-outs of the last image, and where the metrology fibre in `row` was to be in it, (2,) mm, NaN
        without a target; None before the first image."""
        with self._lock:
            image = self._image
        return None if image is None else (image.stamps, image.goal_mm[row])

    @property
    def cutout_utc(self) -> float | None:
        """When the image of the cut-outs was taken, in s since 1970; None before the first one."""
        with self._lock:
            return None if self._image is None else self._image.utc

    def _metrology_goals_mm(self) -> Floats:
        """(N, 2) where the metrology fibres are to be by the goals of the move; NaN: without a target."""
        goals = self._goals
        if goals is None:
            return np.full((len(self.plane), 2), np.nan)
        place_mm = self.plane.forward(goals.angles_deg[:, 0], goals.angles_deg[:, 1], METROLOGY)
        return np.where(goals.has_target[:, None], place_mm, np.nan)

    def plan_about(self) -> dict[str, Any]:
        """Number, label and duration of the last plan."""
        if (plan := self._plan) is None:
            return {}
        return {"number": plan.number, "label": plan.label, "duration_s": round(plan.duration_s, 2)}

    def seen_about(self) -> dict[str, Any]:
        """What the last move has shown: targets in mm, errors in um."""
        seen = self._seen
        return {
            "number": seen.number,
            "label": seen.label,
            "utc": seen.utc,
            "targets": rounded(seen.target_mm),
            "errors_um": rounded(UM_PER_MM * seen.off_mm, 2),
        }

    def stages(self) -> list[dict[str, Any]]:
        """The last stages, oldest first."""
        with self._lock:
            return [stage.as_dict() for stage in self._stages]

    def errors_um(self) -> Floats:
        """(n,) distances in the last image, of the fibres with a target that are seen."""
        off_um = UM_PER_MM * np.hypot(*self._seen.off_mm.T)
        return np.asarray(off_um[np.isfinite(off_um)])


def plane_about(plane: FocalPlane) -> dict[str, Any]:
    """The layout for the page: mm and rad, by row."""
    arms, (near_mm, far_mm) = plane.arms, plane.beta_segment_mm
    tip_mm = plane.points[METROLOGY]
    return {
        "instrument": plane.instrument.name,
        "hash": plane.config_hash(),
        "states": list(STATES),
        "positioner_id": plane.positioner_id.tolist(),
        "hole": [str(hole) for hole in plane.hole],
        "centres_mm": rounded(plane.centres_mm),
        "l_alpha_mm": rounded(arms[:, L_ALPHA]),
        "alpha_off_rad": rounded(arms[:, ALPHA_OFF], 8),
        "beta_off_rad": rounded(arms[:, BETA_OFF], 8),
        "tip_mm": rounded(tip_mm),
        "reach_mm": rounded(plane.body_reach_mm),
        "beta_segment_mm": [float(near_mm), float(far_mm)],
        "buffer_mm": float(plane.collision_buffer_mm),
        "fiducials": rounded(plane.fiducials),
        "guide_cameras": rounded(plane.guide_cameras),
        "requirement_um": float(plane.instrument.operation.requirement_um),
    }


def rounded(values: Floats, digits: int = 4) -> list[Any]:
    """Numbers (mm, um, rad) for JSON with so many digits after the point; NaN becomes None."""
    array = np.round(np.asarray(values, dtype=np.float64), digits)
    return np.where(np.isfinite(array), array, None).tolist()  # type: ignore[no-any-return, call-overload]
