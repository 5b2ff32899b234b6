"""The facade: one class on the twin and on hardware, whose record outlives an interruption."""

import asyncio
import json
import signal
import subprocess
import sys
import time

import astropy.units as u
import matplotlib as mpl
import numpy as np
import pytest
from astropy.table import QTable, Table

import fiberloom as fl
from fiberloom.metrology import Measurement
from fiberloom.store import Store
from fiberloom.twin import NoiseCamera, Twin, TwinTransport, draw_units

mpl.use("Agg")
N = 7


@pytest.fixture
def plane():
    return fl.FocalPlane.of("sdssv", n=N)


@pytest.fixture
def twin(plane, desk):
    return fl.Field.twin(plane, camera="noise")


def targets():
    return fl.read_targets("targets.csv")


def opened(plane, calibration, **asked):
    """A field that is opened as hardware is, on a transport and a camera that happen to be a twin's."""
    units = draw_units(plane, 0)
    array = Twin(plane, units, seed=0)
    camera = NoiseCamera(array, plane.instrument.metrology.noise_rms_um, 0)
    return fl.Field.open(plane, bus=TwinTransport(array), camera=camera, calibration=calibration, **asked)


def test_the_table_has_units_and_the_columns_of_the_file(twin, desk):
    seen = twin.run.observe(targets(), corrections=1)
    seen.save(desk / "out")
    table, file = seen.table(), Table.read(desk / "out" / "fibres.ecsv")
    assert isinstance(table, QTable)
    assert table.colnames == file.colnames
    units = {"x_target_mm": u.mm, "alpha_deg": u.deg, "error_um": u.um}
    for name, unit in units.items():
        assert table[name].unit == unit
        np.testing.assert_array_equal(table[name].value, file[name])
    miss = np.hypot(table["x_true_mm"] - table["x_target_mm"], table["y_true_mm"] - table["y_target_mm"]).to(
        u.um
    )
    good = np.isfinite(miss)
    np.testing.assert_allclose(miss[good].value, table["error_um"][good].value, atol=1e-6)
    assert table.meta["seed"] == 0
    assert json.loads((desk / "out" / "summary.json").read_text()) == json.loads(json.dumps(seen.summary()))


def test_axes_are_the_callers_where_given(twin):
    from matplotlib.figure import Figure

    seen = twin.run.observe(targets(), corrections=0)
    ax = Figure().subplots()
    assert seen.plot(ax) is ax
    assert seen.plot() is not ax
    assert len(ax.collections) >= 3  # alpha arms, beta arms, fibres


def test_hardware_and_twin_are_one_class_and_see_the_same(plane, twin, desk):
    maps = twin.run.calibrate()
    maps.save(desk / "maps.npz")
    array = opened(plane, desk / "maps.npz")
    assert type(array) is type(twin) is fl.Field
    first, second = twin.run.observe(targets(), 1), array.run.observe(targets(), 1, out="array")
    np.testing.assert_array_equal(first.moves[-1].measurement.xy_mm, second.moves[-1].measurement.xy_mm)
    assert second.true_error_um(second.moves[-1]) is None
    assert np.isnan(second.table()["x_true_mm"]).all()
    # what the camera saw is all there is to judge by; the transport of the caller stays open
    assert second.summary()["moves"][-1]["true_rms_um"] is None
    again = array.run.observe(targets(), 1, out="array")
    assert again.summary()["n_within_requirement"] == N


def test_an_opened_field_without_maps_takes_the_nominal_ratio_and_says_so(plane, desk):
    field, said = opened(plane, None), []
    field.watcher = type("Ear", (), {"say": lambda self, text: said.append(text)})()
    maps = field.run.calibrate()
    assert said == ["no calibration given: the nominal ratio of the gears is used"]
    np.testing.assert_allclose(maps.to_wire(np.full((N, 2), 123.0)), 123.0, atol=1e-12)
    swept = opened(plane, None).run.sweep(12, out="swept")
    assert swept.summary()["calibrated"] == N
    with pytest.raises(fl.InputError, match=r"none.npz: no such file"):
        opened(plane, "none.npz").run.observe(targets())


