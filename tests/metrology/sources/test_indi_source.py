"""INDI: Debian's own camera simulator behind its own server, and servers that misbehave."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from programs import heeding_interrupts

from fiberloom.metrology.sources.errors import CameraAborted, CameraRefused, CameraSilent, ImageBroken
from fiberloom.metrology.sources.indi_child import IndiOrder, write_blob
from fiberloom.metrology.sources.remote import ExposureSettings
from fiberloom.metrology.sources.spec import CameraSpec, open_source

pytest.importorskip("indipyclient", reason="pip install 'fiberloom[cameras]': the client of INDI")

PATIENCE_S = 120.0
"""A deadline for what comes by itself."""
BEGUN_S = 5.0
"""A deadline for what never comes; until then the process that talks has begun."""


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
    told = ExposureSettings(**{"exposure_s": 0.5, "deadline_s": PATIENCE_S, "retries": 0} | settings)
    return open_source(CameraSpec("indi", f"127.0.0.1:{port}", name), told)


@pytest.mark.slow
def test_images_of_the_simulator(simulator):
    camera = source(simulator)
    begin_s = time.time()
    first = camera.expose()
    talker = camera._talker
    second = camera.expose()
    assert camera._talker is talker  # one process for all
    assert not list(talker.folder.iterdir())
    camera.close()
    assert talker.process.poll() is not None
    assert not talker.folder.exists()
    assert first.shape == (1024, 1280)
    assert first.exposure_s == 0.5
    assert begin_s - 2.0 < first.begun_utc_s < second.begun_utc_s < time.time()
    assert (first.array() != second.array()).any()


@pytest.mark.slow
def test_an_exposure_is_given_up_and_the_next_one_comes(simulator):
    camera = source(simulator, exposure_s=600.0, deadline_s=900.0)
    threading.Timer(2.0, camera.abort).start()
    with pytest.raises(CameraAborted):
        camera.expose()
    camera.settings = replace(camera.settings, exposure_s=0.5)
    assert camera.expose().shape == (1024, 1280)
    camera.close()


@pytest.mark.slow
def test_a_camera_that_the_server_does_not_have(simulator):
    with pytest.raises(CameraSilent, match="looking for the camera No Such Camera"):
        source(simulator, "No Such Camera", deadline_s=BEGUN_S).expose()


def test_nothing_listens():
    with pytest.raises(CameraSilent, match="is indiserver running"):
        source(1).expose()


@pytest.fixture
def silent():
    """The port of a server without a word."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def test_a_server_without_a_word(silent):
    with pytest.raises(CameraSilent, match="looking for the camera"):
        source(silent, deadline_s=BEGUN_S).expose()


@pytest.fixture
def broken():
    """The port of a camera whose exposures fail."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            with suppress(OSError):
                while True:
                    connection, _ = server.accept()
                    threading.Thread(target=fail, args=(connection,), daemon=True).start()

        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[1]


CAMERA = (Path(__file__).parent / "indi_camera.xml").read_text()


def fail(connection):
    told, asked = False, b""
    with connection, suppress(OSError):
        while data := connection.recv(65536):
            asked += data
            if not told:
                connection.sendall(CAMERA.encode())
                told = True
            if b"CCD_EXPOSURE_VALUE" in asked:
                asked = b""
                connection.sendall(
                    b'<message device="CCD Simulator" message="the shutter is stuck"/>'
                    b'<setNumberVector device="CCD Simulator" name="CCD_EXPOSURE" state="Alert">'
                    b'<oneNumber name="CCD_EXPOSURE_VALUE">0</oneNumber></setNumberVector>'
                )


def test_a_failed_exposure_is_told_in_the_words_of_the_camera(broken):
    camera = source(broken, deadline_s=PATIENCE_S)
    for _ in range(2):
        with pytest.raises(CameraRefused, match="CCD Simulator: the shutter is stuck"):
            camera.expose()
    camera.close()


# the process that talks


def test_a_process_that_ends_is_named_and_begun_anew(broken):
    camera = source(broken, deadline_s=PATIENCE_S)
    with pytest.raises(CameraRefused):
        camera.expose()
    first = camera._talker.process
    first.kill()
    with pytest.raises(CameraSilent, match="the process that talks to the server has ended"):
        camera.expose()
    with pytest.raises(CameraRefused, match="stuck"):
        camera.expose()
    assert camera._talker.process.pid != first.pid
    camera.close()


HOST = """
import sys, threading, time
from fiberloom.metrology.sources.remote import ExposureSettings
from fiberloom.metrology.sources.spec import CameraSpec, open_source

camera = open_source(CameraSpec("indi", f"127.0.0.1:{sys.argv[1]}", "CCD"), ExposureSettings(0.0, 600.0, 0))

def tell():
    while not (camera._running and camera._running.doing.startswith("looking")):
        time.sleep(0.01)
    print(camera._talker.folder, flush=True)

threading.Thread(target=tell, daemon=True).start()
camera.expose()
"""


@pytest.mark.parametrize(
    ("number", "to_all"), [(signal.SIGKILL, False), (signal.SIGTERM, False), (signal.SIGINT, True)]
)
def test_no_process_and_no_file_is_left_behind(silent, number, to_all):
    """The pipe of stderr ends when the last of the processes has."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(
        [sys.executable, "-c", HOST, str(silent)],
        **pipes,
        text=True,
        start_new_session=True,
        preexec_fn=heeding_interrupts,
    ) as host:
        folder = Path(host.stdout.readline().strip())
        assert folder.is_dir()
        (os.killpg if to_all else os.kill)(host.pid, number)  # Ctrl-C reaches all of a terminal
        host.communicate(timeout=PATIENCE_S)
    assert host.returncode == -number
    assert not folder.exists()


@pytest.mark.parametrize(("data", "kind"), [(b"", ".fits"), (b"SIMPLE", ".fits"), (b"junk", ".fits.z")])
def test_a_blob_that_is_no_image(tmp_path, data, kind):
    order = IndiOrder(1, "indi://somewhere", "127.0.0.1", 1, "CCD", 0.0, tmp_path)
    with pytest.raises(ImageBroken):
        source(1)._image(write_blob(order, data, kind))
    assert not list(tmp_path.iterdir())
