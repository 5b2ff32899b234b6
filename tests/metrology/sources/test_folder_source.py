"""A camera that writes files: whole ones that are new are taken, and nothing else."""

import shlex
import sys
import threading
import time

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.metrology.images import CameraImage, write_image
from fiberloom.metrology.sources import folder as folder_module
from fiberloom.metrology.sources.errors import (
    CameraAborted,
    CameraRefused,
    CameraSilent,
    ImageBroken,
    ImageStale,
)
from fiberloom.metrology.sources.folder import FolderSource
from fiberloom.metrology.sources.remote import ExposureSettings

PATIENCE_S, SHORT_S = 120.0, 5.0
"""Deadlines for an image that comes, and for one that never does; it is looked at ten times a second."""
CLOCK_S, LONG_AGO_S = 100.0, 3000.0
"""What clocks may differ by; what is not tolerated."""


def pixels(seed=0):
    return np.random.default_rng(seed).integers(0, 60000, (40, 60)).astype(np.uint16)


def image(seed=0, begun_utc_s=None, exposure_s=0.0):
    return CameraImage(
        pixels(seed), gain_e_adu=2.0, saturation_adu=50000.0, exposure_s=exposure_s, begun_utc_s=begun_utc_s
    )


@pytest.fixture
def source(tmp_path):
    made = []

    def make(deadline_s=PATIENCE_S, retries=0, **more):
        made.append(FolderSource(tmp_path, ExposureSettings(0.0, deadline_s, retries, CLOCK_S), **more))
        return made[-1]

    yield make
    for each in made:
        each.close()


@pytest.fixture(params=["events", "polling"])
def either(request, monkeypatch, asked):
    """With `watchdog`, and without."""
    if request.param == "polling":
        monkeypatch.setattr(FolderSource, "_observe", lambda self: ASKED.set())
    else:
        pytest.importorskip("watchdog", reason="pip install watchdog: events of folders")


ASKED = threading.Event()
"""An image has been asked for: what is in the folder has been noted."""


@pytest.fixture(autouse=True)
def asked(monkeypatch):
    observe = FolderSource._observe

    def noted(self):
        observe(self)
        ASKED.set()

    monkeypatch.setattr(FolderSource, "_observe", noted)


def after(delay_s, function, *args):
    """Calls it so long after the next image is asked for."""
    ASKED.clear()

    def call():
        ASKED.wait(30.0)
        time.sleep(delay_s)
        function(*args)

    threading.Thread(target=call, daemon=True).start()


def renamed(path, made):
    """Written now, under a hidden name; what comes back renames it."""
    hidden = path.with_name(f".{path.name}.hidden")
    write_image(made, hidden)
    return lambda: hidden.rename(path)


def test_a_file_that_is_renamed_into_place(source, tmp_path, either):
    write_image(image(1), tmp_path / "old.fits")
    begun = time.time()
    after(0.1, renamed(tmp_path / "new.fits", image(2, begun)))
    got = source().expose()
    np.testing.assert_array_equal(got.array(), pixels(2))
    assert got.path.name == "new.fits"
    assert (got.gain_e_adu, got.saturation_adu) == (2.0, 50000.0)
    assert got.begun_utc_s == pytest.approx(begun, abs=2e-3)


def test_a_file_that_is_written_in_place_byte_by_byte(source, tmp_path, either):
    write_image(image(3), tmp_path / ".whole")
    data = (tmp_path / ".whole").read_bytes()

    def drip():
        with (tmp_path / "a.fits").open("wb", buffering=0) as file:
            for at in range(0, len(data), 900):
                file.write(data[at : at + 900])
                time.sleep(0.05)

    after(0.0, drip)
    np.testing.assert_array_equal(source().expose().array(), pixels(3))


def test_one_name_that_is_written_anew_each_time(source, tmp_path):
    camera = source()
    for seed in (4, 5):
        after(0.1, renamed(tmp_path / "latest.fits", image(seed)))
        np.testing.assert_array_equal(camera.expose().array(), pixels(seed))


def test_an_image_outlives_its_file(source, tmp_path):
    after(0.1, renamed(tmp_path / "a.fits", image(6)))
    got = source().expose()
    (tmp_path / "a.fits").write_bytes(b"")  # a mapped file would end the process here
    np.testing.assert_array_equal(got.array(), pixels(6))


def test_what_is_no_image_by_its_name_is_left_alone(source, tmp_path):
    for name in (".a.fits", "a.fits.part", "log.txt"):
        after(0.1, renamed(tmp_path / name, image(7)))
    with pytest.raises(CameraSilent, match="waiting for a file"):
        source(deadline_s=1.5).expose()


