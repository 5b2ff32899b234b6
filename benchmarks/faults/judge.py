"""What came of one seed: what was told to the operator, held against the truth of the twin.

Told is what `fibres.ecsv`, the events of the store and `fiberloom health` say. The definitions are in
docs/twin/faults.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fiberloom.bus.motion import DeviationKind
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.errors import InputError
from fiberloom.health.past_runs import health_report
from fiberloom.health.status import FAULTS, POOR_REQUIREMENTS, FibreStatus
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import METROLOGY
from fiberloom.operation.safety.looking import ALARM
from fiberloom.store import Store
from fiberloom.store.run import FAILED, FINISHED, INTERRUPTED, START, STOPPED, RunInfo
from fiberloom.twin.twin import Touch
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM

from .draw import HIDDEN, OF_POSITIONERS, Injected
from .host import CRASH, FAILURES
from .world import Ended, Shot, World

ASKED_MM = 1.0
"""One that had to go farther and did not is seen not to move."""
MADE = 0.5
"""Share of their way that others made in a move that shows who stands still."""
FURTHER = 2
"""Moves after the one in which a fault showed, by the end of which it has to be told."""
ENOUGH = 0.95
"""`--require` of observe."""


class Image(NamedTuple):
    """One image as the store has it, rows as in the layout."""

    run: int
    begins: bool
    shot: Shot
    status: list[str]
    commanded_deg: Floats
    wire_deg: Floats
    target_mm: Floats


class Event(NamedTuple):
    """An event of the store, and the number of the first image after it."""

    run: int
    image: int
    kind: str
    positioner_id: int
    text: str


@dataclass
class Record:
    """All that the store tells of a seed."""

    runs: list[RunInfo]
    images: list[Image]
    events: list[Event]


def judged(world: World, maps: TransmissionMaps, folder: Path, ended: list[Ended]) -> dict[str, Any]:
    """One line of the campaign's file."""
    line: dict[str, Any] = {"seed": world.scene.seed}
    try:
        record = read(folder / "out" / "store.sqlite", world)
        findings = _health(folder, world.plane, record)
        line |= _Judge(world, maps, record, ended, findings).line()
    except InputError as error:
        line |= {"unreadable": str(error), "faults": [asdict(f) for f in world.scene.faults]}
    bad = [e for e in ended if e.exit == CRASH or (e.exit < 0 and not e.killed)]
    crashes = [f"exit code {e.exit} {e.said[-1500:]}" for e in bad]
    line["crash"] = "\n".join(crashes)
    for deed, name in (("observe", "exits"), ("recover", "recover_exits")):
        line[name] = [e.exit for e in ended if e.deed == deed]
    line["said"] = [_last_line(e.said) for e in ended]
    return line


def _last_line(said: str) -> str:
    lines = [line for line in said.strip().splitlines() if line.startswith("fiberloom:")]
    return lines[-1] if lines else ""


def _health(folder: Path, plane: FocalPlane, record: Record) -> list[int]:
    """Positioners of which `fiberloom health` says that they are not healthy."""
    if not record.images:
        return []
    report = health_report(str(folder / "out" / "store.sqlite"), plane)
    return [int(row["positioner_id"]) for row in report["findings"]]


# reading


def read(path: Path, world: World) -> Record:
    """All runs of a store; none where no command has come so far. InputError where it cannot be read."""
    record = Record([], [], [])
    if not path.exists():
        return record
    with Store.open(path, create=False) as store:
        record.runs = store.runs()
        for run in record.runs:
            _read_run(store, run.id, world, record)
    return record


def _read_run(store: Store, run: int, world: World, record: Record) -> None:
    moves, rows = store.moves(run), store.measurements(run)
    shots = {round(shot.time_s, 6): shot for shot in world.shots}
    first, times = len(record.images), []
    for k in np.flatnonzero(moves["kind"] != STOPPED) if len(moves["id"]) else []:
        here = rows["move_id"] == moves["id"][k]
        columns = {name: column[here] for name, column in rows.items()}
        shot = shots[round(float(moves["time_s"][k]), 6)]
        record.images.append(_image(run, str(moves["kind"][k]), shot, columns, world.plane))
        times.append(moves["utc"][k])
    _read_events(store, run, (first, times), record)


