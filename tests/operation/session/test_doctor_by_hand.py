"""Where the doctor draws its lines: layout, clock, maps, and what it finds of a healthy array."""

import asyncio
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import numpy as np
import pytest
from arrays import BUS, TwinArray, layout, maps_of

from fiberloom.bus.protocol import Status
from fiberloom.calibration.transmission.maps import Provenance
from fiberloom.metrology.images import CameraImage
from fiberloom.metrology.spots import Flag
from fiberloom.operation.session.doctor.array import ArrayCheck, check_gateways, check_numbers
from fiberloom.operation.session.doctor.doctor import Doctor
from fiberloom.operation.session.doctor.findings import DoctorLimits, Verdict
from fiberloom.operation.session.doctor.here import (
    check_calibration,
    check_clock,
    check_disk,
    check_exclusions,
    check_owner,
)
from fiberloom.operation.session.session import KnownArray
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook

PLANE = layout(7)


@pytest.fixture
def known(tmp_path):
    with Store.open(tmp_path / "arrays.sqlite") as store:
        yield KnownArray(PLANE, maps_of(PLANE), TwinArray.of(PLANE, PLANE.park_deg), ArrayBook(store, BUS))


def test_a_healthy_array_has_nothing_wrong(known):
    said = []
    findings = asyncio.run(Doctor(known, "twin:", DoctorLimits(disk_mb=0.0), said.append).look())
    assert [f for f in findings if f.verdict is Verdict.WRONG] == []
    checks = [f.check for f in findings]
    assert checks[:5] == ["disk", "clock", "owner", "exclusions", "calibration"]
    assert {"positioners", "flags", "camera", "light", "maps"} <= set(checks)
    assert said == ["asking the gateways", "asking the positioners", "taking an image"]


@pytest.mark.parametrize(
    ("bits", "trouble"),
    [
        (0, ""),
        (Status.STORAGE_FAILED, "storage failed"),
        (Status.COLLISION_ALPHA, "collided"),
        (Status.ESTIMATED_POSITION, "datum lost"),
    ],
)
def test_what_status_words_tell_is_said_by_number(bits, trouble):
    async def status(ids):
        datums = Status.DATUMS_INITIALIZED
        return {int(i): SimpleNamespace(ok=True, values=[datums | (bits if i == ids[2] else 0)]) for i in ids}

    check = ArrayCheck(PLANE, SimpleNamespace(bus=None, camera=None), DoctorLimits())
    check.client, check.answered = SimpleNamespace(status=status), np.ones(7, dtype=bool)
    finding = asyncio.run(check._flags())
    assert finding.trouble == trouble
    assert (str(PLANE.positioner_id[2]) in finding.text) == bool(trouble)


@pytest.mark.parametrize(
    ("far", "trouble"),
    [(0, ""), (3, ""), (4, "wrong layout"), (7, "wrong layout")],
)
def test_half_of_the_fibres_beyond_a_millimetre_is_another_layout(known, far, trouble):
    miss_mm = np.where(np.arange(7) < far, 1.2, 0.01)
    (finding,) = Doctor(known, BUS, DoctorLimits())._compare(miss_mm)
    assert finding.trouble == trouble


def test_half_of_the_fibres_within_a_millimetre_is_no_other_layout(known):
    (finding,) = Doctor(known, BUS, DoctorLimits())._compare(np.full(7, 0.8))
    assert finding.trouble == "calibration of other units"


@pytest.mark.parametrize(
    ("now", "trouble"),
    [
        (datetime(2024, 12, 31, 23, 59, 59, tzinfo=UTC), "clock off"),
        (datetime(1970, 1, 1, 0, 10, tzinfo=UTC), "clock off"),
        (datetime(2025, 1, 1, 0, 0, 1, tzinfo=UTC), ""),
    ],
)
def test_a_clock_before_2025_was_never_set(known, now, trouble):
    assert check_clock(known.book, DoctorLimits(), now).trouble == trouble


@pytest.mark.parametrize(("back_s", "trouble"), [(1.0, ""), (4.0, "clock off")])
def test_a_clock_behind_the_last_record_was_set_back(known, back_s, trouble):
    token, _ = known.book.take("fiberloom test", "connecting")
    since = known.book.state().since
    assert check_clock(known.book, DoctorLimits(), since - timedelta(seconds=back_s)).trouble == trouble
    known.book.release(token, "idle", "")


# what is on record


def test_a_store_elsewhere_is_named_without_its_password():
    finding = check_disk("postgresql://ana:secret@db.example/arrays", DoctorLimits())
    assert finding.verdict is Verdict.OK
    assert finding.text.endswith(": db.example/arrays")