@pytest.mark.parametrize("data", [b"", b"\0" * 4000, b"<html>not found</html>"])
def test_a_file_that_is_no_fits(source, tmp_path, data, monkeypatch):
    monkeypatch.setattr(folder_module, "SETTLED_S", 0.3)
    after(0.1, (tmp_path / "a.fits").write_bytes, data)
    with pytest.raises(ImageBroken, match=r"a\.fits: .*no whole image"):  # not: at the deadline
        source().expose()


def test_half_a_file(source, tmp_path, monkeypatch):
    monkeypatch.setattr(folder_module, "SETTLED_S", 0.3)
    write_image(image(8), tmp_path / ".whole")
    data = (tmp_path / ".whole").read_bytes()
    after(0.1, (tmp_path / "a.fits").write_bytes, data[: len(data) // 2])
    with pytest.raises(ImageBroken, match=r"a\.fits: \d+ of \d+ bytes"):
        source().expose()


def test_half_a_file_at_the_deadline(source, tmp_path, monkeypatch):
    monkeypatch.setattr(folder_module, "SETTLED_S", PATIENCE_S)
    write_image(image(8), tmp_path / ".whole")
    after(0.1, (tmp_path / "a.fits").write_bytes, (tmp_path / ".whole").read_bytes()[:4000])
    with pytest.raises(ImageBroken, match=r"no image after 5 s.* of 8640 bytes"):
        source(deadline_s=SHORT_S).expose()


def test_an_exposure_of_before_is_passed_over(source, tmp_path):
    """A camera that runs free: what arrives first may have begun before the request."""
    now = time.time()
    after(0.1, renamed(tmp_path / "a.fits", image(9, now - LONG_AGO_S)))
    after(0.8, renamed(tmp_path / "b.fits", image(10, now + 0.1)))
    np.testing.assert_array_equal(source().expose().array(), pixels(10))


def test_yesterdays_image_alone(source, tmp_path):
    after(0.1, renamed(tmp_path / "a.fits", image(9, time.time() - 86400.0)))
    with pytest.raises(ImageStale, match=r"a\.fits was exposed before it was asked for"):
        source(deadline_s=SHORT_S).expose()


def test_without_a_stamp_the_time_of_the_file_counts(source, tmp_path):
    after(0.1, renamed(tmp_path / "a.fits", image(11, exposure_s=LONG_AGO_S)))
    with pytest.raises(ImageStale):
        source(deadline_s=SHORT_S).expose()


def test_the_same_pixels_in_a_new_file(source, tmp_path):
    camera = source()
    after(0.1, renamed(tmp_path / "a.fits", image(12, time.time())))
    camera.expose()
    after(0.1, renamed(tmp_path / "b.fits", image(12, time.time() + 0.1)))
    with pytest.raises(ImageStale, match="same image again"):
        camera.expose()


def test_abort(source):
    camera = source()
    after(0.2, camera.abort)
    with pytest.raises(CameraAborted):
        camera.expose()


# the trigger


def python(code):
    return shlex.join([sys.executable, "-c", code])


def test_the_trigger_makes_the_image(source, tmp_path):
    write_image(image(13), tmp_path / ".ready")
    code = f"import os; os.rename({str(tmp_path / '.ready')!r}, '{{folder}}/exposed_{{exposure}}.fits')"
    got = source(trigger=python(code)).expose()
    assert got.path.name == "exposed_0.fits"


def test_a_trigger_that_fails_is_told_in_its_words(source):
    camera = source(trigger=python("import sys; sys.exit('shutter stuck')"))
    with pytest.raises(CameraRefused, match="ended with 1: shutter stuck"):
        camera.expose()


def test_a_trigger_that_hangs_is_ended(source, tmp_path):
    camera = source(deadline_s=0.5, trigger="sleep 60")
    begin_s = time.monotonic()
    with pytest.raises(CameraSilent):
        camera.expose()
    assert time.monotonic() - begin_s < 30.0


def test_no_shell_reads_the_trigger(source, tmp_path):
    with pytest.raises(CameraSilent):
        source(deadline_s=0.5, trigger=f"echo x; touch {tmp_path}/shell").expose()
    assert not (tmp_path / "shell").exists()


def test_a_trigger_that_is_not_there(source):
    with pytest.raises(CameraRefused, match="trigger no-such-program"):
        source(trigger="no-such-program").expose()


def test_what_is_wrong_with_the_address_is_told_at_once(source, tmp_path):
    with pytest.raises(InputError, match="No closing quotation"):
        source(trigger="'")
    with pytest.raises(InputError, match="no such folder"):
        FolderSource(tmp_path / "none", ExposureSettings())


def test_a_folder_that_has_gone(source, tmp_path):
    camera = source()
    after(0.2, tmp_path.rmdir)
    with pytest.raises(CameraRefused, match="is the disk there"):
        camera.expose()
    tmp_path.mkdir()