def _image(run: int, kind: str, shot: Shot, columns: dict[str, Any], plane: FocalPlane) -> Image:
    order = np.argsort(plane.index_of(columns["positioner_id"].astype(np.int64)))

    def pair(*names: str) -> Floats:
        return np.column_stack([_numbers(columns[name])[order] for name in names])

    status = [str(s) for s in columns["status"][order]]
    commanded = pair("alpha_deg", "beta_deg")
    wire = pair("wire_alpha_deg", "wire_beta_deg")
    return Image(run, kind == START, shot, status, commanded, wire, pair("x_target_mm", "y_target_mm"))


def _numbers(column: Any) -> Floats:
    """A column of nothing but missing values is one of texts."""
    if column.dtype.kind in "fi":
        return np.asarray(column, dtype=np.float64)
    return np.full(len(column), np.nan)


def _read_events(store: Store, run: int, images: tuple[int, list[datetime]], record: Record) -> None:
    first, times = images
    found = store.events(run)
    for k in range(len(found["id"])):
        after = sum(utc < found["utc"][k] for utc in times)
        number = found["positioner_id"][k]
        positioner = 0 if number != number else int(number)
        image = first + min(after, max(len(times) - 1, 0))
        record.events.append(Event(run, image, str(found["kind"][k]), positioner, str(found["text"][k])))


def _says_left(event: Event) -> bool:
    """That one came to rest in a motion, or has restarted."""
    return event.kind == "deviation" and event.text.startswith(DeviationKind.LEFT.value)


# judging


