"""More than one image of a place: as many as the noise of the camera asks for."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.cli.observe import print_observation
from fiberloom.metrology import Measurement
from fiberloom.metrology.sources.errors import CameraAborted, CameraSilent
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.past.rebuild import observation_of
from fiberloom.operation.results.summary import summarise
from fiberloom.operation.safety.looking import PatientCamera
from fiberloom.store import Store
from fiberloom.targets import random_targets

N = 2000


class Noisy:
    """A camera with this 2-D noise in um; it fails at the images of these numbers."""

    def __init__(self, rms_um, fails=(), error=CameraSilent):
        self.sigma_mm, self.fails, self.error = 1e-3 * rms_um / np.sqrt(2.0), fails, error
        self.taken, self.rng = 0, np.random.default_rng(0)

    def measure(self, expected_mm=None):
        self.taken += 1
        if self.taken in self.fails:
            raise self.error("hangs")
        return Measurement(*self.rng.normal(0.0, self.sigma_mm, (2, N)), np.ones(N, dtype=bool), 0.0)


def eye_of(camera):
    """With what it records."""
    events = []

    async def sleep(s):
        pass

    asked = SimpleNamespace(camera_retries=5, camera_wait_s=1.0, requirement_um=5.0)
    return PatientCamera(camera, asked, lambda *event: events.append(event), sleep), events


def looks(rms_um, most, places=3, **fails):
    """Images of each place, and the last measurement."""
    camera = Noisy(rms_um, **fails)
    eye, events = eye_of(camera)
    counts = []
    for _ in range(places):
        before = camera.taken
        seen = asyncio.run(eye.several(None, most))
        counts.append(camera.taken - before)
    return counts, seen, events


@pytest.mark.parametrize(
    ("rms_um", "most", "counts"),
    [
        (0.5, 8, [2, 1, 1]),  # nothing is known of it before the second image
        (1.9, 8, [4, 4, 4]),
        (1.8, 3, [3, 3, 3]),
        (9.0, 8, [8, 8, 8]),
        (9.0, 1, [1, 1, 1]),
    ],
)
def test_as_many_as_the_noise_asks_for(rms_um, most, counts):
    assert looks(rms_um, most)[0] == counts


def test_one_that_does_not_come_costs_no_command():
    counts, seen, events = looks(1.8, 8, places=1, fails=(3,))
    assert counts == [3]
    assert seen.seen.all()
    assert events == [("alarm", "no image: hangs; goes on with 2 of this place")]


def test_the_first_of_a_place_is_waited_for():
    counts, _, events = looks(0.5, 8, places=1, fails=(1, 2))
    assert counts == [4]
    assert [kind for kind, _ in events] == ["alarm", "alarm", "camera"]


def test_one_that_was_given_up_ends_it():
    with pytest.raises(CameraAborted):
        looks(1.8, 8, places=1, fails=(2,), error=CameraAborted)


def test_all_are_stopped_also_where_the_record_of_what_was_seen_fails():
    stopped = []

    async def look():
        raise CameraAborted("by hand")

    async def stop(why):
        stopped.append(why)

    def book(made, image):
        raise OSError("disk full")

    eye = SimpleNamespace(before_the_end=lambda: "image")
    motion = SimpleNamespace(look=look, stop=stop, eye=eye, _book=book)
    with pytest.raises(OSError, match="disk full"):
        asyncio.run(FieldMotion._look_after(motion, None))
    assert len(stopped) == 1


# on the twin

PLANE = fl.FocalPlane.of("sdssv", n=37)


@pytest.fixture(scope="module")
def maps(tmp_path_factory):
    path = tmp_path_factory.mktemp("maps") / "maps.npz"
    fl.Field.twin(PLANE, 0, camera="noise").run.calibrate(points=60).save(path)
    return path


def errors_um(maps, tmp_path, errors, **how):
    """After two corrections: guided, and as measured."""
    field = fl.Field.twin(PLANE, 0, camera="noise", errors=errors, calibration=maps)
    seen = field.run.observe(random_targets(PLANE, 400, 3), 2, out=tmp_path, **how)
    last = summarise(seen)["moves"][-1]
    return last["guided_rms_um"], last["measured_rms_um"]


def test_several_images_bring_fibres_nearer_in_moving_air(maps, tmp_path):
    one, _ = errors_um(maps, tmp_path, "air=2", images=1)
    several, _ = errors_um(maps, tmp_path, "air=2", images=8)
    print(f"air=2: one image {one:.2f}, up to eight {several:.2f} um guided")
    # corrections average over two places: sqrt(8) is what there is to gain
    assert several < 0.6 * one


def test_how_many_were_taken_is_on_record_and_comes_back_from_it(maps, tmp_path, capsys):
    field = fl.Field.twin(PLANE, 0, camera="noise", errors="air=2", calibration=maps)
    seen = field.run.observe(random_targets(PLANE, 400, 3), 1, out=tmp_path, compare_linear=True)
    taken = [move["images"] for move in seen.summary()["moves"]]
    assert taken == [4, 4, 1]  # nothing is corrected by the last, a comparison
    with Store.open(tmp_path / "store.sqlite") as store:
        (run,) = store.runs()
        again, _ = observation_of(store, run)
    assert [move["images"] for move in again.summary()["moves"]] == taken
    print_observation(seen.summary() | {"folder": "runs/1"})
    assert f"{sum(taken[:2])} images" in capsys.readouterr().out


def test_the_number_must_be_one_or_more(maps, tmp_path):
    with pytest.raises(fl.InputError, match="images = 0: must be 1 or more"):
        errors_um(maps, tmp_path, "none", images=0)
