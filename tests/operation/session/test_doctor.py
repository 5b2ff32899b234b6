"""The troubles that a doctor has to name (no gateway, in use, wrong layout, ...); and it moves nothing."""

import asyncio
import shutil
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from arrays import TwinArray, done, layout, maps_of

from fiberloom.calibration.transmission.nominal import nominal_maps
from fiberloom.metrology.acquisition import AcquisitionError
from fiberloom.metrology.images import CameraImage
from fiberloom.metrology.sources.errors import CameraSilent, ImageStale
from fiberloom.metrology.sources.fresh import FreshnessCheck
from fiberloom.operation.session.doctor import here
from fiberloom.operation.session.doctor.array import check_gateways
from fiberloom.operation.session.doctor.doctor import Doctor
from fiberloom.operation.session.doctor.findings import DoctorLimits, Verdict
from fiberloom.operation.session.session import KnownArray
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook

PLANE = layout(7)
BUS = "twin:"
LIMITS = DoctorLimits()


@pytest.fixture
def book(tmp_path):
    with Store.open(tmp_path / "arrays.sqlite") as store:
        yield ArrayBook(store, "twin:1")


class Source:
    """A twin's array, with another camera in front of it where a test wants one."""

    def __init__(self, array, camera=None):
        self.array, self.camera = array, camera

    async def open(self):
        hardware = await self.array.open()
        return hardware if self.camera is None else replace(hardware, camera=self.camera(hardware.camera))


def troubles(book, array=None, camera=None, plane=PLANE, maps=None, limits=LIMITS):
    array = TwinArray.of(PLANE) if array is None else array
    known = KnownArray(plane, maps_of(plane) if maps is None else maps, Source(array, camera), book)
    findings = done(Doctor(known, BUS, limits).look())
    return {f.trouble: f for f in findings if f.verdict is Verdict.WRONG}


def test_a_healthy_array_has_no_trouble_and_does_not_move(book):
    array = TwinArray.of(PLANE)
    before_mm = array.twin.fibre_xy("metrology")
    assert troubles(book, array) == {}
    np.testing.assert_allclose(array.twin.fibre_xy("metrology"), before_mm, atol=1e-4)


def test_no_gateway():
    (found,) = asyncio.run(check_gateways("cannet://127.0.0.1:1"))
    assert (found.verdict, found.trouble) == (Verdict.WRONG, "no gateway")


