"""Steppers go home between fields: what was lost on the way is found at the datum, and told."""

import asyncio

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.calibration.transmission.nominal import nominal_maps
from fiberloom.drive.steppers import StepperDrive
from fiberloom.field import Field
from fiberloom.hardware import Hardware
from fiberloom.operation.session.session import KnownArray, Session, as_table
from fiberloom.operation.source import OutsideArray
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.targets.generate import random_targets
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.steppers.kinds import KINDS
from fiberloom.twin.steppers.source import StepperSource

N = 12


class Array(OutsideArray):
    """An array of a twin that keeps its power from one command to the next; each has a drive of its own."""

    def __init__(self, name):
        self.plane = fl.FocalPlane.of(name, seed=0, n=N)
        self.twin = StepperSource(self.plane, KINDS[name], 0, "noise", "")
        self.camera, self.camera_name = NoiseCamera(self.twin.bus.array, 1.0, 0), ""
        self.faults = FaultClock(self.twin.bus, (), 0)

    @property
    def bus_name(self):
        return "twin of a test"

    async def open(self):
        kind = self.twin.kind
        link = kind.link(self.twin.bus, self.faults)
        drive = StepperDrive(self.plane, link, self.twin.known, kind.maker(self.plane.instrument))
        return Hardware(None, self.camera, vouched=np.ones(N, dtype=bool), drive=drive)


def session_of(array, folder):
    book = ArrayBook(Store.open(str(folder / "arrays.sqlite")), "t")
    known = KnownArray(array.plane, nominal_maps(array.plane), array, book)
    return Session(known, "fiberloom home")


@pytest.mark.parametrize("name", ["megara", "moons", "lamost"])
def test_a_unit_that_has_lost_steps_in_a_field_is_named_at_its_datum(name, tmp_path, monkeypatch):
    # half a degree: more than a datum repeats to, less than what makes arms meet or a camera wonder
    monkeypatch.setattr("fiberloom.twin.steppers.array.LOSES_SHARE", (0.003, 0.005))
    array = Array(name)
    session, bus = session_of(array, tmp_path), array.twin.bus
    at_first = asyncio.run(session.home())
    assert at_first.ok, (at_first.left_out, at_first.lost_steps)
    assert sorted(at_first.datum_found) == array.plane.positioner_id.tolist()
    bus.array.weak[3] = True
    field = Field(array.plane, array, 0)
    targets = random_targets(array.plane, 3 * N, seed=1)
    seen = asyncio.run(field.observe(targets, 0, out=tmp_path / "run"))
    assert seen.assignment.target[3] >= 0
    bus.array.weak[3] = False
    report = asyncio.run(session.home())
    weak = int(array.plane.positioner_id[3])
    assert list(report.lost_steps) == [weak]
    assert "has lost steps since its last datum" in report.lost_steps[weak]
    assert not report.ok
    assert as_table(report)["lost_steps"] == report.lost_steps
    assert report.state == "parked"
    again = asyncio.run(session.home())
    assert again.ok
    assert "lost_steps" not in as_table(again)
    off_deg = bus.array.truth() - array.plane.park_deg
    assert np.abs(off_deg).max() < 2.0


@pytest.mark.parametrize("name", ["megara", "moons", "lamost"])
def test_park_folds_all_that_answer_and_one_that_is_silent_is_not_folded(name, tmp_path):
    """It stands where it was in the field, for nothing moves it."""
    array = Array(name)
    session, bus = session_of(array, tmp_path), array.twin.bus
    asyncio.run(session.home())
    asyncio.run(
        Field(array.plane, array, 0).observe(random_targets(array.plane, 3 * N, seed=1), 0, out=tmp_path)
    )
    silent = int(array.plane.positioner_id[3])
    bus.unheard = {silent}
    report = asyncio.run(session.park())
    assert silent not in report.folded
    assert silent in report.left_out
    assert not report.ok
    off_deg = np.abs(bus.array.truth() - array.plane.park_deg).max(axis=1)
    assert off_deg[3] > 5.0
    assert len(report.folded) >= N // 2  # those beside it stay where they are, by name
    assert off_deg[np.isin(array.plane.positioner_id, report.folded)].max() < 2.0


def test_one_that_was_silent_from_the_begin_is_not_folded(tmp_path):
    """Nothing tells where it is."""
    array = Array("megara")
    silent = int(array.plane.positioner_id[3])
    array.twin.bus.unheard = {silent}
    report = asyncio.run(session_of(array, tmp_path).park())
    assert list(report.left_out) == [silent]
    assert not report.ok
