"""Where the doctor draws its lines: layout, clock, maps, and what it finds of a healthy array."""

import asyncio
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import numpy as np
import pytest
from arrays import BUS, TwinArray, layout, maps_of

from fiberloom.bus.protocol import Status
from fiberloom.operation.session.doctor.array import ArrayCheck
from fiberloom.operation.session.doctor.doctor import Doctor
from fiberloom.operation.session.doctor.findings import DoctorLimits, Verdict
from fiberloom.operation.session.doctor.here import check_clock
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

    check = ArrayCheck(PLANE, SimpleNamespace(transport=None, camera=None), DoctorLimits())
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
