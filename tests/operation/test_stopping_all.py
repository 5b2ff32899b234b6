"""A stop is carried to its end, whatever asks for it and however often."""

import asyncio
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from programs import heeding_interrupts

import fiberloom as fl
from fiberloom.blocking import finish
from fiberloom.calibration.transmission.maps import identity
from fiberloom.hardware import Hardware
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.move import Goals
from fiberloom.operation.safety.stop import reason, to_its_end
from fiberloom.store import Store
from fiberloom.store.run import STOPPED
from fiberloom.targets import random_targets
from fiberloom.twin import NoiseCamera, Twin, draw_units
from fiberloom.twin.hardware import faulty_transport

CHILD = """
import asyncio, sys
from fiberloom.blocking import finish
from fiberloom.calibration.transmission.maps import identity
from fiberloom.hardware import Hardware
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.move import Goals

async def work():
    print("moving", flush=True)
    try:
        await asyncio.sleep(30)
    except asyncio.CancelledError:
        for _ in range(10):
            await asyncio.sleep(0.05)
        print("at rest", flush=True)
        raise

try:
    finish(work())
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.mark.parametrize("numbers", [("SIGINT",), ("SIGTERM",), ("SIGHUP",), ("SIGINT", "SIGINT", "SIGTERM")])
def test_signals_let_the_task_stop_what_it_has_set_in_motion(numbers):
    with subprocess.Popen(
        [sys.executable, "-c", CHILD], stdout=subprocess.PIPE, text=True, preexec_fn=heeding_interrupts
    ) as process:
        assert process.stdout.readline() == "moving\n"
        for number in numbers:
            process.send_signal(getattr(signal, number))
            time.sleep(0.1)
        rest, _ = process.communicate(timeout=120)
    assert rest == "at rest\n"
    assert process.returncode == 130


def test_handlers_are_as_before_afterwards():
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    assert finish(asyncio.sleep(0, "done")) == "done"
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_what_the_shell_took_from_a_process_stays_taken():
    old = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        finish(asyncio.sleep(0))
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, old)


def test_a_cancellation_of_its_own_is_no_interrupt():
    async def cancelled():
        raise asyncio.CancelledError

    with pytest.raises(asyncio.CancelledError):
        finish(cancelled())


def test_what_has_begun_is_carried_to_its_end():
    done = []

    async def slowly():
        for i in range(5):
            await asyncio.sleep(0.01)
            done.append(i)
        return "rest"

    async def scenario():
        task = asyncio.ensure_future(to_its_end(slowly()))
        for _ in range(3):
            await asyncio.sleep(0.008)
            task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        return await to_its_end(slowly())

    assert asyncio.run(scenario()) == "rest"
    assert done == [0, 1, 2, 3, 4] * 2


def test_an_error_of_the_work_is_raised():
    async def fails():
        await asyncio.sleep(0)
        raise ValueError("no bus")

    with pytest.raises(ValueError, match="no bus"):
        asyncio.run(to_its_end(fails()))


def test_reasons_are_for_operators():
    assert reason(asyncio.CancelledError()) == "stopped by the operator"
    assert reason(OSError("disk full")) == "stopped after an error: disk full"
    assert reason(ValueError()) == "stopped after an error: ValueError"


N = 12


class Cancelling:
    """A transport that cancels a task at a time of the twin."""

    def __init__(self, inner, at_s):
        self._inner, self.at_s, self.task = inner, at_s, None

    def __getattr__(self, name):
        return getattr(self._inner, name)

    async def receive(self, timeout_s):
        frames = await self._inner.receive(min(timeout_s, 0.005))
        if self.task is not None and self.time_s >= self.at_s:
            self.task.cancel()
            self.task = None
        return frames


@pytest.mark.parametrize("at_s", [2.0, 5.5])
def test_a_cancelled_observation_leaves_every_positioner_at_rest(tmp_path, at_s):
    plane = fl.FocalPlane.of("sdssv", n=N)
    targets = random_targets(plane, 20 * N, 3)
    field = fl.Field.twin(plane, camera="noise")
    hardware = field.source.hardware
    twin = hardware.truth

    async def scenario():
        await field.calibrate()
        transport = Cancelling(hardware.transport, at_s)
        object.__setattr__(hardware, "transport", transport)
        transport.task = asyncio.ensure_future(field.observe(targets, corrections=1, out=tmp_path))
        with pytest.raises(asyncio.CancelledError):
            await transport.task

    asyncio.run(scenario())
    twin.run(max(0.0, at_s + 0.5 - twin.time_s))
    rest_deg = twin.truth()
    assert np.abs(rest_deg - plane.park_deg).max() > 5.0  # they were on their way
    twin.run(2.0)
    np.testing.assert_allclose(twin.truth(), rest_deg, atol=0.02)
    with Store.open(tmp_path / "store.sqlite") as store:
        (run,) = store.runs()
        assert run.status == "interrupted"
        events = store.events(run.id)
        (text,) = events["text"][events["kind"] == STOPPED]
        assert text.startswith(f"stopped by the operator; {N} positioners at rest")
        rows = store.measurements(run.id)
        left = rows["kind"] == STOPPED
        wire = np.column_stack([rows[f"wire_{axis}_deg"][left] for axis in ("alpha", "beta")])
    # where the record says they are, through the gears of the twin: 0.6 deg of non-linearity
    np.testing.assert_allclose(wire, rest_deg, atol=1.0)
    seen = field.run.observe(targets, corrections=1, out=tmp_path)
    assert seen.summary()["n_within_requirement"] == seen.summary()["n_assigned"] > 0
    assert not twin.touches()


class Kept:
    """A recorder that keeps where each was left, and events."""

    def __init__(self):
        self.lefts = []

    def left(self, *what):
        self.lefts.append(what)

    def __getattr__(self, name):
        return lambda *args: None


class OfSome:
    """The camera of a twin, for the first n positioners."""

    def __init__(self, twin, n):
        self._camera, self._n = NoiseCamera(twin, 0.669, 0), n

    def measure(self, expected_mm=None):
        image = self._camera.measure()
        x, y, seen = (a[: self._n] for a in (image.x_mm, image.y_mm, image.seen))
        return type(image)(x, y, seen, image.time_s)


def motion_of(plane, twin, recorder, faults=""):
    bus = faulty_transport(twin, faults, 0)
    vouched = np.ones(len(plane), dtype=bool)
    hardware = Hardware(bus, OfSome(twin, len(plane)), twin, vouched=vouched)
    return FieldMotion(plane, identity(plane.positioner_id), hardware, recorder)


def test_what_is_on_the_bus_and_not_in_the_layout_is_stopped_too_and_only_the_others_are_booked():
    whole = fl.FocalPlane.of("sdssv", n=7)
    plane = whole.select(np.arange(5))
    twin = Twin(whole, draw_units(whole, 0), seed=0)
    kept = Kept()
    motion = motion_of(plane, twin, kept)
    strangers = whole.positioner_id[5:].tolist()

    async def scenario():
        await motion.connect()
        begun = await motion.client.goto(strangers, 40.0, 150.0)
        assert begun.ok.all()
        await motion.client.sleep(1.0)
        await motion.stop("stopped by the operator")

    asyncio.run(scenario())
    ((_, _, answered, text),) = kept.lefts
    assert answered.tolist() == [True] * 5
    assert text.startswith("stopped by the operator; 5 positioners at rest")
    rest_deg = twin.truth()
    assert np.abs(rest_deg - whole.park_deg)[5:].max() > 2.0  # they were on their way
    twin.run(1.0)
    np.testing.assert_allclose(twin.truth(), rest_deg, atol=0.02)


@pytest.mark.parametrize("where", ["_come_to_rest", "_read_positions"])
def test_an_error_before_all_have_been_heard_stops_all(where):
    plane = fl.FocalPlane.of("sdssv", n=7)
    kept, refused = Kept(), "refuse=#" + str(plane.positioner_id[3])
    motion = motion_of(plane, Twin(plane, draw_units(plane, 0), seed=0), kept, refused)

    async def scenario():
        await motion.connect()
        real, calls = getattr(motion, where), []

        async def fails(*args):
            calls.append(args)
            if len(calls) == 1:
                raise OSError("no bus")
            return await real(*args)

        setattr(motion, where, fails)
        with pytest.raises(OSError, match="no bus"):
            await motion.go(Goals.without_targets(plane, plane.park_deg - [0.0, 30.0]))

    asyncio.run(scenario())
    ((_, _, _, text),) = kept.lefts
    assert text.startswith("stopped after an error: no bus")
