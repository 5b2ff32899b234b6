"""INDI: Debian's own camera simulator behind its own server, and servers that misbehave."""

import shutil
import socket
import subprocess
import threading
import time

import pytest

from fiberloom.metrology.sources.errors import CameraAborted, CameraSilent, ImageBroken
from fiberloom.metrology.sources.remote import ExposureSettings
from fiberloom.metrology.sources.spec import CameraSpec, open_source

pytest.importorskip("indipyclient", reason="pip install 'fiberloom[cameras]': the client of INDI")


@pytest.fixture(scope="module")
def simulator(tmp_path_factory):
    if shutil.which("indiserver") is None or shutil.which("indi_simulator_ccd") is None:
        pytest.skip("apt-get install indi-bin: indiserver and indi_simulator_ccd")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    process = subprocess.Popen(
        # a local socket of its own: a second server on the machine would end at the usual one
        [
            "indiserver",
            "-u",
            str(tmp_path_factory.mktemp("indi") / "s"),
            "-p",
            str(port),
            "indi_simulator_ccd",
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    for _ in range(400):
        with socket.socket() as trial:
            if trial.connect_ex(("127.0.0.1", port)) == 0:
                break
        time.sleep(0.05)
    yield port
    process.terminate()
    process.wait(10)


def source(port, name="CCD Simulator", **settings):
    told = ExposureSettings(**{"exposure_s": 0.5, "deadline_s": 20.0, "retries": 0} | settings)
    return open_source(CameraSpec("indi", f"127.0.0.1:{port}", name), told)


@pytest.mark.slow
def test_images_of_the_simulator(simulator):
    camera = source(simulator)
    begin_s = time.time()
    first, second = camera.expose(), camera.expose()
    assert first.shape == (1024, 1280)
    assert first.exposure_s == 0.5
    assert begin_s - 2.0 < first.begun_utc_s < second.begun_utc_s < time.time()
    assert (first.array() != second.array()).any()


@pytest.mark.slow
def test_an_exposure_is_given_up_and_the_next_one_comes(simulator):
    camera = source(simulator, exposure_s=30.0, deadline_s=60.0)
    threading.Timer(2.0, camera.abort).start()
    begin_s = time.monotonic()
    with pytest.raises(CameraAborted):
        camera.expose()
    assert time.monotonic() - begin_s < 5.0
    assert source(simulator).expose().shape == (1024, 1280)


@pytest.mark.slow
def test_a_camera_that_the_server_does_not_have(simulator):
    with pytest.raises(CameraSilent, match="looking for the camera No Such Camera"):
        source(simulator, "No Such Camera", deadline_s=1.0).expose()


def test_nothing_listens():
    with pytest.raises(CameraSilent, match="is indiserver running"):
        source(1).expose()


def test_a_server_without_a_word():
    with socket.create_server(("127.0.0.1", 0)) as silent:
        begin_s = time.monotonic()
        with pytest.raises(CameraSilent, match="looking for the camera"):
            source(silent.getsockname()[1], deadline_s=0.6).expose()
        assert time.monotonic() - begin_s < 3.0


@pytest.mark.parametrize(("data", "kind"), [(b"", ".fits"), (b"SIMPLE", ".fits"), (b"junk", ".fits.z")])
def test_a_blob_that_is_no_image(data, kind):
    with pytest.raises(ImageBroken):
        source(1)._image(data, kind)
