"""The process of a served camera: it shows what the twin tells, says why it cannot begin, ends with it."""

import asyncio
import os
import signal
import socket
import time
from dataclasses import replace

import numpy as np
import pytest
from doors import PATIENCE_S, SeenTwin

from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.metrology.sources.alpaca import AlpacaSource
from fiberloom.metrology.sources.errors import CameraRefused, CameraSilent
from fiberloom.metrology.sources.folder import FolderSource
from fiberloom.metrology.sources.remote import ExposureSettings
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.camera.process import CameraDoors, CameraProcess

HERE = Address("127.0.0.1", 0)


@pytest.fixture(scope="module")
def plane():
    """Few positioners before a camera of few pixels, which is painted in a moment."""
    few = generate(load_instrument("sdssv"), 5, n_positioners=7)
    small = {"width_px": 500, "height_px": 511, "scale_mm_px": 1.458}
    camera = few.instrument.camera.model_copy(update=small)
    return replace(few, instrument=few.instrument.model_copy(update={"camera": camera}))


def during(plane, doors, scenario):
    """Runs a scenario in a thread beside the loop that answers the process; what it returned."""
    twin = SeenTwin()

    async def whole():
        process = CameraProcess(plane, twin, seed=5, speed=10.0, doors=doors)
        await process.open()
        try:
            return await asyncio.to_thread(scenario, process, twin)
        finally:
            process.close()
            process.close()  # once more does no harm

    return asyncio.run(asyncio.wait_for(whole(), PATIENCE_S))


def host(doors, **settings):
    return AlpacaSource(
        doors.alpaca.host, doors.alpaca.port, 0, ExposureSettings(0.1, PATIENCE_S, retries=0, **settings)
    )


def test_it_asks_the_twin_once_for_each_image_and_heeds_its_faults(plane):
    def scenario(process, twin):
        assert process.doors.alpaca.port > 0
        camera = host(process.doors)
        dark = camera.expose().array().astype(int)
        twin.lit_mm = plane.forward(*plane.park_deg.T)
        lit = camera.expose().array().astype(int)
        assert process.looks == len(twin.looked_s) == 2
        twin.on = {"camera_error"}
        with pytest.raises(CameraRefused):
            camera.expose()
        twin.on = set()
        camera.expose()
        camera.close()
        return np.count_nonzero(np.abs(lit - dark) > 500)

    # spots of seven fibres, and of the two that were lit before
    assert 9 <= during(plane, CameraDoors(alpaca=HERE), scenario) < 1000


def test_one_door_beside_another(plane, tmp_path):
    doors = CameraDoors(HERE, tmp_path / "deep" / "images")

    def scenario(process, twin):
        told = str(process.doors)
        trigger = "touch {folder}/expose_{exposure}"
        assert told == (
            f"camera: alpaca://127.0.0.1:{process.doors.alpaca.port}/0, "
            f"folder:{doors.folder}?trigger={trigger}"
        )
        source = FolderSource(doors.folder, ExposureSettings(0.1, PATIENCE_S, retries=0), trigger=trigger)
        shape = source.expose().array().shape
        source.close()
        return shape

    assert during(plane, doors, scenario) == (511, 500)


def test_an_address_in_use_is_told_and_no_process_is_left(plane):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        used = Address(*taken.getsockname())
        with pytest.raises(InputError, match=rf"alpaca://{used}/0: Address already in use; choose another"):
            during(plane, CameraDoors(alpaca=used), lambda *_: None)


def test_a_folder_that_cannot_be_made_is_told(plane, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file/images.*: Not a directory; choose another address or folder"):
        during(plane, CameraDoors(folder=tmp_path / "file" / "images"), lambda *_: None)


def test_without_its_process_the_camera_is_silent_and_the_twin_goes_on(plane):
    def scenario(process, twin):
        camera = host(process.doors)
        camera.expose()
        os.kill(process._process.pid, signal.SIGKILL)
        with pytest.raises(CameraSilent):
            camera.expose()
        camera.close()

    during(plane, CameraDoors(alpaca=HERE), scenario)


def test_the_process_ends_with_the_pipe(plane):
    """As where the twin was killed: nothing says goodbye."""

    def scenario(process, twin):
        process._connection.close()
        end_s = time.monotonic() + PATIENCE_S
        while process._process.poll() is None and time.monotonic() < end_s:
            time.sleep(0.01)
        return process._process.returncode

    async def whole():
        process = CameraProcess(plane, SeenTwin(), seed=5, speed=10.0, doors=CameraDoors(alpaca=HERE))
        await process.open()
        asyncio.get_running_loop().remove_reader(process._connection.fileno())
        return await asyncio.to_thread(scenario, process, None)

    assert asyncio.run(asyncio.wait_for(whole(), PATIENCE_S)) == 0
