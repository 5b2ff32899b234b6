"""The own stop of each instrument, over a connection that is made for it: for who moves nothing itself."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection, Iterable
from functools import partial
from typing import NamedTuple

from fiberloom.bus.client import Client
from fiberloom.bus.links import links_of
from fiberloom.bus.spec import BusSpec
from fiberloom.bus.transport import Frame, Transport
from fiberloom.drive.desi import frames as desi
from fiberloom.drive.lamost import RadioTransport, TcpRadio, radio_address
from fiberloom.drive.megara.frames import robot_of
from fiberloom.drive.megara.link import MegaraLink
from fiberloom.drive.moons import MoonsLink
from fiberloom.drive.moons.tcp import TcpGateways, gateway_address
from fiberloom.drive.pfs.client import FpgaClient
from fiberloom.drive.pfs.streams import over_tcp, tcp_address
from fiberloom.operation.outside.steppers import OpenedLamost, OpenedMoons
from fiberloom.operation.source import FPGA

ANSWER_S = 0.5
"""So long answers are waited for."""


class Halted(NamedTuple):
    """What came of a stop."""

    stopped: bool
    """Some have answered, none moves, and every line was up."""
    text: str
    sent: bool = True
    """False: there is no stop that could be sent."""


Halt = Callable[[], Awaitable[Halted]]
"""Connects, stops everything and lets go. InputError or TransportLost where nothing can be reached."""


def own_stop(bus: str, protocol: str) -> Halt:
    """What stops the array on a `bus`, an address: by the kind of that, else in the frames of a `protocol`.

    InputError for an address that cannot be read.
    """
    for at, halt in _BY_ADDRESS.items():
        if bus.startswith(at):
            return halt(bus.removeprefix(at))
    spec = BusSpec.parse(bus)
    if (of_frames := _BY_FRAMES.get(protocol)) is None:
        return partial(_none, bus, protocol)
    return partial(of_frames, spec)


async def _none(bus: str, protocol: str) -> Halted:
    return Halted(
        False,
        f"nothing is sent to {bus}: motors of the protocol '{protocol}' have no stop there that is known; "
        "name the array by --instrument, end the process that moves it, or cut its power",
        sent=False,
    )


async def _sdssv(spec: BusSpec) -> Halted:
    bus = await spec.open()
    client = Client(bus)
    try:
        await client.discover()
        results = await client.stop_all()
        return _told(results.ok_ids, silent=results.failed, lines=bus, hint=_HINT)
    finally:
        await client.close()


async def _desi(spec: BusSpec) -> Halted:
    bus = await spec.open(whose=desi.positioner_of)
    try:
        status = desi.DesiCommand.MOVE_STATUS
        await bus.send([desi.DesiFrame.of(desi.POSITIONERS, desi.DesiCommand.STOP)])
        await bus.send([desi.DesiFrame.of(desi.POSITIONERS, status)])
        heard = [desi.DesiFrame(frame.id, frame.data) for frame in await _heard(bus)]
        told = {frame.can_id: frame.data for frame in heard if frame.command == status and frame.data}
        return _told(told, [number for number, data in told.items() if any(data)], lines=bus)
    finally:
        await bus.close()


async def _heard(bus: Transport) -> list[Frame]:
    """All that is said in `ANSWER_S`."""
    frames: list[Frame] = []
    end_s = bus.time_s + ANSWER_S
    while (left_s := end_s - bus.time_s) > 0.0:
        frames += await bus.receive(left_s)
    return frames


async def _megara(spec: BusSpec) -> Halted:
    bus = await spec.open(whose=robot_of)
    return await _steppers(MegaraLink(bus), bus)


async def _steppers(link: MegaraLink | MoonsLink, lines: object) -> Halted:
    try:
        moving = await link.stop_told(ANSWER_S)
        return _told(moving, [unit for unit, moves in moving.items() if moves], lines=lines)
    finally:
        await link.close()


def _lamost(address: str) -> Halt:
    where = radio_address(address)

    async def halt() -> Halted:
        radio = TcpRadio(*where)
        await radio.open()
        return await _steppers(MegaraLink(RadioTransport(radio)), radio)

    return halt


def _moons(address: str) -> Halt:
    where = gateway_address(address)

    async def halt() -> Halted:
        gateways = TcpGateways(*where)
        await gateways.open()
        return await _steppers(MoonsLink(gateways), gateways)

    return halt


def _pfs(address: str) -> Halt:
    where = tcp_address(address)

    async def halt() -> Halted:
        client = FpgaClient(over_tcp(*where), tries=1)
        try:
            await client.power(on=0)
            await client.power()
        finally:
            await client.close()
        return Halted(True, "the power of all sectors was cut and given back; cobras must search their stops")

    return halt


_BY_ADDRESS: dict[str, Callable[[str], Halt]] = {
    OpenedMoons.at: _moons,
    OpenedLamost.at: _lamost,
    FPGA: _pfs,
}
_BY_FRAMES = {"sdssv": _sdssv, "desi": _desi, "megara": _megara}
_HINT = "; they were asked in the frames of SDSS-V, others are named by --instrument"


def _told(
    answered: Collection[int],
    moving: Collection[int] = (),
    silent: Collection[int] = (),
    lines: object = None,
    hint: str = "",
) -> Halted:
    """By who has `answered`, of whom `moving` do so still, and who was `silent`; `lines`: what carried it.

    `hint`: added where none has answered.
    """
    at, down = len(answered), [str(link) for link in links_of(lines) if not link.up]
    wrong = [(f"no answer from {_numbers(silent)}", silent), (f"still moving: {_numbers(moving)}", moving)]
    faults = [text for text, ids in wrong if ids] + down
    text = "; ".join([f"{at} positioners have answered", *faults]) + ("" if at else hint)
    return Halted(bool(at) and not faults, text)


def _numbers(ids: Iterable[int]) -> str:
    return ", ".join(map(str, ids))