class Blind:
    """A camera of the wrong kind of room."""

    def measure(self, expected_mm=None):
        n = N
        return Measurement(np.full(n, np.nan), np.full(n, np.nan), np.zeros(n, dtype=bool), 0.0)


def test_addresses_are_checked_when_the_field_is_made(plane):
    for bus in ("can0", "cannet://", "://x"):
        with pytest.raises(fl.InputError, match=r"cannet://HOST:PORT\[,HOST:PORT\.\.\.\]"):
            fl.Field.open(plane, bus=bus, camera=Blind())
    with pytest.raises(fl.InputError, match="alpaca://HOST"):
        fl.Field.open(plane, bus="socketcan://can0", camera="film://host/0")
    assert "on hardware" in repr(fl.Field.open(plane, bus="cannet://a:1,b", camera=Blind()))


@pytest.mark.parametrize(
    ("bus", "what"),
    [
        ("cannet://127.0.0.1:9", "CAN@net gateway 127.0.0.1:9: no connection"),
        ("cannet://127.0.0.1:x", "expected HOST or HOST:PORT"),
        ("nonsense://can0", "cannot open CAN interface 'nonsense', channel 'can0'"),
    ],
)
def test_a_bus_that_is_not_there_is_one_line(plane, twin, desk, bus, what):
    twin.run.calibrate().save(desk / "maps.npz")
    field = fl.Field.open(plane, bus=bus, camera=Blind(), calibration=desk / "maps.npz")
    with pytest.raises(fl.InputError) as caught:
        field.run.observe(targets())
    assert what in str(caught.value)
    assert "\n" not in str(caught.value)


def test_python_and_command_line_say_the_same_of_bad_input(plane, desk):
    def said(*words):
        command = [sys.executable, "-m", "fiberloom.cli", "observe", "targets.csv", "--positioners", "7"]
        return subprocess.run([*command, *words], capture_output=True, text=True).stderr.strip()

    for words, call in (
        (("--faults", "gone=1"), lambda: fl.Field.twin(plane, faults="gone=1")),
        (("--instrument", "hubble"), lambda: fl.FocalPlane.of("hubble")),
        (("--calibration", "no.npz"), lambda: fl.Field.twin(plane, calibration="no.npz").run.calibrate()),
    ):
        with pytest.raises(fl.InputError) as caught:
            call()
        assert said(*words) == f"fiberloom: {caught.value}"


def test_where_a_loop_runs_the_error_says_await(twin):
    async def cell():
        with pytest.raises(fl.InputError, match=r"await field\.observe"):
            twin.run.observe(targets())
        return await twin.observe(targets(), corrections=0)

    assert len(asyncio.run(cell()).moves) == 1


def test_what_is_wrong_with_a_call_is_told_before_anything_moves(twin):
    with pytest.raises(TypeError, match="no option 'colour'"):
        twin.run.observe(targets(), colour="red")
    with pytest.raises(fl.InputError, match="corrections = -1"):
        twin.run.observe(targets(), corrections=-1)
    with pytest.raises(fl.InputError, match="correction 'guess': known are filtered, plain"):
        twin.run.observe(targets(), correction="guess")
    assert twin.last is None


def test_a_field_remembers_where_it_is(twin):
    first = twin.run.observe(targets(), corrections=1)
    second = twin.run.observe(targets(), corrections=1)
    # the arms are at their goals already: hardly anything to go
    assert second.moves[0].motion_s < 0.2 * first.moves[0].motion_s


class StopAfter:
    """A camera that is interrupted as by Ctrl-C in its k-th image."""

    def __init__(self, camera, images):
        self.camera, self.left = camera, images

    def measure(self, expected_mm=None):
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt
        return self.camera.measure(expected_mm)


