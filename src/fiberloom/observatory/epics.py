"""An array as an EPICS IOC on Channel Access (`pip install 'fiberloom[epics]'`).

Records of an array with prefix `P`: `P:STATE`, `P:TEXT`, ... show it; `P:ALARM` is the worst alarm.
A write to `P:PARK` and the others is a command; `P:SAID` says what became of it.
"""

from __future__ import annotations

import asyncio
import os
import re
from typing import Any

from fiberloom.errors import InputError
from fiberloom.observatory.network import Endpoint, need
from fiberloom.observatory.port import BEATS, COMMANDS, PERIOD_S, ArrayPort, ArrayView
from fiberloom.operation.session.states import SessionState
from fiberloom.store.service.alarms import Severity

DEFAULT_PORT = 5064
AUTHOR = "EPICS"
"""Channel Access does not say who writes."""
STATES = [str(state) for state in SessionState]
TEXT_LENGTH = 512
"""Of a record that holds a text, in bytes."""

_PREFIX = re.compile(r"[A-Za-z][A-Za-z0-9_:-]{0,39}")
_CA_SEVERITY = {None: 0, Severity.ADVICE: 0, Severity.MINOR: 1, Severity.MAJOR: 2, Severity.CRITICAL: 2}
"""NO_ALARM, MINOR_ALARM, MAJOR_ALARM; INVALID would say that the value means nothing."""
_STATE_ALARM = 7

_begun = False


class EpicsIoc:
    """The records of an array; one for each process, since an IOC cannot be ended and begun again."""

    def __init__(self, array: ArrayPort, prefix: str, endpoint: Endpoint) -> None:
        """`array`: that is shown; `prefix`: of all records, without the colon; `endpoint`: where to listen.

        InputError for a prefix that EPICS does not take, where the extra is missing, or for a second IOC.
        """
        if not _PREFIX.fullmatch(prefix):
            raise InputError(f"prefix '{prefix}': letters, digits, _, - and :, at most 40; e.g. FPS")
        need("softioc", "epics")
        if _begun:
            raise InputError(f"prefix '{prefix}': this process has an IOC; another one needs its own process")
        endpoint.require_free()
        self._array, self._prefix, self._endpoint = array, prefix, endpoint
        self._view: ArrayView | None = None

    async def run(self) -> None:
        """Serves until it is cancelled; the records stay, and say nothing new, until the process ends."""
        self._begin()
        while True:
            self._show(await asyncio.to_thread(self._array.view))
            await asyncio.sleep(PERIOD_S)

    def _begin(self) -> None:
        global _begun
        _begun = True
        os.environ["EPICS_CAS_INTF_ADDR_LIST"] = self._endpoint.host
        os.environ["EPICS_CAS_SERVER_PORT"] = str(self._endpoint.port)
        os.environ["EPICS_CAS_AUTO_BEACON_ADDR_LIST"] = "NO"
        os.environ["EPICS_CAS_BEACON_ADDR_LIST"] = self._endpoint.host
        from softioc import asyncio_dispatcher, builder, softioc

        builder.SetDeviceName(self._prefix)
        self._records = _shown(builder)
        self._heartbeat = builder.longIn("HEARTBEAT", initial_value=0)
        self._said = builder.longStringIn("SAID", length=TEXT_LENGTH)
        self._add_commands(builder)
        builder.LoadDatabase()
        softioc.iocInit(asyncio_dispatcher.AsyncioDispatcher(asyncio.get_running_loop()), enable_pva=False)

    def _add_commands(self, builder: Any) -> None:
        for name in COMMANDS:
            builder.boolOut(name.upper(), on_update=self._on_command(name), always_update=True, **_ZERO)
        builder.longStringOut("CONFIGURE", on_update=self._configure, always_update=True, length=TEXT_LENGTH)

    def _on_command(self, name: str) -> Any:
        call = getattr(self._array, name)

        async def given(value: int) -> None:
            if value:
                await self._say(call, AUTHOR)

        return given

    async def _configure(self, targets: str) -> None:
        await self._say(self._array.configure, AUTHOR, targets)

    async def _say(self, call: Any, *given: str) -> None:
        try:
            text = await asyncio.to_thread(call, *given)
            self._said.set(_cut(text))
        except InputError as error:
            minor = _CA_SEVERITY[Severity.MINOR]
            self._said.set(_cut(f"refused: {error}"), severity=minor, alarm=_STATE_ALARM)

    def _show(self, view: ArrayView) -> None:
        self._heartbeat.set((self._heartbeat.get() + 1) % BEATS)
        if view == self._view:
            return
        self._view = view
        alarm = {"severity": _CA_SEVERITY[view.severity], "alarm": _STATE_ALARM if view.alarms else 0}
        for name, value in _values(view).items():
            self._records[name].set(value, **(alarm if name in ("ALARM", "ALARMS", "STATE") else {}))


_ZERO = {"ZNAM": "no", "ONAM": "do it"}


def _values(view: ArrayView) -> dict[str, Any]:
    """Of each record, by its name."""
    return {
        "STATE": STATES.index(view.state),
        "ADDRESS": _cut(view.address),
        "TEXT": _cut(view.text),
        "OWNER": _cut(view.owner),
        "COMMAND": _cut(view.command),
        "POSITIONERS": view.positioners,
        "EXCLUDED": len(view.excluded),
        "ALARMS": len(view.alarms),
        "ALARM": _cut(str(view.alarms[0]) if view.alarms else ""),
    }


def _shown(builder: Any) -> dict[str, Any]:
    """The records of what is shown, by name."""
    texts = ("ADDRESS", "TEXT", "OWNER", "COMMAND", "ALARM")
    counts = ("POSITIONERS", "EXCLUDED", "ALARMS")
    return {
        "STATE": builder.mbbIn("STATE", *STATES),
        **{name: builder.longStringIn(name, length=TEXT_LENGTH) for name in texts},
        **{name: builder.longIn(name) for name in counts},
    }


def _cut(text: str) -> str:
    """As much as a record holds."""
    return text.encode()[: TEXT_LENGTH - 1].decode(errors="ignore")
