"""A camera that fails in the middle of a command: alarm, retry, no motion without a fresh image."""

import asyncio
import contextlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.bus.identifier import decode
from fiberloom.bus.protocol import Command
from fiberloom.metrology.acquisition import AcquisitionError
from fiberloom.metrology.sources.errors import (
    CameraAborted,
    CameraError,
    CameraGone,
    CameraRefused,
    CameraSilent,
    ImageBroken,
    ImageStale,
)
from fiberloom.metrology.sources.spec import CameraSpec, open_camera
from fiberloom.operation.safety.looking import PatientCamera
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.targets import random_targets
from fiberloom.twin.camera.imaging import StillScene, TwinScene
from fiberloom.twin.camera.models import imaging_camera, model_for
from fiberloom.twin.server.camera.alpaca import AlpacaServer
from fiberloom.twin.server.camera.exposing import Look, TwinShutter

FAILURES = (CameraSilent("hangs"), ImageBroken("half"), ImageStale("yesterday's"), CameraRefused("500"))


class Scripted:
    """Fails as told, then gives an image."""

    def __init__(self, *failures):
        self.failures, self.given_up = list(failures), 0

    def measure(self, expected_mm=None):
        if self.failures:
            raise self.failures.pop(0)
        return "image"

    def abort(self):
        self.given_up += 1


def patient(camera, retries=5):
    """With what it records and how long it waits."""
    events, waits = [], []

    async def sleep(s):
        waits.append(s)

    operation = SimpleNamespace(camera_retries=retries, camera_wait_s=7.0, requirement_um=5.0)
    return PatientCamera(camera, operation, lambda *e: events.append(e), sleep), events, waits


def test_each_failure_is_an_alarm_and_the_image_is_taken_when_it_comes():
    eye, events, waits = patient(Scripted(*FAILURES, AcquisitionError("0 spots")))
    assert asyncio.run(eye.patiently(None)) == "image"
    assert [kind for kind, _ in events] == ["alarm"] * 5 + ["camera"]
    assert events[0][1] == "no image: hangs; nothing moves; once more in 7 s (5 left)"
    assert events[5][1] == "images again, after 5 that could not be used"
    assert waits == [7.0] * 5


def test_after_the_last_try_the_command_ends():
    eye, events, waits = patient(Scripted(*FAILURES), retries=3)
    with pytest.raises(CameraGone, match="500; that was image 4 in a row"):
        asyncio.run(eye.patiently(None))
    assert len(events) == 4
    assert events[-1][1].endswith("the command ends")
    assert len(waits) == 3


def test_one_that_was_given_up_is_not_asked_again():
    eye, events, _ = patient(Scripted(CameraAborted("by hand")))
    with pytest.raises(CameraAborted):
        asyncio.run(eye.patiently(None))
    assert events == []


def test_a_cancelled_exposure_is_given_up():
    camera = Scripted()
    eye, _, _ = patient(camera)

    async def cancelled():
        task = asyncio.ensure_future(eye.once(None))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(cancelled())
    assert camera.given_up == 1


# an observation on the twin

N = 7
PLANE = fl.FocalPlane.of("sdssv", n=N)
TARGETS = random_targets(PLANE, 20 * N, 1)


class Flaky:
    """The camera of a twin, which fails so often before each image but the first."""

    def __init__(self, camera, failures, log):
        self._camera, self._failures, self._log = camera, failures, log
        self._left = ()

    def measure(self, expected_mm=None):
        if self._left:
            self._log.append("failure")
            raise self._left.pop(0)
        self._left = list(self._failures)
        self._log.append("image")
        return self._camera.measure(expected_mm)


def observing(failures, out, **how):
    """A field whose camera fails, and what happens on the bus and to the camera in order."""
    field = fl.Field.twin(PLANE, camera="noise")
    field.run.calibrate()
    hardware, log = field.source.hardware, []
    send = hardware.transport.send

    async def spied(frames):
        log.extend("START" for f in frames if decode(f[0]).command == Command.START_TRAJECTORY)
        await send(frames)

    hardware.transport.send = spied
    object.__setattr__(hardware, "camera", Flaky(hardware.camera, failures, log))
    if how.pop("book", False):
        field.book = ArrayBook(Store.open(out / "arrays.sqlite"), "cannet://10.1.10.31:19228")
    return field, log


def events_of(out, name="store.sqlite"):
    with Store.open(out / name) as store:
        (run,) = store.runs()
        return store.events(run.id), run


def test_an_observation_goes_on_when_the_camera_comes_back(tmp_path):
    field, log = observing(FAILURES, tmp_path)
    seen = field.run.observe(TARGETS, corrections=1, images=1, out=tmp_path)
    summary = seen.summary()
    assert summary["n_within_requirement"] == summary["n_assigned"] > 0
    # no motion begins but after an image
    assert log == ["image", "START", *["failure"] * 4, "image", "START", *["failure"] * 4, "image"]
    events, run = events_of(tmp_path)
    assert run.status == "finished"
    alarms = [t for k, t in zip(events["kind"], events["text"], strict=True) if k == "alarm"]
    assert len(alarms) == 8
    assert "no image: hangs" in alarms[0]
    assert not field.source.hardware.truth.touches()


