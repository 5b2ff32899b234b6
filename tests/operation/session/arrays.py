"""Arrays of a few positioners on the virtual twin, with a store, for the tests of sessions."""

import asyncio
from dataclasses import dataclass, field

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.hardware import Hardware
from fiberloom.instruments import generate, load_instrument
from fiberloom.operation.session.session import KnownArray, Session
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.twin import NoiseCamera, Twin, draw_units
from fiberloom.twin.camera.models import image_camera
from fiberloom.twin.source import TwinSource
from fiberloom.twin.transport import TwinTransport
from fiberloom.typing import Floats

BUS = "cannet://10.1.10.31:19228"


@dataclass
class TwinArray:
    """An array whose power stays on from one session to the next; the host knows nothing of its datums."""

    twin: Twin
    dark: list[int] = field(default_factory=list)
    """Rows whose fibres are not seen."""
    images: bool = False
    """By a camera that takes images; its spots have no names."""

    @classmethod
    def of(cls, plane, start_deg: Floats | None = None, seed: int = 0):
        return cls(Twin(plane, draw_units(plane, seed), seed=seed, start_deg=start_deg))

    async def open(self):
        camera = image_camera(self.twin, 0) if self.images else NoiseCamera(self.twin, 0.669, 0)
        return Hardware(
            TwinTransport(self.twin), _Dimmed(camera, self.dark) if self.dark else camera, self.twin
        )


def lying(array, plane, lies):
    """The array, in which rows of the plane believe to be elsewhere, by so many degrees of alpha and beta."""
    client = Client(TwinTransport(array.twin))

    async def tell():
        for row, off_deg in lies.items():
            ids = [int(plane.positioner_id[row])]
            wire_deg, _ = await client.positions_deg(ids)
            assert (await client.set_position(ids, *(wire_deg + off_deg).T)).ok.all()

    done(tell())
    array.twin.touches()
    return array


def off_park_mm(array, plane) -> Floats:
    """(N,) how far the metrology fibres are from where they are when all are folded."""
    return np.hypot(*(array.twin.fibre_xy("metrology") - plane.forward(*plane.park_deg.T)).T)


@dataclass
class _Dimmed:
    camera: NoiseCamera
    dark: list[int]

    def measure(self, expected_mm=None):
        image = self.camera.measure(expected_mm)
        x, y, seen = image.x_mm.copy(), image.y_mm.copy(), image.seen.copy()
        x[self.dark], y[self.dark], seen[self.dark] = np.nan, np.nan, False
        return type(image)(x, y, seen, image.time_s)


@dataclass
class Spied:
    """The same array; `sends` is told of all frames before they are on the bus."""

    array: TwinArray
    sends: object

    async def open(self):
        hardware = await self.array.open()
        send = hardware.transport.send

        async def told(frames):
            await self.sends(hardware.transport, frames)
            await send(frames)

        hardware.transport.send = told
        return hardware


def layout(n, seed=0):
    return generate(load_instrument("sdssv"), seed, n_positioners=n)


def maps_of(plane, seed=0) -> TransmissionMaps:
    """Swept once, then from the cache."""
    from fiberloom.field import Field

    return Field(plane, TwinSource(plane, seed, "noise", "")).run.calibrate()


def session(array, plane, store: Store, words="fiberloom test", **how) -> Session:
    known = KnownArray(plane, maps_of(plane), array, ArrayBook(store, BUS))
    return Session(known, words, **how)


def done(task):
    return asyncio.run(asyncio.wait_for(task, 300.0))