def test_an_exclusion_of_a_positioner_that_is_not_in_the_layout(known):
    ids = [int(PLANE.positioner_id[2]), 99_999]
    known.book.exclude(ids[:1], "Ana", "dark")
    finding = check_exclusions(known.book, PLANE)
    assert (finding.verdict, finding.text) == (Verdict.OK, str(ids[0]))
    known.book.exclude(ids[1:], "Ana", "dark")
    finding = check_exclusions(known.book, PLANE)
    assert finding.trouble == "not in the layout"
    assert finding.text.endswith(": 99999")


@pytest.mark.parametrize(
    ("about", "trouble", "text"),
    [
        ({"gear": 999.0}, "calibration of other units", "made for a gear of 999, the layout has"),
        ({"utc": "last summer"}, "age not known", "made at 'last summer'"),
        ({"config_hash": "0123abcd"}, "another layout", "made with another layout (0123abcd; this one is"),
        ({}, "", "7 positioners, 0.0 days old"),
    ],
)
def test_of_what_a_calibration_was_made(about, trouble, text):
    made = {"gear": float(PLANE.instrument.alpha.gear), "config_hash": PLANE.config_hash()}
    maps = replace(maps_of(PLANE), provenance=Provenance(**made | about))
    finding = check_calibration(PLANE, maps, DoctorLimits())
    assert finding.trouble == trouble
    assert text in finding.text


def test_an_owner_that_is_gone_is_told_with_what_it_was_doing(known):
    known.book.take("fiberloom park", "moving")
    row = replace(known.book.state(), process_start="of another process with this number")
    finding = check_owner(SimpleNamespace(state=lambda: row))
    assert finding.trouble == "owner gone"
    assert "has ended while the array was moving" in finding.text


# what the array says


def asked(**client):
    """Checks of an array whose positioners answer as told."""
    check = ArrayCheck(PLANE, SimpleNamespace(bus=None, camera=None), DoctorLimits())
    check.client = SimpleNamespace(**client)
    return check


def test_one_without_a_gateway_has_none_to_ask():
    assert asyncio.run(check_gateways("socketcan:can0")) == []


def test_one_with_another_firmware_is_named():
    ids = PLANE.positioner_id.tolist()
    finding = asked()._versions(dict.fromkeys(ids, "4.1.21") | {ids[3]: "4.0.2"})
    assert finding.trouble == "versions differ"
    assert finding.text == f"4.1.21, but not {ids[3]} (4.0.2)"
    assert asked()._versions(dict.fromkeys(ids, "4.1.21")).text == "4.1.21"


def test_where_none_answers_no_more_is_asked():
    async def none():
        return []

    (finding,) = asyncio.run(asked(discover=none).bus())
    assert finding.trouble == "none answers"


def test_a_few_that_are_silent_are_named():
    ids = PLANE.positioner_id.tolist()
    finding = check_numbers(PLANE, set(ids[:-1]))
    assert finding.trouble == "silent positioners"
    assert f"no answer from {ids[-1]}" in finding.text


def photograph(begun_utc_s, saturated, top_adu=65535.0):
    """What a camera keeps of an image with 100 spots, of which so many are saturated."""
    pixels = np.zeros((4, 5))
    pixels[2, 2] = top_adu
    image = CameraImage(pixels, saturation_adu=65535.0, exposure_s=1.0, begun_utc_s=begun_utc_s)
    flags = np.where(np.arange(100) < saturated, Flag.SATURATED, 0)
    return SimpleNamespace(image=image, spots=SimpleNamespace(flags=flags))


@pytest.mark.parametrize(
    ("begun_utc_s", "saturated", "top_adu", "troubles"),
    [
        (1000.0, 0, 500.0, [""]),
        (1000.0, 2, 65535.0, [""]),
        (1000.0, 3, 65535.0, ["saturated image"]),
        (None, 0, 500.0, [""]),
        (1002.9, 0, 500.0, [""]),
        (1003.1, 0, 500.0, ["clock off", ""]),
        (996.9, 0, 500.0, ["clock off", ""]),
    ],
)
def test_the_clock_and_the_brightest_pixels_of_an_image(begun_utc_s, saturated, top_adu, troubles):
    check = asked()
    check.hardware.camera = SimpleNamespace(last=photograph(begun_utc_s, saturated, top_adu))
    camera, *others = check._exposure(1000.0)
    assert camera.text == "5 x 4 px, 1 s"
    assert [finding.trouble for finding in others] == troubles


def test_before_an_image_no_fibre_is_compared():
    assert len(asked().misses_mm(np.zeros((7, 2)))) == 0
