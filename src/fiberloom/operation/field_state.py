"""Where every positioner of a field is, and which of them follow commands: what the begin check, images and
replies say, kept together.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from fiberloom.bus.outcome import Outcome, Results
from fiberloom.drive.port import DriveModel, Suspect
from fiberloom.errors import InputError
from fiberloom.health.status import FibreStatus
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import METROLOGY
from fiberloom.metrology import Measurement
from fiberloom.operation.move import Recorder
from fiberloom.operation.safety.begin import (
    NAMED,
    Beginning,
    Report,
    Standing,
    allowed_miss_mm,
    begin_check,
)
from fiberloom.operation.safety.hearing import FROM_SILENCE, Hearing
from fiberloom.operation.safety.judge import Evidence
from fiberloom.operation.safety.seen import InARow, is_there, where_seen
from fiberloom.planning import Plan
from fiberloom.typing import Flags, Floats

NOT_WHERE_IT_SAYS = frozenset(
    {
        *(FibreStatus.LYING, FibreStatus.ASTRAY, FibreStatus.DEAD, FibreStatus.UNSURE),
        FibreStatus.DISCONNECTED,
    }
)
"""Faults with which the reported position is not trusted."""

DID_NOT_FOLLOW = frozenset({FibreStatus.DEAD, FibreStatus.LYING})
"""Faults that only a move shows."""

NOT_AS_REPORTED = NAMED | {Standing.OVERLAPS, Standing.UNCLEAR, Standing.BLIND}
"""What more than MOST positioners cannot be."""

SAME_DEG = 0.15
"""A wire position that is so near an earlier one is the same: the cogging pulls a rotor at rest by up to a
quarter of a motor turn, 0.09 deg; a turn is 0.35 deg."""

MOST = 0.5
"""Of the positioners: where more are dark, or not where they report, it is not they that are wrong."""


class FieldState:
    """Where every positioner is, and which of them follow commands. Arrays over N positioners."""

    def __init__(self, plane: FocalPlane, recorder: Recorder, model: DriveModel | None = None) -> None:
        """`plane`: layout of N positioners; `recorder`: keeps events; `model`: of their drive."""
        self.plane, self.recorder = plane, recorder
        self.model = model or DriveModel.of(plane)
        self.faults: list[FibreStatus | None] = [
            FibreStatus.OFFLINE if offline else None for offline in plane.offline
        ]
        self.blocked = np.zeros(len(plane), dtype=bool)
        self.unproven = np.zeros(len(plane), dtype=bool)
        """Not certain at the begin to be where they report: they do not move."""
        self.somewhere = np.zeros(len(plane), dtype=bool)
        """Of those: anywhere within reach, as far as is known."""
        self.beginning: Beginning | None = None
        """What the begin check has found."""
        self.looser_mm = 0.0
        """How much further than usual a positioner may be from where it reports: arms are thicker by it."""
        self.why: dict[int, str] = {}
        """By row: the text of its fault."""
        self.hearing = Hearing(len(plane))
        """Who answers, and whose missing answers have been held against it."""
        self._lit, self._elsewhere = InARow(len(plane)), InARow(len(plane))
        self.here_deg = plane.offline_position_deg.copy()
        """(N, 2) angles as reported, by the maps; as seen where the report is not trusted."""
        self.wire_deg = np.zeros((len(plane), 2))
        """(N, 2) wire positions as reported."""
        self.seen_mm = np.full((len(plane), 2), np.nan)
        """(N, 2) metrology fibres in the last image; NaN where not seen."""

    @property
    def mobile(self) -> Flags:
        """(N,) positioners that follow commands; a dark one does, though its fibre is not seen."""
        return np.array([fault in (None, FibreStatus.DARK) for fault in self.faults]) & ~self.unproven

    def standing(self, one: Standing) -> Flags:
        """(N,) of which the begin check says this; none before it."""
        found = self.beginning.standing if self.beginning is not None else [None] * len(self.plane)
        return np.array([standing is one for standing in found])

    @property
    def healthy(self) -> Flags:
        """(N,) positioners without a fault whose way is not blocked."""
        return np.array([fault is None for fault in self.faults]) & ~self.blocked

    def obstacles(self, but: int | None = None) -> FocalPlane:
        """The focal plane with the positioners that do not move as obstacles where they were last seen.

        One that could be anywhere is an obstacle of the whole reach of its arm. `but`: the row of one that
        is none, whatever is known of it.
        """
        still = ~self.mobile & (np.arange(len(self.plane)) != but)
        plane = dataclasses.replace(self.plane, offline=still, offline_position_deg=self.here_deg.copy())
        rows = np.flatnonzero(self.somewhere & still)
        discs = np.column_stack([plane.centres_mm[rows], plane.body_reach_mm[rows]])
        return dataclasses.replace(plane, fiducials=np.vstack([plane.fiducials, discs]))

    def metrology_mm(self, angles_deg: Floats) -> Floats:
        """(N, 2) metrology fibres of the layout at these angles (N, 2)."""
        return self.plane.forward(angles_deg[:, 0], angles_deg[:, 1], METROLOGY)

    def flag(self, row: int, fault: FibreStatus, why: str) -> None:
        """Books a fault of the positioner in `row`; `why`: the text of the record."""
        self.faults[row], self.why[row] = fault, f"{fault}: {why}"
        self.recorder.event(fault.value, why, int(self.plane.positioner_id[row]))

    def suspect(self, suspects: dict[int, Suspect]) -> None:
        """Books those that followed commands so far, and that their drive has found not to."""
        for positioner, found in suspects.items():
            row = int(self.plane.index_of(positioner))
            if self.faults[row] is None:
                self.flag(row, FibreStatus.ASTRAY if found.moves else FibreStatus.DEAD, found.why)

    def keep_faults(self, before: FieldState) -> None:
        """Books what was seen `before` of those that did not follow, which an image at rest does not show."""
        for row, fault in enumerate(before.faults):
            if fault in DID_NOT_FOLLOW and self.mobile[row]:
                self.flag(row, fault, before.why[row].removeprefix(f"{fault}: "))

    def book_blocked(self, planned: Plan) -> None:
        """Books the positioners that the plan refuses, in place of those of the last plan."""
        self.blocked[:] = False
        for positioner, why in planned.refused.items():
            self.blocked[self.plane.index_of(positioner)] = True
            self.recorder.event("blocked", why, positioner)

    def judge(
        self,
        results: Results,
        image: Measurement,
        before_deg: Floats,
        commanded_deg: Floats,
        hidden: Flags | None = None,
    ) -> Flags:
        """Books the faults that the image shows; (N,) mobile positioners that did not reach their goal.

        `results`: how the move ended on the bus, of the positioners that were moved; `image`: taken after
        it; `before_deg`: (N, 2) reported angles before it; `commanded_deg`: (N, 2) angles of its goal;
        `hidden` (N,): fibres that it need not show: where they are not seen they are not dark.
        """
        image = self._told_by(image)
        ended = [results.get(int(p)) for p in self.plane.positioner_id]
        asked = [Outcome.DONE if result is None else result.outcome for result in ended]
        evidence = Evidence(
            outcomes=asked,
            seen=image.seen if hidden is None else image.seen | hidden,
            measured_mm=image.xy_mm,
            before_mm=np.where(np.isfinite(self.seen_mm), self.seen_mm, self.metrology_mm(before_deg)),
            reported_mm=self.metrology_mm(self.here_deg),
            goal_mm=self.metrology_mm(commanded_deg),
            heard=self.hearing.heard,
            still_share=self.model.still_share,
            still_mm=self.model.astray_mm + self.looser_mm,
        )
        way_mm = np.hypot(*(evidence.goal_mm - evidence.before_mm).T)
        evidence = dataclasses.replace(evidence, astray_mm=self.model.astray_of_mm(way_mm) + self.looser_mm)
        self.seen_mm = image.xy_mm
        allowed_mm = allowed_miss_mm(self.plane, evidence.reported_mm, self.model.allowed_mm + self.looser_mm)
        back = self.hearing.taken_back(evidence, allowed_mm)
        for i in back:
            if self.faults[i] in FROM_SILENCE:
                self.faults[i] = None
                text = "answers again, and is where it reports"
                self.recorder.event("answers", text, int(self.plane.positioner_id[i]))
        judged = self.hearing.judged(evidence)
        worse = self._worse_than_dark(judged, image.seen)
        for i, fault in enumerate(judged):
            if fault is not None and (self.faults[i] is None or worse[i]):
                self.flag(i, fault, f"after a move: {ended[i] or 'not asked to move'}")
        well = image.seen & np.array([fault is None for fault in judged])
        self._book_lit(well & is_there(image.xy_mm, evidence.reported_mm, allowed_mm))
        self._trust_the_camera(image)
        away = np.hypot(*(evidence.reported_mm - evidence.goal_mm).T) > self.model.astray_mm
        unfinished = np.array([outcome is not Outcome.DONE for outcome in asked])
        unfinished[back] = True  # the plan went round them
        again: Flags = self.mobile & (away | unfinished)
        return again

    def _worse_than_dark(self, judged: list[FibreStatus | None], seen: Flags) -> Flags:
        """(N,) dark until now, and silent, or seen in two images in a row where they do not report to be.

        A dark one moves blind and is planned round where it reports: that must hold.
        """
        dark = np.array([fault is FibreStatus.DARK for fault in self.faults])
        worse: Flags = dark & np.array([fault in FROM_SILENCE for fault in judged])
        elsewhere = seen & np.array([fault in NOT_WHERE_IT_SAYS for fault in judged])
        worse[self._elsewhere.rows(dark, elsewhere)] = True
        return worse

    def _book_lit(self, there: Flags) -> None:
        """Those that were dark and are seen again are well, and are corrected; the record keeps both."""
        dark = np.array([fault is FibreStatus.DARK for fault in self.faults]) & ~self.unproven
        for row in self._lit.rows(dark, there):
            self.faults[row] = None
            text = "its fibre is seen again, where it is believed to be"
            self.recorder.event("seen again", text, int(self.plane.positioner_id[row]))

    def _told_by(self, image: Measurement) -> Measurement:
        """What faults are judged by: the image; of a blind drive where all are believed to be."""
        if not self.model.blind:
            return image
        every = np.ones(len(self.plane), dtype=bool)
        x_mm, y_mm = self.metrology_mm(self.here_deg).T
        return Measurement(x_mm, y_mm, every, image.time_s)

    def _trust_the_camera(self, image: Measurement) -> None:
        """Where a report is not trusted, the position is that of the image, or unknown."""
        if self.model.blind:
            return
        doubted = np.array([fault in NOT_WHERE_IT_SAYS for fault in self.faults])
        rows = np.flatnonzero(doubted & image.seen)
        self.here_deg[rows], known = where_seen(self.plane, rows, image.xy_mm[rows], self.here_deg[rows])
        self.somewhere[rows] = ~known

    def begin(self, answered: Flags, image: Measurement, vouched: Flags) -> None:
        """Lets move only what is certain to be where it reports, and books the others.

        `answered` (N,): on the bus; `vouched` (N,): whose datum is on record. InputError where most
        fibres are dark, or most positioners are not where they report.
        """
        image = self._told_by(image)
        if (~image.seen & self.mobile).sum() > MOST * len(self.plane):
            raise InputError(
                f"the camera sees only {int(image.seen.sum())} of {len(self.plane)} fibres; "
                "check the back-illumination"
            )
        model = self.model
        report = Report(self.here_deg, answered, image, vouched, model.scatter_mm, not model.reports)
        found = begin_check(self.plane, report, model.allowed_mm + self.looser_mm, self.looser_mm)
        self.beginning, self.seen_mm = found, image.xy_mm
        wrong = [i for i, s in enumerate(found.standing) if s in NOT_AS_REPORTED and not found.certain[i]]
        if len(wrong) > MOST * len(self.plane):
            raise InputError(
                f"{len(wrong)} of {len(self.plane)} positioners are not seen where they report to be "
                f"(positioner {self.plane.positioner_id[wrong[0]]}: {found.text[wrong[0]]}); nothing was "
                "moved: check that the layout, the calibration and the bus belong together"
            )
        self.here_deg = np.where(found.certain[:, None], self.here_deg, found.where_deg)
        self.somewhere = found.somewhere
        if self.model.blind:  # no image shows where one is that says nothing
            self.somewhere |= self.standing(Standing.SILENT)
        for i, standing in enumerate(found.standing):
            self._book_standing(i, standing, found)

    def _book_standing(self, row: int, standing: Standing, found: Beginning) -> None:
        if standing is Standing.VOUCHED:
            self.flag(row, FibreStatus.DARK, "its fibre is not seen")
        elif standing is Standing.SILENT:
            self.flag(row, FibreStatus.DEAD, found.text[row])
            self.hearing.silent_at_the_begin(row)
        elif not found.certain[row] and standing is not Standing.OFFLINE:
            self.unproven[row] = True
            dark = standing is Standing.DARK
            self.flag(row, FibreStatus.DARK if dark else FibreStatus.UNSURE, found.text[row])
        if standing is Standing.OVERLAPS:
            self.recorder.event("alarm", found.text[row], int(self.plane.positioner_id[row]))

    def status(self, has_target: Flags, error_um: Floats) -> list[FibreStatus]:
        """Status of every positioner. `has_target` (N,); `error_um` (N,) from the target, NaN: unknown."""
        requirement_um = self.plane.instrument.operation.requirement_um
        return [
            self._status_of(i, bool(has_target[i]), bool(error_um[i] <= requirement_um))
            for i in range(len(self.plane))
        ]

    def _status_of(self, row: int, has_target: bool, within: bool) -> FibreStatus:
        fault = self.faults[row]
        if fault is not None:
            return fault
        if self.blocked[row]:
            return FibreStatus.BLOCKED
        if not has_target:
            return FibreStatus.PARKED
        return FibreStatus.ON_TARGET if within else FibreStatus.OFF_TARGET
