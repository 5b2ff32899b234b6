"""`fiberloom twin` with a camera, as a process: a host reads its images by Alpaca and from its folder."""

import importlib.util
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np
import pytest
from doors import PATIENCE_S, failure
from programs import free_port, small_camera

from fiberloom.cli.app import main
from fiberloom.instruments import generate, load_instrument
from fiberloom.instruments.model import METROLOGY
from fiberloom.metrology.sources import alpaca as alpaca_source
from fiberloom.metrology.sources.errors import ImageBroken
from fiberloom.metrology.sources.spec import CameraSpec, open_camera
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.camera.models import image_camera

pytestmark = pytest.mark.slow
NUMBER, SEED = 7, 5
LISTEN, CAMERA, OTHER, SPARE = (f"127.0.0.1:{free_port()}" for _ in range(4))


@pytest.fixture(scope="module")
def instrument(tmp_path_factory):
    return small_camera(tmp_path_factory.mktemp("instrument"))


@contextmanager
def served(instrument, *options, listen=LISTEN):
    command = [
        sys.executable,
        "-m",
        "fiberloom.cli",
        "twin",
        "--instrument",
        str(instrument),
        "--listen",
        listen,
    ]
    command += ["--positioners", str(NUMBER), "--seed", str(SEED), "--speed", "10", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield [process.stdout.readline(), process.stdout.readline().strip()]
        finally:
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=30)
    assert process.returncode == 0


def plane(instrument):
    return generate(load_instrument(str(instrument)), SEED, n_positioners=NUMBER)


class Side:
    """A served camera, and the one that `observe` has in this process: both expose in turn."""

    def __init__(self, instrument, doors, folder):
        there = plane(instrument)
        self.plane, self.folder = there, folder
        self.doors = doors.removeprefix("camera: ").split(", ")
        self._here = image_camera(Twin(there, draw_units(there, SEED), seed=SEED), SEED)

    def host(self, k):
        """One that comes by the k-th door."""
        return opened(self.doors[k], self.plane)

    def exposed(self, host):
        """What the host sees, and what it should see."""
        return host.source.expose(), self._here.source.expose()

    def measured(self, host):
        """Of the next image that the host sees."""
        self._here.source.expose()
        return host.measure(folded_mm(self.plane))


def opened(url, there):
    sign = "&" if "?" in url else "?"
    return open_camera(CameraSpec.parse(f"{url}{sign}deadline={PATIENCE_S}&retries=0"), there)


@pytest.fixture(scope="module")
def side(instrument, tmp_path_factory, discovery_port):
    """One process with every door that there is."""
    folder = tmp_path_factory.mktemp("images")
    options = ("--camera-listen", CAMERA, "--camera-folder", str(folder), *indi_door(OTHER))
    options += ("--camera-discovery", str(discovery_port))
    with served(instrument, *options, listen=f"127.0.0.1:{free_port()}") as (_, doors):
        yield Side(instrument, doors, folder)


@pytest.fixture(scope="module")
def discovery_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        return free.getsockname()[1]


INDI_PACKAGES = ("indipyclient", "indipydriver", "indipyserver")


def indi_door(address):
    """The options of that door, where its packages are."""
    there = all(importlib.util.find_spec(package) for package in INDI_PACKAGES)
    return ("--camera-indi", address) if there else ()


def test_the_same_image_as_in_one_process(side):
    assert side.doors[0] == f"alpaca://{CAMERA}/0"
    host = side.host(0)
    image, wanted = side.exposed(host)
    assert_alike(image.pixels, wanted.pixels)
    assert (image.gain_e_adu, image.saturation_adu) == (wanted.gain_e_adu, int(wanted.saturation_adu))
    assert side.measured(host).seen.all()
    host.close()


def assert_alike(pixels, wanted):
    """The served arms have been held for some seconds: nanometres, a count in a few pixels of a spot."""
    difference = pixels.astype(int) - wanted
    assert np.abs(difference).max() <= 2
    assert np.count_nonzero(difference) < 1e-4 * difference.size


def folded_mm(there):
    park_deg = np.broadcast_to(there.instrument.positioner.park_deg, (NUMBER, 2))
    return there.forward(*park_deg.T, METROLOGY)


