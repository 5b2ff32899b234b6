"""GenICam by Aravis, whose own fake camera is in its library."""

import os
import sys
import threading
import time

import pytest

from fiberloom.metrology.sources.errors import CameraAborted, CameraError
from fiberloom.metrology.sources.remote import ExposureSettings
from fiberloom.metrology.sources.spec import CameraSpec, open_source

pytestmark = pytest.mark.filterwarnings("ignore::ImportWarning", "ignore::DeprecationWarning")  # of gi itself

SYSTEM = "/usr/lib/python3/dist-packages"
"""Where Debian keeps `gi`, of its own Python."""


@pytest.fixture(scope="module")
def aravis():
    if os.path.isdir(f"{SYSTEM}/gi") and SYSTEM not in sys.path:
        sys.path.append(SYSTEM)
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis
    except (ImportError, ValueError) as error:
        pytest.skip(f"apt-get install python3-gi gir1.2-aravis-0.8, for the Python of the system ({error})")
    return Aravis


def source(name="Fake_1", **settings):
    told = ExposureSettings(**{"exposure_s": 0.05, "deadline_s": 60.0, "retries": 0} | settings)
    return open_source(CameraSpec("aravis", name), told)


def test_images_of_the_fake_camera(aravis):
    camera = source()
    begin_s = time.time()
    first, second = camera.expose(), camera.expose()
    assert first.pixels.ndim == 2
    assert first.shape == second.shape
    assert first.exposure_s == pytest.approx(0.05, rel=0.01)
    assert begin_s - 0.5 < first.begun_utc_s < second.begun_utc_s < time.time()
    assert (first.pixels != second.pixels).any()
    camera.close()


def test_a_camera_that_is_not_there(aravis):
    with pytest.raises(CameraError, match="aravis:No-Such"):
        source("No-Such").expose()


def test_a_long_exposure_is_given_up(aravis, monkeypatch):
    camera = source(deadline_s=600.0)
    opened = camera._opened

    def slow(module):
        """The fake camera sends an image after its frame's time, however long the exposure."""
        made = opened(module)
        made.set_frame_rate(0.5)
        return made

    monkeypatch.setattr(camera, "_opened", slow)
    done = threading.Event()

    def ask() -> None:
        """Until it is heeded: before the exposure there is nothing to give up."""
        while not done.wait(0.1):
            camera.abort()

    threading.Thread(target=ask).start()
    try:
        with pytest.raises(CameraAborted):
            camera.expose()
    finally:
        done.set()
