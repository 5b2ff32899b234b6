"""Maps of an array that is swept where it is, held against those of the same units on a bench."""

import asyncio
import re

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.bus.outcome import Results
from fiberloom.errors import InputError
from fiberloom.health.status import FibreStatus
from fiberloom.metrology import Measurement
from fiberloom.operation.field_state import FieldState
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.safety.begin import ALLOWED_MM, Report, Standing, begin_check
from fiberloom.operation.sweep import array_sweep
from fiberloom.operation.sweep.array_sweep import THICKER_MM
from fiberloom.store import Store
from fiberloom.store.arrays import SEEN, ArrayBook, ArrayPlaces
from fiberloom.store.run import STOPPED
from fiberloom.twin import NoiseCamera, Twin, draw_units
from fiberloom.twin.hardware import faulty_transport
from fiberloom.twin.transport import TwinTransport

BUS = "cannet://10.1.10.31:19228"
POINTS = 12
MOVING_MM = 0.005
"""In one wait for frames: more than what a rotor at rest is pulled about."""
PLANE = fl.FocalPlane.of("sdssv", n=19)
IDS = PLANE.positioner_id.tolist()


class Dimmed:
    """A camera that does not see some rows."""

    def __init__(self, camera, dark):
        self.camera, self.dark = camera, dark

    def measure(self, expected_mm=None):
        image = self.camera.measure(expected_mm)
        x, y, seen = image.x_mm.copy(), image.y_mm.copy(), image.seen.copy()
        x[self.dark], y[self.dark], seen[self.dark] = np.nan, np.nan, False
        return Measurement(x, y, seen, image.time_s)


def array(plane=PLANE, faults="", dark=(), seed=0):
    """An opened field of a twin that this host does not know, and the twin."""
    twin = Twin(plane, draw_units(plane, seed), seed=seed)
    bus = faulty_transport(twin, faults, seed) if faults else TwinTransport(twin)
    return fl.Field.open(plane, bus, Dimmed(NoiseCamera(twin, 0.669, 1), list(dark))), twin


@pytest.fixture(scope="module")
def on_bench():
    return fl.Field.twin(PLANE, camera="noise").run.sweep(POINTS).maps


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    field, twin = array()
    return field.run.sweep(POINTS, out=tmp_path_factory.mktemp("swept")), twin


def differences_deg(found, bench, ok):
    """Of the knots (n, 2, 2, K): what one constant an axis explains, and the rest."""
    off = (found.maps.output_deg - bench.output_deg)[ok]
    constant = off.mean(axis=(2, 3), keepdims=True)
    return constant, off - constant


@pytest.mark.slow
def test_an_array_among_its_neighbours_gets_the_maps_of_the_bench(swept, on_bench):
    found, twin = swept
    assert found.summary()["calibrated"] == len(PLANE)
    assert twin.touches() == []
    constant, rest = differences_deg(found, on_bench, found.report.ok)
    # two images a knot, 0.47 um a coordinate each, over 14 mm and more: 0.003 deg
    assert np.sqrt((rest**2).mean()) < 0.005
    assert np.abs(constant).max() < 0.04  # how the layout's lengths are met, by places that differ
    linear = on_bench.output_deg - on_bench.wire_deg
    assert np.sqrt((linear**2).mean()) > 0.1
    np.testing.assert_array_equal(found.maps.wire_deg, on_bench.wire_deg)


@pytest.mark.slow
def test_who_cannot_be_swept_is_named_and_the_others_are_swept(on_bench, tmp_path):
    excluded, dark = IDS[0], 18
    field, twin = array(faults="dead=1", dark=[dark])
    book = ArrayBook(Store.open(tmp_path / "arrays.sqlite"), BUS)
    field.book, field.exclude = book, (excluded,)
    # its datum was searched before its fibre went dark: it moves with the others
    book.note_places(PLANE.positioner_id, vouched_places())
    found = field.run.sweep(POINTS, out=tmp_path)
    refused = found.summary()["refused"]
    assert refused[excluded] == "excluded, or switched off"
    assert refused[IDS[dark]] == "dark: its fibre is not seen"
    (dead,) = [p for p, why in refused.items() if why.startswith("dead: ")]
    assert set(refused) == {excluded, IDS[dark], dead}
    assert twin.touches() == []
    _, rest = differences_deg(found, on_bench, found.report.ok)
    assert np.sqrt((rest**2).mean()) < 0.006
    np.testing.assert_array_equal(found.maps.output_deg[0], found.maps.wire_deg[0])
    assert (book.state().state, book.state().owned) == ("parked", False)


def vouched_places():
    """All folded, with their datums on record."""
    n = len(PLANE)
    return ArrayPlaces(PLANE.park_deg, PLANE.park_deg, [SEEN] * n, np.ones(n, dtype=bool), [None] * n)


class Counting:
    """A watcher that knows how many points there are."""

    done = 0

    def say(self, text):
        pass

    def count(self, done, total):
        self.done = done


