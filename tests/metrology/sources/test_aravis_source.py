"""GenICam by Aravis, whose own fake camera is in its library, and by a library that answers as told."""

import os
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from fiberloom.metrology.sources.errors import (
    CameraAborted,
    CameraError,
    CameraRefused,
    CameraSilent,
    ImageBroken,
    ImageStale,
)
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


# a library that answers as none of its own cameras does


class Library:
    """Stands for Aravis and for its one camera, stream and image; what it answers can be set."""

    AcquisitionMode = SimpleNamespace(SINGLE_FRAME="SingleFrame")
    BufferStatus = SimpleNamespace(SUCCESS=0)

    def __init__(self):
        self.formats, self.pixels = ["Mono8"], np.arange(12, dtype=np.uint8).reshape(3, 4)
        self.there, self.waits, self.status = True, 0, 0
        self.cut_bytes, self.exposure_us = 0, 0.0
        self.arrived_utc_s = None
        """None: now."""
        self.refuses, self.asked = "", []
        self.Camera = SimpleNamespace(new=self._opened)
        self.Buffer = SimpleNamespace(new_allocate=lambda size: None)

    def _opened(self, name):
        self.asked.append(f"open {name}")
        return self if self.there else None

    def __getattr__(self, name):
        """What needs no answer; `refuses` names what is an error."""

        def call(*words):
            self.asked.append(" ".join(map(str, (name, *words))))
            if name == self.refuses:
                raise RuntimeError(f"{name}: access denied")
            return self

        return call

    def dup_available_pixel_formats_as_strings(self):
        return self.formats

    def get_width_bounds(self):
        return 1, 4

    def get_height_bounds(self):
        return 1, 3

    def set_exposure_time(self, exposure_us):
        self.exposure_us = exposure_us

    def get_exposure_time(self):
        return self.exposure_us

    def timeout_pop_buffer(self, wait_us):
        self.waits -= 1
        if self.waits >= 0:
            time.sleep(wait_us * 1e-6)
            return None
        return self

    def get_status(self):
        return SimpleNamespace(value_nick="missing-packets") if self.status else 0

    def get_system_timestamp(self):
        return int((time.time() if self.arrived_utc_s is None else self.arrived_utc_s) * 1e9)

    def get_image_width(self):
        return self.pixels.shape[1]

    def get_image_height(self):
        return self.pixels.shape[0]

    def get_data(self):
        data = self.pixels.tobytes()
        return data[: len(data) - self.cut_bytes]


@pytest.fixture
def library(monkeypatch):
    made = Library()
    monkeypatch.setitem(sys.modules, "gi", SimpleNamespace(require_version=lambda name, version: None))
    monkeypatch.setitem(sys.modules, "gi.repository", SimpleNamespace(Aravis=made))
    monkeypatch.setitem(sys.modules, "gi.repository.Aravis", made)
    return made


@pytest.mark.parametrize(
    ("formats", "chosen", "kind", "saturation_adu"),
    [
        (["Mono8", "Mono12", "Mono16", "BayerRG8"], "Mono16", np.uint16, 65535.0),
        (["Mono8", "Mono12"], "Mono12", np.uint16, 4095.0),
        (["BayerRG8", "Mono8"], "Mono8", np.uint8, 255.0),
    ],
)
def test_the_deepest_grey_is_read_as_such(library, formats, chosen, kind, saturation_adu):
    library.formats = formats
    library.pixels = (np.arange(12, dtype=np.uint16) * 20).astype(kind).reshape(3, 4)
    image = source("Cam").expose()
    assert f"set_pixel_format_from_string {chosen}" in library.asked
    np.testing.assert_array_equal(image.array(), library.pixels)
    assert image.saturation_adu == saturation_adu
    assert image.exposure_s == pytest.approx(0.05)
    # the whole chip, as one image, and then the camera rests
    assert "set_region 0 0 4 3" in library.asked
    assert library.asked[-1] == "stop_acquisition"


def test_a_camera_without_regions_and_an_image_that_is_waited_for(library):
    library.refuses, library.waits = "set_region", 2
    assert source("Cam").expose().shape == (3, 4)


def test_a_camera_that_is_let_go_is_opened_anew(library):
    camera = source("Cam")
    for lets_go in (False, True, False):
        camera.expose()
        library.pixels += 1  # the same image again would be refused
        if lets_go:
            camera.close()
    assert library.asked.count("open Cam") == 2


@pytest.mark.parametrize(
    ("answer", "kind", "told"),
    [
        ({"there": False}, CameraSilent, "no such camera; arv-tool lists"),
        ({"formats": ["RGB8", "BayerRG8"]}, CameraRefused, "has BayerRG8, RGB8; an image in grey is needed"),
        ({"status": 1}, ImageBroken, "missing-packets: packets lost"),
        ({"cut_bytes": 5}, ImageBroken, "7 bytes for 4 x 3 px: cut short"),
        ({"refuses": "start_acquisition"}, CameraRefused, "access denied; is it switched on, and free"),
        ({"arrived_utc_s": 1e9}, ImageStale, "aravis:Cam"),
    ],
)
def test_what_is_no_image_of_now_is_told_and_the_next_one_taken(library, answer, kind, told):
    camera, usual = source("Cam"), {key: getattr(library, key, "") for key in answer}
    vars(library).update(answer)
    with pytest.raises(kind, match=told):
        camera.expose()
    vars(library).update(usual)
    assert camera.expose().shape == (3, 4)


def test_an_image_that_never_comes(library):
    library.waits = 10**6
    with pytest.raises(CameraSilent, match=r"no image after 0\.2 s, while exposing"):
        source("Cam", deadline_s=0.2).expose()
    assert library.asked[-1] == "stop_acquisition"


def test_without_the_library_the_packages_are_named(monkeypatch):
    """`gi` alone is there: of Aravis it knows nothing."""

    def lacks(name, version):
        raise ValueError(f"Namespace {name} not available")

    monkeypatch.setitem(sys.modules, "gi", SimpleNamespace(require_version=lacks))
    with pytest.raises(
        CameraRefused, match=r"Aravis not available; apt-get install python3-gi gir1\.2-aravis"
    ):
        source().expose()
