"""What the doctor finds of positioners with commands of their own, and that it moves none."""

import asyncio
from types import SimpleNamespace

import pytest

import fiberloom as fl
from fiberloom.drive.port import UnitSays
from fiberloom.metrology.camera import NoCamera
from fiberloom.operation.session.doctor.by_drive import DriveCheck
from fiberloom.operation.session.doctor.findings import DoctorLimits, Verdict
from fiberloom.twin.motors.arrays import source_of

N = 7


def checked(plane, look):
    drive = SimpleNamespace() if look is None else SimpleNamespace(look=look)
    hardware = SimpleNamespace(drive=drive, camera=NoCamera(len(plane)))
    return asyncio.run(DriveCheck(plane, hardware, DoctorLimits()).bus())


def saying(plane, **others):
    async def look():
        return {int(i): UnitSays(True) for i in plane.positioner_id} | others.get("told", {})

    return look


@pytest.fixture(scope="module")
def plane():
    return fl.FocalPlane.of("moons", seed=0, n=N)


@pytest.mark.parametrize("name", ["moons", "lamost", "megara", "desi"])
def test_units_of_a_twin_are_asked_and_none_moves(name):
    plane = fl.FocalPlane.of(name, seed=0, n=N)

    async def look():
        hardware = await source_of(plane, 0, "noise", "", "none").open()
        before = hardware.truth.fibre_xy("metrology").copy()
        try:
            findings = await DriveCheck(plane, hardware, DoctorLimits()).bus()
        finally:
            await hardware.drive.close()
        return findings, abs(hardware.truth.fibre_xy("metrology") - before).max()

    findings, moved_mm = asyncio.run(look())
    assert moved_mm == 0.0
    assert (findings[0].verdict, findings[0].text) == (Verdict.OK, f"all {N} of the layout answer")
    assert findings[-1].trouble == ("datum not told" if name == "desi" else "datum lost")


def test_what_units_say_is_told_by_number(plane):
    first, second, third = (int(i) for i in plane.positioner_id[:3])
    told = {first: UnitSays(True, True), second: UnitSays(False), third: UnitSays(True, False, "no switch")}
    findings = {f.trouble: f for f in checked(plane, saying(plane, told=told))}
    assert str(first) in findings["moving"].text
    assert str(second) in findings["datum lost"].text
    assert f"{third}: no switch" in findings["unfit"].text
    assert {f.verdict for f in findings.values() if f.trouble in ("moving", "unfit")} == {Verdict.WRONG}


def test_one_that_does_not_answer_is_named(plane):
    async def look():
        return {int(i): UnitSays(True) for i in plane.positioner_id[1:]}

    finding = checked(plane, look)[0]
    assert finding.trouble == "silent positioners"
    assert str(plane.positioner_id[0]) in finding.text


def test_all_well_is_ok(plane):
    assert {f.verdict for f in checked(plane, saying(plane))} == {Verdict.OK}


def test_a_drive_that_cannot_be_asked_is_not_called_well(plane):
    (finding,) = checked(plane, None)
    assert (finding.verdict, finding.trouble) == (Verdict.WRONG, "not checked")
