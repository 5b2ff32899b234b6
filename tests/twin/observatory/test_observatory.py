"""`fiberloom twin` with a camera, as a process: a host reads its images by Alpaca and from its folder."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from doors import PATIENCE_S, failure

import fiberloom
from fiberloom.instruments import generate, load_instrument
from fiberloom.instruments.model import METROLOGY
from fiberloom.metrology.sources import alpaca as alpaca_source
from fiberloom.metrology.sources.errors import CameraSilent, ImageBroken, ImageStale
from fiberloom.metrology.sources.spec import CameraSpec, open_camera
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.camera.models import image_camera

pytestmark = pytest.mark.slow
NUMBER, SEED = 7, 5
# tests that run side by side, in workers gw0, gw1, ..., listen at ports of their own
PORT = 19411 + 10 * int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
LISTEN, CAMERA, OTHER = (f"127.0.0.1:{PORT + k}" for k in range(3))


@pytest.fixture(scope="module")
def instrument(tmp_path_factory):
    """SDSS-V with a camera of a megapixel, which is painted in a moment."""
    text = (Path(fiberloom.__file__).parent / "instruments" / "presets" / "sdssv.toml").read_text()
    for key, value in (("width_px", "1000"), ("height_px", "1022"), ("scale_mm_px", "0.729")):
        text, n = re.subn(rf"^{key} = [\d.]+", f"{key} = {value}", text, flags=re.M)
        assert n == 1
    path = tmp_path_factory.mktemp("instrument") / "small.toml"
    path.write_text(text)
    return path


@contextmanager
def served(instrument, *options):
    command = [
        sys.executable,
        "-m",
        "fiberloom.cli",
        "twin",
        "--instrument",
        str(instrument),
        "--listen",
        LISTEN,
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


def in_one_process(instrument):
    """The camera that `observe` has, and its first measurement of the folded field."""
    there = plane(instrument)
    return image_camera(Twin(there, draw_units(there, SEED), seed=SEED), SEED)


def test_the_same_image_as_in_one_process(instrument):
    camera = in_one_process(instrument)
    wanted = camera.source.expose()
    with served(instrument, "--camera-listen", CAMERA) as (_, doors):
        assert doors == f"camera: alpaca://{CAMERA}/0"
        host = open_camera(CameraSpec.parse(f"alpaca://{CAMERA}/0"), plane(instrument))
        image = host.source.expose()
        assert_alike(image.pixels, wanted.pixels)
        assert (image.gain_e_adu, image.saturation_adu) == (wanted.gain_e_adu, int(wanted.saturation_adu))
        seen = host.measure(plane(instrument).forward(*folded(instrument), METROLOGY))
    assert seen.seen.all()


def assert_alike(pixels, wanted):
    """The served arms have been held for some seconds: nanometres, a count in a few pixels of a spot."""
    difference = pixels.astype(int) - wanted
    assert np.abs(difference).max() <= 2
    assert np.count_nonzero(difference) < 1e-4 * difference.size


def folded(instrument):
    return np.broadcast_to(plane(instrument).instrument.positioner.park_deg, (NUMBER, 2)).T


def test_files_hold_the_same_image(instrument, tmp_path):
    wanted = in_one_process(instrument).source.expose()
    with served(instrument, "--camera-folder", str(tmp_path)) as (_, doors):
        url = doors.removeprefix("camera: ")
        assert url == f"folder:{tmp_path}?trigger=touch {{folder}}/expose_{{exposure}}"
        host = open_camera(CameraSpec.parse(url), plane(instrument))
        image = host.source.expose()
        again = host.source.expose()
        host.close()
    assert_alike(image.array(), wanted.pixels)
    assert (again.array() != wanted.pixels).any()
    assert image.exposure_s == 5.0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["image_000001.fits", "image_000002.fits"]


def indi_packages():
    for package in ("indipyclient", "indipydriver", "indipyserver"):
        pytest.importorskip(package, reason="pip install 'fiberloom[cameras]': INDI")


def test_indi_carries_the_same_image(instrument):
    indi_packages()
    wanted = in_one_process(instrument).source.expose()
    with served(instrument, "--camera-indi", CAMERA) as (_, doors):
        url = doors.removeprefix("camera: ")
        assert url == f"indi://{CAMERA}/Fiberloom Twin"
        host = open_camera(CameraSpec.parse(f"{url}?deadline={PATIENCE_S}&retries=0"), plane(instrument))
        image = host.source.expose()
        host.close()
    assert_alike(image.array(), wanted.pixels)
    assert image.exposure_s == 5.0


def test_indi_carries_half_an_image(instrument):
    indi_packages()
    with served(instrument, "--camera-indi", CAMERA, "--faults", "camera_half") as (_, doors):
        url = f"{doors.removeprefix('camera: ')}?deadline={PATIENCE_S}&retries=0"
        host = open_camera(CameraSpec.parse(url), plane(instrument))
        with pytest.raises(ImageBroken, match="no whole image in FITS"):
            host.source.expose()
        host.close()


def test_a_camera_that_runs_free(instrument, tmp_path):
    options = ("--camera-folder", str(tmp_path), "--camera-every", "0.2")
    with served(instrument, *options) as (_, doors):
        assert doors == f"camera: folder:{tmp_path}"
        host = open_camera(CameraSpec.parse(f"folder:{tmp_path}?clock=0"), plane(instrument))
        asked_utc_s = time.time()
        assert host.source.expose().begun_utc_s > asked_utc_s - 1e-3
        host.close()


@pytest.mark.parametrize(
    ("fault", "kind", "alpaca_s", "folder_s"),
    [
        ("hang", CameraSilent, 2, 2),
        ("half", ImageBroken, PATIENCE_S, PATIENCE_S),
        # a folder is waited for to the deadline: a fresh image may follow an old one
        ("stale", ImageStale, PATIENCE_S, 5),
    ],
)
def test_faults_reach_hosts_as_what_they_are(instrument, tmp_path, fault, kind, alpaca_s, folder_s):
    """In the folder and by Alpaca. `test_door_faults` shows that they leave no trace."""
    options = ("--camera-folder", str(tmp_path), "--camera-listen", CAMERA, "--faults", f"camera_{fault}")
    with served(instrument, *options) as (_, doors):
        alpaca, folder = doors.removeprefix("camera: ").split(", ")
        for url in (f"{alpaca}?deadline={alpaca_s}&retries=0", f"{folder}&deadline={folder_s}&retries=0"):
            host = open_camera(CameraSpec.parse(url), plane(instrument))
            assert type(failure(host.source, kind)) is kind
            host.close()


def test_faults_come_and_go_by_the_clock(instrument):
    """Images, none, images: five seconds of ours without the fault, fifteen with it."""
    options = ("--camera-listen", CAMERA, "--faults", "camera_half@50+150")
    with served(instrument, *options) as (_, doors):
        url = f"{doors.removeprefix('camera: ')}?exposure=0.5&deadline={PATIENCE_S}&retries=0"
        host = open_camera(CameraSpec.parse(url), plane(instrument))
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


def test_a_dark_fibre_is_seen_by_nobody(instrument):
    """Without a camera the fault is refused; with one it acts."""
    with served(instrument, "--camera-listen", CAMERA, "--faults", "dark=2"):
        host = open_camera(CameraSpec.parse(f"alpaca://{CAMERA}/0"), plane(instrument))
        seen = host.measure(plane(instrument).forward(*folded(instrument), METROLOGY)).seen
    assert np.count_nonzero(~seen) == 2


def test_a_camera_that_says_where_it_is(instrument, monkeypatch):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        port = free.getsockname()[1]
    monkeypatch.setattr(alpaca_source, "DISCOVERY_PORT", port)
    with served(instrument, "--camera-listen", CAMERA, "--camera-discovery", str(port)):
        assert CAMERA in alpaca_source.alpaca_servers()


def refused(*options):
    command = [sys.executable, "-m", "fiberloom.cli", "twin", "--positioners", "3", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    return done.stderr


def test_what_cannot_be_is_refused():
    assert "--camera-listen here: write HOST:PORT" in refused("--camera-listen", "here")
    assert "goes with --camera-listen" in refused("--camera-discovery", "32227")
    assert "this command cannot act on camera_half" in refused("--faults", "camera_half")
    assert "this command cannot act on dark" in refused("--faults", "dark=1")


def test_a_port_in_use_is_told(instrument):
    with served(instrument, "--camera-listen", CAMERA):
        text = refused("--listen", OTHER, "--camera-listen", CAMERA)
        assert f"alpaca://{CAMERA}/0: Address already in use" in text