def test_a_gateway_in_use_by_another_program():
    async def scenario():
        async def hang_up(reader, writer):
            writer.close()

        server = await asyncio.start_server(hang_up, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        try:
            return await check_gateways(f"cannet://127.0.0.1:{port}")
        finally:
            server.close()

    (found,) = asyncio.run(scenario())
    assert found.trouble == "gateway in use"
    assert "one client at a time" in found.text


def test_a_gateway_in_use_by_a_command_of_ours(book):
    book.take("fiberloom observe t.csv", "moving")
    array = TwinArray.of(PLANE)
    found = troubles(book, array)
    assert set(found) == {"gateway in use"}
    assert "fiberloom observe t.csv" in found["gateway in use"].text
    assert array.twin.time_s == 0.0  # its owner is not disturbed


def test_the_wrong_layout_by_numbers(book):
    none = Broken(CameraSilent("alpaca://a: no image"))
    strangers = troubles(book, TwinArray.of(layout(19)), camera=none)["wrong layout"].text
    assert "7 of 7 of the layout answer; not in the layout: 182, 204, 206" in strangers
    missing = troubles(book, plane=layout(19), maps=nominal_maps(layout(19)), camera=none)[
        "wrong layout"
    ].text
    assert "7 of 19 of the layout answer; missing: 182, 204, 206" in missing


def test_the_wrong_layout_by_the_image(book):
    turned = PLANE.arms.copy()
    turned[:, 3] += np.deg2rad(30.0)
    assert "wrong layout" in troubles(book, plane=replace(PLANE, arms=turned))


class Broken:
    """A camera of which an image is not to be had."""

    def __init__(self, error):
        self.error, self.last = error, None

    def __call__(self, camera):
        return self

    def measure(self, expected_mm=None):
        raise self.error


@pytest.mark.parametrize(
    ("error", "trouble"),
    [
        (AcquisitionError("no fiducials in the image"), "dark field"),
        (CameraSilent("alpaca://a: no image after 21 s"), "no camera"),
        (ImageStale("alpaca://a: the same image again"), "old image"),
    ],
)
def test_troubles_of_the_camera(book, error, trouble):
    assert set(troubles(book, camera=Broken(error))) == {trouble}


@pytest.mark.parametrize("off_s", [-60.0, 60.0])
def test_the_clock_of_the_camera(book, off_s):
    pixels, now_s = np.arange(12.0, dtype=np.float32).reshape(3, 4), 1.8e9
    image = CameraImage(pixels, begun_utc_s=now_s + off_s)
    with pytest.raises(ImageStale) as told:
        FreshnessCheck("alpaca://a").check(image, now_s, now_s + 1.0)
    assert set(troubles(book, camera=Broken(told.value))) == {"clock off"}


def test_a_dark_field(book):
    array = TwinArray.of(PLANE)
    array.dark = [0, 1, 2, 3, 4]
    assert "dark field" in troubles(book, array)


class Photographed:
    """A camera that keeps its last image: `top` is the brightest of its pixels, in units of 65535."""

    def __init__(self, top, flags):
        self.top, self.flags = top, flags

    def __call__(self, camera):
        self.camera = camera
        return self

    def measure(self, expected_mm=None):
        image = CameraImage(np.full((4, 4), self.top, np.float32), saturation_adu=65535.0)
        spots = type("Spots", (), {"flags": np.array(self.flags)})()
        self.last = type("Reduction", (), {"image": image, "spots": spots})()
        return self.camera.measure(expected_mm)


def test_a_saturated_image(book):
    assert set(troubles(book, camera=Photographed(65535.0, [1, 1, 0]))) == {"saturated image"}
    assert troubles(book, camera=Photographed(65535.0, [0] * 100)) == {}  # one hot pixel
    assert troubles(book, camera=Photographed(30000.0, [0, 0, 0])) == {}


def test_the_calibration_of_other_units(book):
    others = maps_of(layout(7, seed=3), seed=3)
    found = troubles(book, maps=others)
    assert set(found) == {"calibration of other units"}
    assert "um (median)" in found["calibration of other units"].text


def test_an_old_calibration(book):
    maps = maps_of(PLANE)
    old = (datetime.now(UTC) - timedelta(days=400)).isoformat()
    assert set(troubles(book, maps=replace(maps, provenance=replace(maps.provenance, utc=old)))) == {
        "calibration old"
    }


def test_no_calibration_is_no_trouble(book):
    assert troubles(book, maps=nominal_maps(PLANE)) == {}


def test_a_clock_that_went_back(book):
    book.take("x", "idle")
    past = datetime.now(UTC) - timedelta(hours=1)
    assert here.check_clock(book, LIMITS, past).trouble == "clock off"
    assert here.check_clock(book, LIMITS, datetime(2000, 1, 1, tzinfo=UTC)).trouble == "clock off"
    assert here.check_clock(book, LIMITS).trouble == ""


def test_a_full_disk(book, monkeypatch):
    usage = shutil.disk_usage(".")
    monkeypatch.setattr(here.shutil, "disk_usage", lambda folder: usage._replace(free=100_000_000))
    assert set(troubles(book)) == {"disk full"}
    assert troubles(book, limits=replace(LIMITS, disk_mb=50.0)) == {}


def test_a_locked_array(book):
    book.note_stopped("collision of 4, 9", "locked")
    assert "fiberloom recover" in troubles(book)["locked"].text
