"""The last image outlives the service: the same cut-outs, centroids and goals, of the same layout only."""

import numpy as np
import pytest
from served import asking, idle, served

from fiberloom.metrology.transform import FieldTransform, Similarity
from fiberloom.service.cutout import cutout_png
from fiberloom.service.last_image import FILE, KeptImage, LastImage
from fiberloom.service.stamps import Stamps

N, TERMS = 7, (0, 1, 2, 27, 5)


@pytest.fixture
def image():
    rng = np.random.default_rng(0)
    square = np.eye(len(TERMS))
    bent = 1e-3 * rng.standard_normal(len(TERMS))
    turned = Similarity(0.1 * np.exp(0.3j), 2.0 - 1.0j, True)
    fit = FieldTransform(turned, 300.0, TERMS, bent, 1e-6 * square, 1e-7 * square)
    spot_px = rng.uniform(20.0, 80.0, (N, 2))
    spot_px[3] = np.nan
    pixels = rng.integers(0, 60000, (N, 33, 33)).astype(np.uint16)
    goal_mm = fit.to_mm(np.floor(spot_px) + 1.25)
    return KeptImage(Stamps(pixels, np.floor(spot_px) - 16.0, spot_px, fit, 3.0), goal_mm, 1.8e9)


def test_what_is_shown_is_the_same_after_it_was_kept(image, tmp_path):
    kept = LastImage(tmp_path, "layout")
    assert kept.read() is None
    kept.later(image)
    kept.close()
    again = LastImage(tmp_path, "layout").read()
    assert again.utc == image.utc
    for row in range(N):
        shown, was = ((one.stamps, row, one.goal_mm[row]) for one in (again, image))
        assert cutout_png(*shown) == cutout_png(*was)
    for row in (0, 5):  # a ring one and a quarter pixels from the corner of the middle pixel
        assert again.stamps.within(row, again.goal_mm[row]) == pytest.approx((17.25, 17.25), abs=1e-5)
    assert LastImage(tmp_path, "another layout").read() is None


@pytest.mark.parametrize("cut", [0, 100, 2000])
def test_a_file_that_is_damaged_is_no_image(image, tmp_path, cut, caplog):
    kept = LastImage(tmp_path, "layout")
    kept.later(image)
    kept.close()
    (tmp_path / FILE).write_bytes((tmp_path / FILE).read_bytes()[:cut])
    assert kept.read() is None
    assert "cannot be read" in caplog.text


def test_a_service_that_begins_anew_shows_it(image, tmp_path):
    with served(tmp_path) as array:
        idle(array)
        number = int(array.field.plane.positioner_id[2])
        with asking(array, tmp_path) as client:
            assert client.get(f"/api/v1/positioners/{number}").json()["image"] is None
            assert client.get(f"/api/v1/positioners/{number}/image").status_code == 400
        array.live.keep(image)
    with served(tmp_path) as array, asking(array, tmp_path) as client:
        assert client.get(f"/api/v1/positioners/{number}").json()["image"] == "2027-01-15T08:00:00+00:00"
        shown = client.get(f"/api/v1/positioners/{number}/image")
        assert shown.content == cutout_png(image.stamps, 2, image.goal_mm[2])