@pytest.mark.parametrize(
    ("images", "labels"), [(2, ["blind"]), (3, ["blind"]), (4, ["blind", "correction 1"])]
)
def test_an_interruption_loses_nothing(plane, twin, desk, images, labels):
    """Also between the first and the second image of the blind move."""
    twin.run.calibrate().save(desk / "maps.npz")
    field = opened(plane, desk / "maps.npz")
    field.source = type(field.source)(field.source.bus, StopAfter(field.source.camera, images))
    with pytest.raises(KeyboardInterrupt):
        field.run.observe(targets(), corrections=5)
    assert [move.label for move in field.last.moves] == labels
    assert len(field.last.table()) == len(labels) * N
    with Store.open(desk / "runs" / "store.sqlite") as store:
        (run,) = store.runs()
        # before, after the moves, and where each was left
        assert (run.status, run.n_measurements) == ("interrupted", (2 + len(labels)) * N)


SCRIPT = """
import signal
import fiberloom as fl
signal.signal(signal.SIGINT, signal.default_int_handler)  # shells take it from what runs behind them
field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
try:
    field.run.observe(fl.read_targets("targets.csv"), corrections=5000)
except KeyboardInterrupt:
    print(len(field.last.moves), field.last.summary()["n_assigned"])
"""


@pytest.mark.slow
def test_ctrl_c_in_a_script_leaves_what_was_seen(desk):
    process = subprocess.Popen([sys.executable, "-c", SCRIPT], stdout=subprocess.PIPE, text=True)
    file = desk / "runs" / "store.sqlite"
    try:
        end = time.monotonic() + 240.0
        while not file.exists() or measured(file) < 3 * N:
            assert process.poll() is None
            assert time.monotonic() < end
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
    moves, assigned = map(int, said.split())
    assert moves >= 2
    assert assigned == N
    # the start, every move, and where each was left if it was stopped in a motion
    assert measured(file) in ((moves + 1) * N, (moves + 2) * N)


def measured(file):
    with Store.open(file) as store:
        return sum(run.n_measurements for run in store.runs())


# what is shown


def test_no_repr_is_long(twin, plane):
    seen = twin.run.observe(targets(), corrections=0)
    made = fl.plan(plane, plane.park_deg, plane.park_deg)
    things = [plane, plane.instrument, targets(), twin, twin.maps, seen, seen.assignment, made]
    things.append(fl.centroid(np.random.default_rng(0).normal(100.0, 3.0, (64, 64))))
    for thing in things:
        assert 10 < len(repr(thing)) < 120
        assert "\n" not in repr(thing)


def test_notebooks_get_tables(twin, plane):
    seen = twin.run.observe(targets(), corrections=1)
    for thing in (plane, targets(), seen):
        html = thing._repr_html_()
        assert html.count("<tr>") >= 3
        assert len(html) < 4000
    assert "correction 1" in seen._repr_html_()


# centroid


def test_a_file_and_its_array_give_the_same_spots(desk):
    from astropy.io import fits

    y, x = np.mgrid[:80, :100]
    light = 100.0 + 4000.0 * np.exp(-((x - 40.3) ** 2 + (y - 30.7) ** 2) / 5.0)
    pixels = np.random.default_rng(3).poisson(light).astype(np.uint16)
    fits.PrimaryHDU(pixels).writeto("spots.fits")
    arrays = [pixels, pixels.astype(np.int32), pixels.astype(np.float32), np.asfortranarray(pixels)]
    for spots in (fl.centroid("spots.fits"), *(fl.centroid(a) for a in arrays)):
        assert len(spots) == 1
        # 100 000 photons of 1.6 px: 0.005 px
        np.testing.assert_allclose(spots.xy_px, [[40.3, 30.7]], atol=0.02)
    with pytest.raises(fl.InputError, match="dimensions"):
        fl.centroid(np.zeros(9))
    with pytest.raises(fl.InputError, match="no such file"):
        fl.centroid("none.fits")