def test_files_hold_the_same_image(side):
    assert side.doors[1] == f"folder:{side.folder}?trigger=touch {{folder}}/expose_{{exposure}}"
    host = side.host(1)
    image, wanted = side.exposed(host)
    assert_alike(image.array(), wanted.pixels)
    again, wanted_again = side.exposed(host)
    host.close()
    assert_alike(again.array(), wanted_again.pixels)
    assert (again.array() != wanted.pixels).any()
    assert image.exposure_s == 5.0
    assert sorted(p.name for p in side.folder.iterdir()) == ["image_000001.fits", "image_000002.fits"]


def test_indi_carries_the_same_image(side):
    for package in INDI_PACKAGES:
        pytest.importorskip(package, reason="pip install 'fiberloom[cameras]': INDI")
    assert side.doors[2] == f"indi://{OTHER}/Fiberloom Twin"
    host = side.host(2)
    image, wanted = side.exposed(host)
    host.close()
    assert_alike(image.array(), wanted.pixels)
    assert image.exposure_s == 5.0


def test_a_camera_that_says_where_it_is(side, discovery_port, monkeypatch):
    monkeypatch.setattr(alpaca_source, "DISCOVERY_PORT", discovery_port)
    assert CAMERA in alpaca_source.alpaca_servers()


def test_a_port_in_use_is_told(side, capsys):
    text = refused(capsys, "--listen", SPARE, "--camera-listen", CAMERA)
    assert f"alpaca://{CAMERA}/0: Address already in use" in text


def test_a_camera_that_runs_free_and_a_dark_fibre_that_nobody_sees(instrument, tmp_path):
    """Without a camera that fault is refused; with one it acts."""
    options = ("--camera-folder", str(tmp_path), "--camera-every", "1", "--faults", "dark=2")
    with served(instrument, *options) as (_, doors):
        assert doors == f"camera: folder:{tmp_path}"
        host = opened(f"folder:{tmp_path}?clock=0", plane(instrument))
        asked_utc_s = time.time()
        assert host.source.expose().begun_utc_s > asked_utc_s - 1e-3
        seen = host.measure(folded_mm(plane(instrument))).seen
        host.close()
    assert np.count_nonzero(~seen) == 2


def test_a_fault_reaches_hosts_by_every_door(instrument, tmp_path):
    """`test_door_faults` shows all faults of a camera, and that they leave no trace."""
    alpaca, indi = (f"127.0.0.1:{free_port()}" for _ in range(2))
    options = ("--camera-listen", alpaca, "--camera-folder", str(tmp_path), *indi_door(indi))
    with served(instrument, *options, "--faults", "camera_half") as (_, doors):
        for url in doors.removeprefix("camera: ").split(", "):
            host = opened(url, plane(instrument))
            error = failure(host.source, ImageBroken)
            assert type(error) is ImageBroken, url
            host.close()


def test_faults_come_and_go_by_the_clock(instrument):
    """Images, none, images: three seconds of ours without the fault, eight with it."""
    options = ("--camera-listen", f"127.0.0.1:{free_port()}", "--faults", "camera_half@30+80")
    with served(instrument, *options) as (_, doors):
        host = opened(f"{doors.removeprefix('camera: ')}?exposure=0.5", plane(instrument))
        end_s = time.monotonic() + PATIENCE_S
        taken = [is_whole(host)]
        while not (taken[-1] and False in taken) and time.monotonic() < end_s:
            taken.append(is_whole(host))
        host.close()
    changes = [whole for k, whole in enumerate(taken) if k == 0 or whole != taken[k - 1]]
    # where the machine is slow the first image may come after the beginning
    assert changes in ([True, False, True], [False, True])


def is_whole(host):
    try:
        host.source.expose()
    except ImageBroken:
        return False
    return True


def refused(capsys, *options):
    """What the command says, in this process, where it ends with 2."""
    command = ["fiberloom", "twin", "--positioners", "3", *options]
    with patch("sys.argv", command), pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    return capsys.readouterr().err


def test_what_cannot_be_is_refused(capsys):
    assert "--camera-listen here: write HOST:PORT" in refused(capsys, "--camera-listen", "here")
    assert "goes with --camera-listen" in refused(capsys, "--camera-discovery", "32227")
    assert "this command cannot act on camera_half" in refused(capsys, "--faults", "camera_half")
    assert "this command cannot act on dark" in refused(capsys, "--faults", "dark=1")
