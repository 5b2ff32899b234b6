"""Alarms of an array: raised by what motions say, latched until the cause is gone and a person knows."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from fiberloom.errors import InputError
from fiberloom.health.status import FAULTS
from fiberloom.operation.safety.looking import ALARM, BACK
from fiberloom.store.service.alarms import Alarm, AlarmTable, Severity

WELL_MOVES = 2
"""Moves in a row in which a positioner is well, before an alarm of it counts as gone."""


@dataclass(frozen=True)
class AlarmCode:
    """A kind of alarm."""

    severity: Severity
    advice: str


CODES: dict[str, AlarmCode] = {
    "collision": AlarmCode(
        Severity.CRITICAL, "look at the image and at the arms, then recover (look first: nothing moves)"
    ),
    "owner": AlarmCode(Severity.MAJOR, "stop, then give the command again"),
    "alarm": AlarmCode(Severity.MAJOR, "read the text; the begin check of the next command looks again"),
    "camera": AlarmCode(Severity.MAJOR, "look at the camera and the back-illumination; `fiberloom doctor`"),
    "command": AlarmCode(Severity.MAJOR, "read the text, mend the cause, give the command again"),
    "lying": AlarmCode(Severity.MINOR, "it is not where it reports: search its datum (home), or exclude it"),
    "astray": AlarmCode(Severity.MINOR, "it went elsewhere: recover finds it, home searches its datum"),
    "unsure": AlarmCode(Severity.MINOR, "recover: a small move that is proven clear shows where it is"),
    "dead": AlarmCode(Severity.MINOR, "it does not move or answer: look at its power, then exclude it"),
    "dark": AlarmCode(Severity.MINOR, "look at its light; search its datum (home)"),
    "disconnected": AlarmCode(Severity.MINOR, "its link is down: look at the gateway"),
    "health": AlarmCode(Severity.ADVICE, "look at its history; exclude it if you agree"),
    "store": AlarmCode(Severity.CRITICAL, "look at the disk: what happens is not recorded"),
}
"""What is raised, how bad it is, what to do."""

assert set(CODES) >= FAULTS

CAMERA = "camera"


class AlarmBoard:
    """The alarms of one array that are not over. May be used from any thread."""

    def __init__(
        self,
        table: AlarmTable,
        tell: Callable[[str, dict[str, Any]], None],
        send: Callable[[Alarm], None] = lambda _: None,
    ) -> None:
        """`table`: where they are kept; `tell`: publishes each change; `send`: tells people outside, of each
        that is new or is back again."""
        self._table, self._tell, self._send = table, tell, send
        self._lock = threading.RLock()
        self._open = {(a.code, a.subject): a for a in table.open()}
        self._well: Counter[str] = Counter()

    def open(self) -> list[Alarm]:
        """Those that are not over: the worst first, of equal ones the newest."""
        with self._lock:
            found = list(self._open.values())
        return sorted(found, key=lambda a: (Severity(a.severity).rank, -a.since.timestamp()))

    def raise_(self, code: str, subject: str, text: str, advice: str = "") -> None:
        """An alarm of a `code` of CODES; one that is there counts on.

        `subject`: a positioner's number or a part of the array; `text`: for the operator; `advice`: in
        place of that of the code.
        """
        now, kind = datetime.now(UTC), CODES[code]
        with self._lock:
            there = self._open.get((code, subject))
            if there is None:
                alarm = Alarm(code, kind.severity.value, subject, text, advice or kind.advice, now, now)
            else:
                alarm = replace(there, last=now, count=there.count + 1, text=text, gone=None)
                if there.gone is not None:  # news again: to acknowledge it once was not for ever
                    alarm = replace(alarm, acknowledged=None, acknowledged_by="")
            kept = self._keep(alarm)
        if there is None or there.gone is not None:
            self._send(kept)

    def clear(self, code: str, subject: str) -> None:
        """The cause of an alarm is gone; nothing where there is none."""
        with self._lock:
            there = self._open.get((code, subject))
            if there is not None and there.gone is None:
                self._keep(replace(there, gone=datetime.now(UTC)))

    def acknowledge(self, number: int, author: str) -> Alarm:
        """A person knows of the alarm with this number. InputError where none is open with it."""
        with self._lock:
            found = next((a for a in self._open.values() if a.id == number), None)
            if found is None:
                raise InputError(f"alarm {number}: there is none that is open")
            if found.acknowledged is not None:
                return found
            return self._keep(replace(found, acknowledged=datetime.now(UTC), acknowledged_by=author))

    def _keep(self, alarm: Alarm) -> Alarm:
        key = alarm.code, alarm.subject
        try:
            alarm = self._table.write(alarm)
        except InputError:
            if alarm.code != "store":  # shown all the same
                self._open[key] = alarm
                self.raise_("store", "store", "alarms cannot be written")
        if alarm.over:
            self._open.pop(key, None)
        else:
            self._open[key] = alarm
        self._tell("alarms", {"alarms": [a.as_dict() for a in self.open()]})
        return alarm

    # what motions say

    def event(self, kind: str, text: str, positioner_id: int | None = None) -> None:
        """An event of the record: faults of positioners, images that do not come."""
        subject = "array" if positioner_id is None else str(positioner_id)
        if kind in FAULTS:
            self._well[subject] = 0
            self.raise_(kind, subject, text)
        elif kind == ALARM and positioner_id is None and "image" in text:
            self.raise_(CAMERA, CAMERA, text)
        elif kind == ALARM:
            self.raise_("alarm", subject, text)
        elif kind == BACK:
            self.clear(CAMERA, CAMERA)

    def judged(self, status: Mapping[int, str]) -> None:
        """After a move, `status` by positioner: one that is well again and again is well."""
        self.clear(CAMERA, CAMERA)
        with self._lock:
            asked = {subject for code, subject in self._open if code in FAULTS}
        for positioner, now in status.items():
            subject = str(positioner)
            if subject not in asked:
                continue
            self._well[subject] = 0 if now in FAULTS else self._well[subject] + 1
            if self._well[subject] >= WELL_MOVES:
                for fault in FAULTS:
                    self.clear(fault, subject)

    def looked_again(self, begun: datetime) -> None:
        """A command that looked, since it had `begun`, is done: what it did not raise anew is gone."""
        with self._lock:
            before = [a.subject for a in self._open.values() if a.code == "alarm" and a.last < begun]
        for subject in before:
            self.clear("alarm", subject)

    def excluded(self, positioner_id: int) -> None:
        """A positioner is excluded: what was wrong with it is dealt with."""
        for code in (*FAULTS, "health"):
            self.clear(code, str(positioner_id))

    def proposals(self, findings: Mapping[int, tuple[str, str]]) -> None:
        """Health's verdict, by positioner: evidence and advice. A proposal; nothing is excluded by it."""
        for positioner, (text, advice) in findings.items():
            self.raise_("health", str(positioner), text, advice)
        with self._lock:
            before = [subject for code, subject in self._open if code == "health"]
        for subject in before:
            if int(subject) not in findings:
                self.clear("health", subject)
