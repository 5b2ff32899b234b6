"""When the stamp of an image says that it is old."""

import numpy as np
import pytest

from fiberloom.metrology.images import CameraImage, utc_s_of, utc_text
from fiberloom.metrology.sources.errors import ImageStale
from fiberloom.metrology.sources.fresh import FreshnessCheck

ASKED_UTC_S = 1_795_678_000.0007
PIXELS = np.arange(12.0, dtype=np.float32).reshape(3, 4)


def check(begun_utc_s, clock_s):
    image = CameraImage(PIXELS, begun_utc_s=begun_utc_s)
    FreshnessCheck("alpaca://a", clock_s).check(image, ASKED_UTC_S, ASKED_UTC_S + 1.0)


@pytest.mark.parametrize("after_s", [1e-5, 2e-4, 5e-4])
def test_an_exposure_begun_at_once_is_fresh_although_its_stamp_is_cut_off(after_s):
    stamp_utc_s = utc_s_of(utc_text(ASKED_UTC_S + after_s))
    check(stamp_utc_s, clock_s=0.0)


def test_an_exposure_of_before_is_not():
    with pytest.raises(ImageStale, match="before it was asked for"):
        check(ASKED_UTC_S - 2e-3, clock_s=0.0)
    with pytest.raises(ImageStale, match="before it was asked for"):
        check(ASKED_UTC_S - 0.5, clock_s=0.4)