class _Judge:
    def __init__(
        self, world: World, maps: TransmissionMaps, record: Record, ended: list[Ended], findings: list[int]
    ) -> None:
        self.world, self.maps, self.record, self.ended = world, maps, record, ended
        self.plane, self.findings = world.plane, findings
        self.shown = {f: self._shown(f) for f in world.scene.of(*OF_POSITIONERS)}
        """By fault: number of the first image that shows it; -1: none."""

    def line(self) -> dict[str, Any]:
        known, unknown, unreached = self._contacts()
        healthy, false = self._false_flags()
        good, far = self._told_good()
        return {
            "faults": [asdict(f) | self._came_of(f) for f in self.world.scene.faults],
            "images": len(self.record.images),
            "contacts": known,
            "contacts_unknown": unknown,
            "contacts_unreached": unreached,
            "healthy": healthy,
            "false_flags": false,
            "told_good": good,
            "false_good": far,
            "false_success": self._false_success(),
            "runs": [run.status for run in self.record.runs],
        }

    # faults

    def _came_of(self, fault: Injected) -> dict[str, Any]:
        """shown, flagged, missed; neither of the last two: it could not be judged."""
        if fault.kind in OF_POSITIONERS:
            return self._of_positioner(fault)
        judge: Callable[[Injected], bool | None] = {
            "cut": self._cut_told,
            "kill": self._kill_told,
            "disk_full": self._disk_told,
            "lost": lambda _: None,
        }.get(fault.kind, self._camera_told)
        met = fault in self.world.acted or fault.kind in ("lost", "cut")
        told = judge(fault) if met else None
        return {"shown": told is not None, "flagged": told is True, "missed": told is False}

    def _of_positioner(self, fault: Injected) -> dict[str, Any]:
        shown, told = self.shown[fault], self._told(fault)
        last = len(self.record.images) - 1
        late = shown + FURTHER
        flagged = told >= 0 and (shown < 0 or told <= late)
        missed = shown >= 0 and not flagged and (told > late or last >= late)
        return {"shown": shown >= 0, "flagged": flagged, "missed": missed, "at": [shown, told]}

    def _told(self, fault: Injected) -> int:
        """Number of the first image after its begin by which it was told of the positioner; -1: never."""
        row, number = self._row(fault), fault.positioner_id
        names = {str(status) for status in FAULTS}
        images = self.record.images
        told = [k for k, i in enumerate(images) if i.status[row] in names and i.shot.time_s >= fault.at_s]
        told += [
            e.image
            for e in self.record.events
            if e.positioner_id == number
            and (e.kind in names or _says_left(e))
            and self._time(e.image) >= fault.at_s
        ]
        if number in self.findings:
            told.append(len(images) - 1)
        return min(told, default=-1)

    def _time(self, image: int) -> float:
        images = self.record.images
        return images[image].shot.time_s if image < len(images) else np.inf

    def _row(self, fault: Injected) -> int:
        return int(self.plane.index_of(fault.positioner_id))

    def _shown(self, fault: Injected) -> int:
        """Number of the first image by which something is to be seen or heard of it."""
        row = self._row(fault)
        for k, image in enumerate(self.record.images):
            if image.shot.time_s >= fault.at_s and self._shows(k, row, fault.kind):
                return k
        return -1

    def _shows(self, k: int, row: int, kind: str) -> bool:
        if kind == "dark":
            return True
        lies = kind in (*HIDDEN, "stuck_hall", "false_start") and self._shows_lying(k, row)
        # one of HIDDEN whose motor has not turned waits, as its plan may want it to
        still = kind not in (*HIDDEN, "false_start")
        return lies or (still and self._shows_stillness(k, row, kind))

    def _shows_lying(self, k: int, row: int) -> bool:
        """It is not where it reports."""
        image = self.record.images[k]
        wire = image.wire_deg[[row]]
        if not wire.any():  # it has not been heard yet
            return False
        reported = self.plane.forward(*self.maps.to_output(wire, index=[row]).T, METROLOGY, index=[row])
        return (
            float(np.hypot(*(image.shot.fibres[METROLOGY][row] - reported[0])))
            > self.plane.instrument.drive.astray_mm
        )

    def _shows_stillness(self, k: int, row: int, kind: str) -> bool:
        """It had to go; and, unless it is silent or restarts, has not while others have."""
        image = self.record.images[k]
        if image.begins or k == 0:
            return image.begins and kind == "mute"
        before = self.record.images[k - 1].shot.fibres[METROLOGY]
        goal = self.plane.forward(*image.commanded_deg.T, METROLOGY)
        asked = np.hypot(*(goal - before).T)
        share = np.hypot(*(image.shot.fibres[METROLOGY] - before).T) / np.maximum(asked, ASKED_MM)
        if kind in ("mute", "reboot"):
            return bool(asked[row] > ASKED_MM)
        # a move that was stopped at its begin shows nothing
        others = float(np.median(share[asked > ASKED_MM])) if (asked > ASKED_MM).any() else 0.0
        return bool(asked[row] > ASKED_MM and share[row] < 0.05 and others > MADE)

    def _camera_told(self, fault: Injected) -> bool:
        words = str(FAILURES[fault.kind])
        alarms = [e.text for e in self.record.events if e.kind == ALARM]
        return any(words in said for said in [*alarms, *(e.said for e in self.ended)])

    def _cut_told(self, fault: Injected) -> bool | None:
        """Told where a command ran meanwhile: in words, by a status, or by an event."""
        end_s = fault.at_s + fault.size
        if not any(e.begun_s < end_s and fault.at_s < e.ended_s for e in self.ended):
            return None
        told = any("link" in e.text or "gateway" in e.text for e in self.record.events)
        said = any("link" in e.said or "gateway" in e.said for e in self.ended)
        behind = set(self.world.behind(fault))
        flagged = any(e.positioner_id in behind and e.kind in FAULTS for e in self.record.events)
        return told or said or flagged

    def _kill_told(self, fault: Injected) -> bool | None:
        """The run that was killed shows as interrupted, or as failed; None: it had none yet."""
        killed = len(self.record.runs) > 1
        return self.record.runs[0].status in (INTERRUPTED, FAILED) if killed else None

    def _disk_told(self, fault: Injected) -> bool | None:
        """A command that cannot write says so; None: it had room enough, or ended for another reason."""
        words = ("disk is full", "No space left", "disk I/O")
        if any(word in e.said for e in self.ended for word in words):
            return True
        (during,) = [e for e in self.ended if e.begun_s <= fault.at_s <= e.ended_s][:1] or [None]
        if during is None or during.killed or _last_line(during.said):
            return None
        runs = {i.run for i in self.record.images if during.begun_s <= i.shot.time_s <= during.ended_s}
        finished = {run.id for run in self.record.runs if run.status == FINISHED}
        return None if runs and runs <= finished else False

    # what must not be

    def _contacts(self) -> tuple[list[Any], list[Any], list[Any]]:
        """Contacts with what was known, or could have been; with what no image had shown yet; and of those
        that no frame reached with one that was ill."""
        known: list[Any] = []
        unknown: list[Any] = []
        unreached: list[Any] = []
        for touch in self.world.contacts:
            pair = (touch.positioner_id, touch.other)
            hidden = any(self._was_hidden(f, touch.time_s) for f in self.shown if f.positioner_id in pair)
            where = unknown if hidden else unreached if self._was_out_of_reach(touch) else known
            where.append([round(touch.time_s, 3), *pair])
        return known, unknown, unreached

    def _was_out_of_reach(self, touch: Touch) -> bool:
        """Nothing can stop one behind the cut cable, and nobody is there to stop any between commands."""
        pair = (touch.positioner_id, touch.other)
        if not any(e.begun_s <= touch.time_s <= e.ended_s for e in self.ended):
            return any(f.positioner_id in pair and self._began_alone(f, touch.time_s) for f in self.shown)
        cut = [f for f in self.world.scene.of("cut") if f.at_s <= touch.time_s <= f.at_s + f.size]
        behind = {p for fault in cut for p in self.world.behind(fault)}
        ill = {f.positioner_id for f in self.shown if f.at_s <= touch.time_s}
        return any(one in behind and other in ill for one, other in (pair, pair[::-1]))

    def _began_alone(self, fault: Injected, time_s: float) -> bool:
        """After the last command before `time_s` had ended."""
        return max(e.ended_s for e in self.ended if e.ended_s < time_s) < fault.at_s <= time_s

    def _was_hidden(self, fault: Injected, time_s: float) -> bool:
        if fault.kind not in HIDDEN or time_s < fault.at_s:
            return False
        shown = self.shown[fault]
        return shown < 0 or time_s <= self.record.images[shown].shot.time_s

    def _false_flags(self) -> tuple[int, list[Any]]:
        """How many healthy positioners could be flagged at the end of a command; which were, and by what."""
        count, false = 0, []
        for image, run in self._finals():
            healthy = self._healthy(image, run)
            count += int(healthy.sum())
            ids = self.plane.positioner_id
            false += [
                [run, int(ids[i]), image.status[i]]
                for i in np.flatnonzero(healthy)
                if image.status[i] in {str(s) for s in FAULTS}
            ]
        never = self._never_ill()
        false += [
            [e.run, e.positioner_id, e.kind]
            for e in self.record.events
            if _says_left(e) and e.positioner_id in never
        ]
        false += [[0, number, "health"] for number in self.findings if number in never]
        return count, false

    def _finals(self) -> Iterable[tuple[Image, int]]:
        """The last image of each run that has moved."""
        last = {image.run: image for image in self.record.images if not image.begins}
        return [(image, run) for run, image in last.items()]

    def _healthy(self, image: Image, run: int) -> Any:
        ill = {f.positioner_id for f in self.shown if f.at_s <= image.shot.time_s}
        ill |= {p for t in self.world.contacts for p in (t.positioner_id, t.other) if p is not None}
        begun_s = min(i.shot.time_s for i in self.record.images if i.run == run)
        for fault in self.world.scene.of("cut"):
            if fault.at_s <= image.shot.time_s and begun_s <= fault.at_s + fault.size:
                ill |= set(self.world.behind(fault))
        return ~np.isin(self.plane.positioner_id, sorted(ill))

    def _never_ill(self) -> set[int]:
        healthy = [set(self.plane.positioner_id[self._healthy(i, run)].tolist()) for i, run in self._finals()]
        return set.intersection(*healthy) if healthy else set()

    def _told_good(self) -> tuple[int, list[Any]]:
        """How many fibres were told on target at the end of a command; which are grossly not."""
        count, far = 0, []
        for image, run in self._finals():
            rows = np.flatnonzero([s == FibreStatus.ON_TARGET for s in image.status])
            off_um = self._true_um(image)[rows]
            count += len(rows)
            far += [
                [run, int(self.plane.positioner_id[i]), round(float(um), 1)]
                for i, um in zip(rows, off_um, strict=True)
                if not um <= self._gross_um
            ]
        return count, far

    @property
    def _gross_um(self) -> float:
        return POOR_REQUIREMENTS * self.plane.instrument.operation.requirement_um

    def _true_um(self, image: Image) -> Floats:
        """(N,) true distance from the target of that science fibre which is nearest to it."""
        off = [
            np.hypot(*(xy - image.target_mm).T) for name, xy in image.shot.fibres.items() if name != METROLOGY
        ]
        return UM_PER_MM * np.fmin.reduce(off)

    def _false_success(self) -> list[int]:
        """Observations that ended with exit code 0 while too few of the assigned fibres are near."""
        done = [k for k, e in enumerate(self.ended) if e.exit == 0 and e.deed == "observe"]
        return [k for k in done if not self._is_success(self.ended[k])]

    def _is_success(self, ended: Ended) -> bool:
        finals = [i for i, _ in self._finals() if ended.begun_s <= i.shot.time_s <= ended.ended_s]
        if not finals:
            return False
        off_um = self._true_um(finals[-1])
        off_um = off_um[np.isfinite(off_um)]
        return bool((off_um <= self._gross_um).sum() >= ENOUGH * max(len(off_um), 1))
