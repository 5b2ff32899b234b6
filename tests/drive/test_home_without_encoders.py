"""Motors without encoders in a session: one host owns the array, all are homed and parked."""

import asyncio
import sys
from pathlib import Path

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.calibration.transmission.nominal import nominal_maps
from fiberloom.connect import open_hardware
from fiberloom.drive.desi.drive import DesiDrive
from fiberloom.drive.piezo import write_summary_maps
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.operation.session.session import KnownArray, Session
from fiberloom.operation.session.states import Deed
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.cobras.served import ServedCobras
from fiberloom.twin.cobras.source import CobraSource
from fiberloom.twin.desi import DesiTwin
from fiberloom.twin.desi.transport import DesiTransport
from fiberloom.twin.server.address import Address

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from support.cobras import pfs_plane

SEED = 3


def session_of(plane, source, store, name="t"):
    book = ArrayBook(Store.open(str(store)), name)
    return Session(KnownArray(plane, nominal_maps(plane), source, book), "fiberloom home")


class DesiArray:
    """An array of one twin, in virtual time, that stays from one session to the next."""

    def __init__(self, plane):
        self.plane, self.twin = plane, DesiTwin(plane, seed=SEED)
        self.transport = DesiTransport(self.twin)

    async def open(self):
        drive = DesiDrive(self.plane, self.transport)
        vouched = np.ones(len(self.plane), dtype=bool)
        return Hardware(None, NoiseCamera(self.twin, 1.4, SEED), vouched=vouched, drive=drive)


@pytest.fixture(scope="module")
def desi():
    return fl.FocalPlane.of("desi", seed=0, n=12)


@pytest.fixture
def array(desi):
    return DesiArray(desi)


@pytest.fixture
def session(desi, array, tmp_path):
    return session_of(desi, array, tmp_path / "arrays.sqlite")


def test_desi_searches_its_stops_and_folds(desi, array, session):
    report = asyncio.run(session.home())
    assert report.ok, report.left_out
    assert sorted(report.datum_found) == sorted(desi.positioner_id.tolist())
    assert report.state == "parked"
    # a turn of the motor is 1.07 deg, play 2
    assert np.abs(array.twin.truth() - desi.park_deg).max() < 3.5
    assert array.twin.touches() == []


def test_desi_parks(session):
    report = asyncio.run(session.park())
    assert (report.ok, report.state, len(report.folded)) == (True, "parked", 12)


def test_two_hosts_do_not_own_one_array(desi, array, session, tmp_path):
    other = session_of(desi, array, tmp_path / "arrays.sqlite")

    async def scenario():
        async with session.owning(Deed.HOME):
            with pytest.raises(InputError, match="in use by"):
                await other.home()

    asyncio.run(scenario())


def test_a_stop_in_the_middle_of_a_search_ends_cleanly(array, session, monkeypatch):
    """The motors stand, and the array says that it was stopped."""
    homing = DesiDrive.home

    async def cut_short(drive, ids):
        receive = drive.transport.receive

        async def cut(timeout_s):
            if timeout_s > 5.0:
                drive.transport.receive = receive
                await receive(5.0)
                raise asyncio.CancelledError
            return await receive(timeout_s)

        drive.transport.receive = cut
        return await homing(drive, ids)

    monkeypatch.setattr(DesiDrive, "home", cut_short)
    with pytest.raises(asyncio.CancelledError):
        asyncio.run(session.home())
    stopped, before = session.known.book.state(), array.twin.truth().copy()
    array.twin.run(5.0)
    assert (stopped.state, stopped.owned) == ("stopped", False)
    np.testing.assert_allclose(array.twin.truth(), before, atol=1e-6)


def test_cobras_are_homed_and_parked_under_the_lock(tmp_path):
    plane, file = pfs_plane(57), tmp_path / "maps.npz"
    twin = CobraSource(plane, SEED, "noise", calibrated=False)
    twin.array.stuck[:] = False
    write_summary_maps(file, twin.known_maps, plane.positioner_id)

    async def scenario():
        served = ServedCobras(twin.array, Address("127.0.0.1", 14743), speed=400.0)
        await served.open()
        try:
            source = open_hardware(plane, "fpga://127.0.0.1:14743", NoiseCamera(twin.array, 1.4, SEED))
            source.know(file)
            session = session_of(plane, source, tmp_path / "arrays.sqlite")
            return await session.home(), await session.park()
        finally:
            served.close()

    home, park = asyncio.run(scenario())
    assert len(home.datum_found) == len(plane)
    assert home.ok, home.left_out
    assert (park.state, len(park.folded)) == ("parked", len(plane))
