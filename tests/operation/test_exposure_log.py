"""Which exposures of an observation are kept, and as what."""

from types import SimpleNamespace

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.metrology.images import CameraImage, read_image
from fiberloom.operation.exposures import ExposureLog
from fiberloom.report import exposure
from fiberloom.twin.camera.models import image_camera
from fiberloom.twin.draw import draw_units
from fiberloom.twin.twin import Twin


@pytest.fixture
def plotted(monkeypatch):
    names = []
    monkeypatch.setattr(exposure, "plot_reduction", lambda folder, name, plane, r, goal: names.append(name))
    return names


def reduction(level):
    return SimpleNamespace(image=CameraImage(np.full((9, 9), level, np.float32)))


@pytest.mark.parametrize(
    ("pages", "names"),
    [("none", []), ("last", ["exposure-03"]), ("all", ["exposure-01", "exposure-02", "exposure-03"])],
)
def test_pages_are_made_of_those_that_were_asked_for(patch, tmp_path, plotted, pages, names):
    log = ExposureLog(patch, tmp_path, pages, False)
    for level in (1.0, 2.0, 3.0):
        log.seen(reduction(level))
    log.close()
    assert plotted == names
    assert not log.folder.exists()


def test_an_exposure_has_the_number_of_the_move_before_it_and_its_targets(patch, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(exposure, "plot_reduction", lambda *told: drawn.append((told[1], told[4])))
    log = ExposureLog(patch, tmp_path, "all", False)
    goal_mm, move = np.zeros((len(patch), 2)), iter((0, 0, 1, 1, 2))
    now = [0]
    log.follow(lambda: now[0], goal_mm)
    for now[0] in move:
        log.seen(reduction(1.0))
    assert [name for name, _ in drawn] == [
        "exposure-00", "exposure-00-2", "exposure-01", "exposure-01-2", "exposure-02",
    ]  # fmt: skip
    # before the first move nobody is at a target
    assert [goal is goal_mm for _, goal in drawn] == [False, False, True, True, True]


def test_the_last_page_is_of_the_observation_not_of_a_comparison(patch, tmp_path, plotted):
    log = ExposureLog(patch, tmp_path, "last", True)
    move = [1]
    log.follow(lambda: move[0], np.zeros((len(patch), 2)), lambda: move[0] == 3)
    for move[0] in (1, 2, 3):
        log.seen(reduction(1.0))
    log.close()
    assert plotted == ["exposure-02"]
    assert sorted(p.name for p in log.folder.iterdir())[-1] == "exposure-03.fits"


def test_without_an_exposure_there_is_no_last_page(patch, tmp_path, plotted):
    ExposureLog(patch, tmp_path, "last", False).close()
    assert plotted == []


def test_images_are_written_one_by_one(patch, tmp_path):
    first = ExposureLog(patch, tmp_path, "none", True)
    for level in (1.0, 2.0):
        first.seen(reduction(level))
    assert sorted(p.name for p in first.folder.iterdir()) == ["exposure-01.fits", "exposure-02.fits"]
    assert read_image(first.folder / "exposure-02.fits").array()[0, 0] == 2.0


def test_only_a_camera_with_images_can_be_watched(patch, tmp_path):
    words = "--save-images goes with --camera image: this camera takes no images"
    with pytest.raises(InputError, match=words):
        ExposureLog(patch, tmp_path, "none", True).watch(object())
    quiet = ExposureLog(patch, tmp_path, "none", False)
    quiet.watch(object())
    quiet.stop()


def test_a_watched_camera_is_let_go(patch, tmp_path):
    camera = image_camera(Twin(patch, draw_units(patch, 0), seed=0), 0)
    log = ExposureLog(patch, tmp_path, "none", True)
    before = list(camera.watchers)
    log.watch(camera)
    assert len(camera.watchers) == len(before) + 1
    log.stop()
    log.stop()
    assert camera.watchers == before
