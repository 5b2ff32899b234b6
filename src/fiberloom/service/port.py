"""The served array as a control system has it: OPC UA and EPICS show the array of the page."""

from __future__ import annotations

from fiberloom.errors import InputError
from fiberloom.observatory.port import ArrayAlarm, ArrayView
from fiberloom.operation.session.array_lock import state_of
from fiberloom.operation.session.states import SessionState
from fiberloom.service.alarms.board import CODES
from fiberloom.service.array import REST_S, Author, ServedArray
from fiberloom.service.night.served_night import ServedNight
from fiberloom.service.web.target_root import TargetRoot
from fiberloom.store.arrays import ArrayState
from fiberloom.store.service.alarms import Alarm, Severity

ROLE = "engineer"
"""Of every program that reaches these interfaces: they have no passwords."""


class ServedPort:
    """Implements `ArrayPort` over the array that is served, and its night."""

    def __init__(self, array: ServedArray, root: TargetRoot, night: ServedNight | None = None) -> None:
        """`array`: that is served; `root`: of target lists; `night`: of it, None: none is served."""
        self._array, self._root, self._night = array, root, night

    def view(self) -> ArrayView:
        """How it is now."""
        array, running = self._array, self._array.running
        address, n = array.book.address, len(array.field.plane)
        command = "" if running is None else f"{running.name} of {running.author.name}"
        try:
            row = array.look()
            excluded = tuple(e.positioner_id for e in array.book.exclusions())
            alarms = self._alarms()
        except InputError as error:
            code = CODES["store"]
            lost = ArrayAlarm("store", code.severity, "array", str(error), code.advice)
            return ArrayView(address, SessionState.UNKNOWN, "", "", command, n, (), (lost,))
        return ArrayView(address, str(_seen(row)), row.text, row.owner, command, n, excluded, alarms)

    def _alarms(self) -> tuple[ArrayAlarm, ...]:
        """Those whose cause is there, the worst first; of the night those that are not acknowledged."""
        found = [a for a in self._array.alarms.open() if a.gone is None]
        found += [] if self._night is None else self._night.alarms()
        return tuple(sorted(map(_alarm, found), key=lambda alarm: alarm.severity.rank))

    def stop(self, who: str) -> str:
        """Stops what moves; returns when it is at rest."""
        author = Author(who, ROLE)
        running = self._array.stop_own(author)
        if running is None:
            text = self._array.stop_others(author)
        elif running.over.wait(REST_S):
            text = f"{running.name} has ended; the array is {self.view().state}"
        else:
            text = f"{running.name} does not end within {REST_S:.0f} s; cut the power of the positioners"
        self._array.record_stop(author, text)
        return text

    def park(self, who: str) -> str:
        """Begins to fold all positioners; a night that goes on parks at once, and ends."""
        if self._night is not None and self._night.goes_on:
            self._night.park(Author(who, ROLE))
            return "the night parks, and ends"
        self._array.park(Author(who, ROLE))
        return "park has begun"

    def home(self, who: str) -> str:
        """Begins to search all datums."""
        self._array.home(Author(who, ROLE), None)
        return "home has begun"

    def recover(self, who: str) -> str:
        """Begins to take arms apart that touch, and unlocks."""
        self._array.recover(Author(who, ROLE), look_only=False)
        return "recover has begun"

    def configure(self, who: str, targets: str) -> str:
        """Begins to put fibres on the `targets` of a list in the folder."""
        self._array.observe(Author(who, ROLE), self._root.path(targets))
        return "configure has begun"


def _seen(row: ArrayState) -> SessionState:
    """As its owner has it while there is one, else as the next command finds it."""
    return SessionState(row.state) if row.owned else state_of(row)


def _alarm(alarm: Alarm) -> ArrayAlarm:
    subject = f"positioner {alarm.subject}" if alarm.subject.isdigit() else alarm.subject
    return ArrayAlarm(alarm.code, Severity(alarm.severity), subject, alarm.text, alarm.advice)
