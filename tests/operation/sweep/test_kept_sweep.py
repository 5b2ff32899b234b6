"""A sweep that was stopped goes on: its maps are those of one made in one go."""

import os
import signal

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.connect import open_hardware
from fiberloom.errors import InputError
from fiberloom.operation.sweep.kept import KEPT, KeptPass, KeptSweep
from fiberloom.operation.sweep.ways import ClearWays, SweepPass
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.twin import NoiseCamera, Twin, draw_units
from fiberloom.twin.transport import TwinTransport

BUS = "cannet://10.1.10.31:19228"
POINTS = 10
PLANE = fl.FocalPlane.of("sdssv", n=3)
TURNED = ("sweep, alpha up", "sweep, alpha down", "sweep, beta up", "sweep, beta down")


class Stopping:
    """A watcher that asks for an end after so many points."""

    def __init__(self, after=None):
        self.after, self.said, self.counts = after, [], []

    def say(self, text):
        self.said.append(text)

    def count(self, done, total):
        self.counts.append(done)
        if done == self.after:
            os.kill(os.getpid(), signal.SIGTERM)


def array(tmp_path, plane=PLANE, twin=None):
    """An opened field of a twin that stays as it is from one command to the next."""
    twin = twin or Twin(plane, draw_units(plane, 0), seed=0)
    field = fl.Field.open(plane, TwinTransport(twin), NoiseCamera(twin, 0.669, 1))
    field.book = ArrayBook(Store.open(tmp_path / "arrays.sqlite"), BUS)
    return field, twin


def swept(field, folder, after=None, points=POINTS):
    field.watcher = Stopping(after)
    return field.run.sweep(points, out=folder)


@pytest.fixture(scope="module")
def in_one_go(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    field, _ = array(folder)
    return swept(field, folder).maps


# in the way up of alpha, at its top end, in its way down, before and in the passes of beta
@pytest.mark.parametrize("stops", [[3], [POINTS, 14], [2 * POINTS, 2 * POINTS + 4, 3 * POINTS + 5]])
def test_a_sweep_that_was_stopped_goes_on_and_no_point_is_measured_twice(tmp_path, in_one_go, stops):
    field, twin = array(tmp_path)
    for after in stops:
        with pytest.raises(KeyboardInterrupt):
            swept(field, tmp_path / "cal", after)
        assert field.book.state().state == "stopped"
        field, _ = array(tmp_path, twin=twin)
    found = swept(field, tmp_path / "cal")
    assert f"{stops[-1]} points were measured before: the sweep goes on" in field.watcher.said
    assert twin.touches() == []
    assert not (tmp_path / "cal" / KEPT).exists()
    with Store.open(tmp_path / "cal" / "store.sqlite") as store:
        kinds = [kind for run in store.runs() for kind in store.moves(run.id)["kind"].tolist()]
    assert sorted(kind for kind in kinds if kind in TURNED) == sorted(TURNED * POINTS)
    # to within the noise of the images: 0.47 um a coordinate over 14 mm and more, a knot of two images
    np.testing.assert_allclose(found.maps.output_deg, in_one_go.output_deg, atol=0.02)
    assert np.sqrt(((found.maps.output_deg - in_one_go.output_deg) ** 2).mean()) < 0.006


def test_another_array_another_camera_or_other_points_are_refused_and_nothing_moves(tmp_path):
    field, twin = array(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        swept(field, tmp_path / "cal", 3)
    before_deg = twin.truth()
    with pytest.raises(InputError, match="with another number of points: 10, now 12; choose another --out"):
        swept(field, tmp_path / "cal", points=12)
    other, _ = array(tmp_path, fl.FocalPlane.of("sdssv", n=3, seed=1), twin)
    with pytest.raises(InputError, match="with another layout"):
        swept(other, tmp_path / "cal")
    field.source = type(field.source)(field.source.bus, field.source.camera, "alpaca://10.1.10.40:11111/0")
    with pytest.raises(InputError, match=r"another camera: NoiseCamera, now alpaca://.*/0;"):
        swept(field, tmp_path / "cal")
    np.testing.assert_array_equal(twin.truth(), before_deg)


def test_bus_and_camera_are_named_by_their_addresses():
    source = open_hardware(PLANE, "cannet://10.1.10.31,10.1.10.32", "alpaca://10.1.10.40:11111/0?exposure=2")
    assert source.named() == {
        "bus": "cannet:10.1.10.31,10.1.10.32",
        "camera": "alpaca://10.1.10.40:11111/0?exposure=2",
    }


def partial(takes=(True, True), low_deg=(20.0, 35.0), done=3):
    swept = SweepPass(1, np.linspace(20.0, 160.0, 5), 180.0, 4.0)
    begun = KeptPass.begun(swept, ClearWays(np.array(takes), np.array(low_deg), {1: "no room"}))
    begun.xy_mm[1, :done] = 7.0
    begun.done = done
    return begun


def test_what_is_kept_is_read_as_it_was(tmp_path):
    about = {"camera": "alpaca://10.1.10.40:11111/0"}
    kept = KeptSweep(tmp_path / KEPT, about, [partial(done=10), partial()])
    kept.save()
    again = KeptSweep.open(tmp_path, about)
    assert (again.done, [p.done for p in again.passes], again.at(2)) == (13, [10, 3], None)
    assert (again.at(0).complete, again.at(1).complete) == (True, False)
    first, second = kept.passes[1], again.passes[1]
    assert second.fits(first.swept, first.ways)
    assert second.ways.why == {1: "no room"}
    np.testing.assert_array_equal(first.xy_mm, second.xy_mm)


@pytest.mark.parametrize("text", [b"", b"no archive", b"PK\x03\x04 and nothing behind"])
def test_a_file_that_is_damaged_is_one_line_that_names_it(tmp_path, text):
    (tmp_path / KEPT).write_bytes(text)
    with pytest.raises(InputError, match=rf"{KEPT}: no partial sweep can be read .* remove that file"):
        KeptSweep.open(tmp_path, {})


def test_it_goes_on_only_with_the_same_positioners_at_the_same_places():
    known = partial()
    assert known.fits(known.swept, known.ways)
    for other in (partial(takes=(True, False)), partial(low_deg=(20.0, 50.0))):
        assert not known.fits(other.swept, other.ways)


def test_it_goes_on_from_the_side_on_which_the_point_is_approached():
    """Upward from below and downward from above, by the run-up: the backlash is closed as it was."""
    points_deg = np.linspace(20.0, 160.0, 5)
    for done, want_deg in ((0, points_deg[0] - 4.0), (3, points_deg[3] - 4.0), (5, points_deg[4] + 4.0)):
        place_deg = partial(low_deg=(-10.0, 90.0), done=done).begin_deg()
        np.testing.assert_allclose(place_deg[0], [180.0, want_deg])
        np.testing.assert_allclose(place_deg[1], [180.0, max(want_deg, 90.0)])
