"""Nights of seven positioners on the twin inside of this process."""

import asyncio

import fiberloom as fl
from fiberloom.connect import twin_source
from fiberloom.field import Field
from fiberloom.night.carry import carry_out
from fiberloom.night.setup import NightSetup
from fiberloom.operation.known import Learning, known_so_far
from fiberloom.operation.session.session import KnownArray
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.store.nights.book import NightBook, nights
from fiberloom.targets import random_targets, write_targets

HEAD = "begin = 2026-11-25T18:00:00Z\ndawn = 2026-11-25T22:00:00Z\nrequire = 0.5\n"


class Night:
    """A folder with a queue, and the array for it."""

    def __init__(self, folder, queue, faults="", instrument="sdssv"):
        self.folder, self.plane = folder, fl.FocalPlane.of(instrument, n=7)
        for k, name in enumerate("abc"):
            write_targets(random_targets(self.plane, 40, k), folder / f"{name}.csv")
        self.write(queue)
        source = twin_source(self.plane, 0, "noise", faults)
        self.field = Field(self.plane, source, 0)
        self.maps = self.field.run.calibrate()
        self.store = Store.open(folder / "store.sqlite")

    def write(self, queue):
        (self.folder / "queue.toml").write_text(HEAD + queue)

    def setup(self):
        known = known_so_far(
            self.plane, self.maps, self.field.maps_file or self.folder / "maps.npz", Learning()
        )
        array = KnownArray(self.plane, self.maps, self.field.source, ArrayBook(self.store, "twin:1"))
        return NightSetup(known, array, self.folder / "queue.toml", self.folder, "night", virtual=True)

    def run(self, resume=False, progress=lambda _: None, setup=None):
        return asyncio.run(carry_out(setup or self.setup(), self.store, resume, progress))

    @property
    def book(self):
        return NightBook(self.store, nights(self.store)[-1].id)