def test_a_sweep_that_is_stopped_in_motion_leaves_all_at_rest_and_its_record(tmp_path):
    plane = fl.FocalPlane.of("sdssv", n=3)
    field, twin = array(plane)
    field.book = ArrayBook(Store.open(tmp_path / "arrays.sqlite"), BUS)
    field.watcher, bus = Counting(), field.source.bus
    receive, asked = bus.receive, []

    async def scenario():
        task = asyncio.ensure_future(field.sweep(POINTS, out=tmp_path))

        async def interrupted(timeout_s):
            before_mm, frames = twin.fibre_xy("metrology"), await receive(timeout_s)
            under_way = np.abs(twin.fibre_xy("metrology") - before_mm).max() > MOVING_MM
            if field.watcher.done == 5 and not asked and under_way:
                asked.append(task.cancel())
            return frames

        bus.receive = interrupted
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(scenario())
    assert asked
    rest_mm = twin.fibre_xy("metrology")
    twin.run(0.1)
    assert np.abs(twin.fibre_xy("metrology") - rest_mm).max() < MOVING_MM
    assert (field.book.state().state, field.book.state().text) == ("stopped", "stopped by the operator")
    with Store.open(tmp_path / "store.sqlite") as store:
        (run,) = store.runs()
        kinds = store.measurements(run.id)["kind"]
    assert run.status == "interrupted"
    assert (sum(kinds == "sweep, alpha up"), sum(kinds == STOPPED)) == (5 * len(plane), len(plane))


def test_no_positioner_that_can_be_swept_is_one_line(tmp_path):
    field, _ = array(fl.FocalPlane.of("sdssv", n=1))
    field.book = ArrayBook(Store.open(tmp_path / "arrays.sqlite"), BUS)
    field.exclude = tuple(field.plane.positioner_id.tolist())
    with pytest.raises(InputError, match=r"no positioner can be swept: positioner .*: excluded"):
        field.run.sweep(POINTS, out=tmp_path)


def test_the_begin_check_allows_a_zero_that_a_linear_ratio_cannot_know():
    """Arms are thicker meanwhile by what is allowed in addition."""
    zero_deg = np.array([0.0, 0.9])  # a datum is where its hard stop is: a degree, until it is calibrated
    true_mm = PLANE.forward(*(PLANE.park_deg + zero_deg).T)
    n = len(PLANE)
    image = Measurement(*true_mm.T, np.ones(n, dtype=bool), 0.0)
    report = Report(PLANE.park_deg, np.ones(n, dtype=bool), image, np.zeros(n, dtype=bool))
    assert not begin_check(PLANE, report).certain.any()
    assert begin_check(PLANE, report, ALLOWED_MM + THICKER_MM).certain.all()
    # but not one that is elsewhere
    far = Report(PLANE.park_deg - [30.0, 0.0], report.answered, image, report.vouched)
    found = begin_check(PLANE, far, ALLOWED_MM + THICKER_MM)
    assert not found.certain.any()
    assert Standing.RIGHT not in found.standing


def test_the_sweep_asks_for_what_its_thick_arms_allow(monkeypatch, tmp_path):
    field, _ = array(fl.FocalPlane.of("sdssv", n=3))
    made = []

    async def connect(motion):
        made.append((motion.state.looser_mm, motion.plane.collision_buffer_mm))
        raise InputError("enough")

    monkeypatch.setattr(FieldMotion, "connect", connect)
    with pytest.raises(InputError, match="enough"):
        field.run.sweep(POINTS, out=tmp_path)
    assert made == [(THICKER_MM, field.plane.collision_buffer_mm + THICKER_MM)]


def test_points_that_were_not_reached_do_not_count(monkeypatch, tmp_path):
    """One beside a fiducial, which has no other direction to turn beta in."""
    monkeypatch.setattr(array_sweep, "ALPHAS_DEG", (180.0,))
    field, _ = array(fl.FocalPlane.of("sdssv", n=7))
    refused = field.run.sweep(POINTS, out=tmp_path).summary()["refused"]
    assert len(refused) == 1
    assert re.fullmatch(r"only \d+ % of the points of a pass of beta usable, 80 % needed", *refused.values())


class Deaf:
    """A recorder that keeps nothing."""

    def event(self, kind, text, positioner_id=None):
        pass


@pytest.mark.parametrize(("looser_mm", "fault"), [(0.0, FibreStatus.ASTRAY), (THICKER_MM, None)])
def test_a_miss_that_a_linear_ratio_cannot_know_is_no_fault_while_arms_are_thicker(looser_mm, fault):
    state = FieldState(PLANE, Deaf())
    state.looser_mm = looser_mm
    state.here_deg = np.tile([100.0, 60.0], (len(PLANE), 1))
    off_mm = np.add(state.metrology_mm(state.here_deg), [0.7, 0.0])
    image = Measurement(*off_mm.T, np.ones(len(PLANE), dtype=bool), 0.0)
    state.judge(Results(), image, PLANE.park_deg, state.here_deg)
    assert set(state.faults) == {fault}
