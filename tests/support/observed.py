"""A small array on the twin, as a control system has it; its motions can be held on the way."""

import asyncio
import socket
import threading
from pathlib import Path

from fiberloom.field import Field
from fiberloom.hardware import Hardware
from fiberloom.instruments import generate, load_instrument
from fiberloom.operation.source import OutsideArray
from fiberloom.planning import random_configuration
from fiberloom.service.array import ServedArray
from fiberloom.service.hub import Hub
from fiberloom.service.port import ServedPort
from fiberloom.service.web.target_root import TargetRoot
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.targets import random_targets, write_targets
from fiberloom.twin import NoiseCamera, Twin, draw_units
from fiberloom.twin.transport import TwinTransport

BUS = "cannet://10.1.10.31:19228"
PLANE = generate(load_instrument("sdssv"), 0, n_positioners=7)


class HeldArray(OutsideArray):
    """A twin as an array outside; while `slow` is set its clock is held often: there is time to stop it."""

    bus_name = "twin"

    def __init__(self, seed: int = 1):
        self.camera_name = "noise"
        self.twin = Twin(PLANE, draw_units(PLANE, 0), seed=0, start_deg=random_configuration(PLANE, seed))
        self.slow = threading.Event()

    async def open(self):
        transport = TwinTransport(self.twin)
        receive = transport.receive

        async def paced(timeout_s):
            if self.slow.is_set():
                await asyncio.sleep(0.05)
            return await receive(timeout_s)

        transport.receive = paced
        return Hardware(transport, NoiseCamera(self.twin, 0.669, 0), self.twin)


class Observed(ServedPort):
    """The served array as a control system has it, and what tests look at."""

    def __init__(self, array: ServedArray, root: TargetRoot) -> None:
        super().__init__(array, root)
        self.array, self.book, self.field = array, array.book, array.field

    def close(self) -> None:
        self.array.close()


def observed(folder: Path, held: HeldArray | None = None) -> tuple[Observed, HeldArray]:
    """The array with a store and a target list `list.csv` in a folder."""
    held = held or HeldArray()
    (folder / "targets").mkdir(parents=True, exist_ok=True)
    write_targets(random_targets(PLANE, 20, 0), folder / "targets" / "list.csv", ())
    field = Field(PLANE, held)
    book = ArrayBook(Store.open(folder / "arrays.sqlite"), BUS)
    array = ServedArray(field, book, BUS, folder / "runs", Hub())
    (folder / "runs").mkdir(exist_ok=True)
    array.begin(calibrate=False)
    return Observed(array, TargetRoot(folder / "targets")), held


def free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]