def test_a_camera_that_stays_away_ends_the_command_with_all_at_rest_and_their_places_kept(tmp_path):
    field, log = observing([CameraSilent("alpaca://a/0: no answer")] * 99, tmp_path, book=True)
    twin = field.source.hardware.truth
    with pytest.raises(CameraError, match=r"no answer; that was image 6 in a row .*`fiberloom doctor`"):
        field.run.observe(TARGETS, corrections=1, images=1, out=tmp_path)
    assert log == ["image", "START", *["failure"] * 6]
    events, run = events_of(tmp_path)
    assert run.status != "running"
    (stopped,) = events["text"][events["kind"] == "stopped"]
    assert f"{N} positioners at rest" in stopped
    rest_deg = twin.truth()
    twin.run(2.0)
    np.testing.assert_allclose(twin.truth(), rest_deg, atol=0.02)
    state = field.book.state()
    assert (state.state, state.owned) == ("stopped", False)
    assert "no answer" in state.text
    np.testing.assert_allclose(field.book.places(PLANE.positioner_id).angles_deg, rest_deg, atol=1.0)


def test_before_anything_has_moved_a_camera_that_fails_is_told_at_once(tmp_path):
    field, log = observing((), tmp_path)
    field.source.hardware.camera._left = [CameraSilent("no camera there")]
    with pytest.raises(CameraSilent, match="no camera there"):
        field.run.observe(TARGETS, corrections=1, images=1, out=tmp_path)
    assert log == ["failure"]


# a camera behind sockets

SMALL = {"width_px": 1000, "height_px": 1022, "scale_mm_px": 0.729}
"""A megapixel, which is painted in a moment: its centroids are good to some micrometres."""
SAID = {
    "camera_hang": "no image after 1 s",
    "camera_half": "cut short",
    "camera_stale": "before it was asked for",
    "camera_error": "500",
}
"""How the host tells of each fault."""


class TwinWithFault:
    """What the served camera looks at; `broken`: its fault."""

    def __init__(self, twin):
        self._twin, self.broken = twin, None

    def look(self):
        return Look(self._twin.time_s, TwinScene(self._twin).lit_mm())

    def faults(self):
        return frozenset({self.broken} - {None})


class FaultAfterFault:
    """The camera as the host has it: after its first image one fault follows the other, each seen once."""

    def __init__(self, camera, twin):
        self._camera, self._twin, self._left = camera, twin, list(SAID)

    def measure(self, expected_mm=None):
        source = self._camera.source
        source.deadline_s = 1.0 if self._twin.broken == "camera_hang" else 120.0
        try:
            measured = self._camera.measure(expected_mm)
        finally:
            self._twin.broken = self._left.pop(0) if self._left else None
        return measured


@contextlib.contextmanager
def behind_sockets(twin):
    """An Alpaca camera that looks at a twin, as a host has it."""
    camera = PLANE.instrument.camera.model_copy(update=SMALL)
    plane = replace(PLANE, instrument=PLANE.instrument.model_copy(update={"camera": camera}))
    served = TwinWithFault(twin)
    painter = imaging_camera(StillScene(PLANE.centres_mm[:0]), plane, 0, model_for(plane), threads=1)
    server = AlpacaServer(TwinShutter(painter, served, speed=100.0), "127.0.0.1", 0)
    host = open_camera(CameraSpec.parse(f"alpaca://127.0.0.1:{server.port}/0?retries=0&clock=0"), plane)
    try:
        yield FaultAfterFault(host, served)
    finally:
        host.close()
        server.close()


def test_every_fault_of_the_camera_comes_and_goes_and_the_observation_completes(tmp_path):
    """One after another while the first image after the move is wanted."""
    field = fl.Field.twin(PLANE, camera="noise")
    field.run.calibrate()
    hardware = field.source.hardware
    with behind_sockets(hardware.truth) as camera:
        object.__setattr__(hardware, "camera", camera)
        seen = field.run.observe(TARGETS, corrections=1, images=1, out=tmp_path)
    assert seen.summary()["moves"][-1]["true_rms_um"] < 30.0
    events, run = events_of(tmp_path)
    assert run.status == "finished"
    alarms = [t for k, t in zip(events["kind"], events["text"], strict=True) if k == "alarm"]
    assert len(alarms) == len(SAID)
    for alarm, said in zip(alarms, SAID.values(), strict=True):
        assert said in alarm
    (back,) = events["text"][events["kind"] == "camera"]
    assert back == "images again, after 4 that could not be used"
