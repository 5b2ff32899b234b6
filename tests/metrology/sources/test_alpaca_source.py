"""The client of Alpaca cameras: images, and every way in which a camera does not deliver one."""

import re
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest
from camera_peers import FakeCamera, http, server_that, value

from fiberloom.metrology.images import utc_text
from fiberloom.metrology.sources import imagebytes
from fiberloom.metrology.sources.alpaca import AlpacaSource
from fiberloom.metrology.sources.errors import (
    CameraAborted,
    CameraError,
    CameraRefused,
    CameraSilent,
    ImageBroken,
    ImageStale,
)
from fiberloom.metrology.sources.remote import ExposureSettings

PATIENCE_S = 120.0
"""A deadline for what comes by itself."""
CUT_S = 8.0
"""Far above any deadline here; what is not cut at its deadline goes on for longer, 10 s for a call."""
HALF = http(b"".join(imagebytes.pack(np.ones((4, 6), np.uint16)))[:60], imagebytes.CONTENT_TYPE, length=92)


@contextmanager
def camera_at(fake, deadline_s=PATIENCE_S, retries=0, **settings):
    with server_that(fake) as port:
        told = ExposureSettings(0.0, deadline_s, retries, **settings)
        source = AlpacaSource("127.0.0.1", port, 0, told)
        yield source
        source.close()


def refused(fake, kind, **settings):
    """The text of the error of this kind that the fake brings about, and how long it took."""
    with camera_at(fake, **settings) as source:
        begin_s = time.monotonic()
        with pytest.raises(kind) as caught:
            source.expose()
        assert str(caught.value).startswith(source.name)
        return str(caught.value), time.monotonic() - begin_s


def test_an_image_with_all_that_the_camera_says():
    fake = FakeCamera()
    before_s = time.time()
    with camera_at(fake) as source:
        image = source.expose()
        again = source.expose()
    np.testing.assert_array_equal(image.pixels, np.arange(100, 124).reshape(4, 6))
    assert (again.pixels == image.pixels + 100).all()
    assert (image.pixels.dtype, image.gain_e_adu, image.saturation_adu) == (np.uint16, 1.5, 60000)
    assert before_s - 1e-3 < image.begun_utc_s < again.begun_utc_s + 1e-3 < time.time() + 2e-3
    assert fake.asked.count("connected") == 1  # once is enough
    whole = ["binx", "biny", "startx", "starty", "numx", "numy"]
    assert [m for m in fake.asked if m in whole] == whole


def test_json_where_the_camera_lacks_imagebytes():
    fake = FakeCamera()
    fake.says["imagearray"] = lambda c: c.sendall(value([[1, 2], [3, 4], [5, 70000]]))
    with camera_at(fake) as source:
        np.testing.assert_array_equal(source.expose().pixels, [[1, 3, 5], [2, 4, 70000]])


def test_members_that_a_camera_lacks_are_done_without():
    fake = FakeCamera()
    for member in ("binx", "numx", "sensortype", "maxadu", "electronsperadu", "lastexposurestarttime"):
        fake.says[member] = lambda c: c.sendall(value(None, 0x400, "not here"))
    with camera_at(fake) as source:
        image = source.expose()
    assert image.begun_utc_s is None
    assert (image.gain_e_adu, image.saturation_adu) == (1.0, np.inf)


def test_settings_come_before_the_word_of_the_camera():
    with camera_at(FakeCamera(), gain_e_adu=2.5, saturation_adu=9.0) as source:
        image = source.expose()
    assert (image.gain_e_adu, image.saturation_adu) == (2.5, 9.0)


# silence


@pytest.mark.parametrize("member", ["connected", "startexposure", "imageready", "imagearray"])
def test_a_call_without_an_answer_ends_at_the_deadline(member):
    fake = FakeCamera()
    fake.says[member] = lambda c: None
    text, took_s = refused(fake, CameraSilent, deadline_s=0.4)
    assert "no image after 0.4 s" in text
    assert 0.4 <= took_s < CUT_S  # and a last word to the camera, a second at most


def test_an_image_that_drips_ends_at_the_deadline():
    def drip(connection):
        connection.sendall(http(b"", imagebytes.CONTENT_TYPE, length=400))
        for _ in range(200):
            time.sleep(0.1)
            connection.sendall(b"\0")

    fake = FakeCamera()
    fake.says["imagearray"] = drip
    text, took_s = refused(fake, CameraSilent, deadline_s=0.5)
    assert "reading the image" in text
    assert took_s < CUT_S


def test_an_exposure_that_never_ends():
    fake = FakeCamera()
    fake.values["imageready"] = False
    text, _ = refused(fake, CameraSilent, deadline_s=0.3)
    assert "while exposing" in text
    assert fake.asked[-1] == "abortexposure"


def test_nothing_listens():
    source = AlpacaSource("127.0.0.1", 1, 0, ExposureSettings(retries=0))
    with pytest.raises(CameraSilent, match=r"alpaca://127.0.0.1:1/0: no answer .*is its program running"):
        source.expose()


def test_an_idle_connection_that_was_closed_is_opened_again():
    fake = FakeCamera()
    hangs_up = iter([True, False, False])

    def close_once(connection):
        if next(hangs_up):
            connection.close()
        else:
            connection.sendall(value(True))

    fake.says["imageready"] = close_once
    with camera_at(fake) as source:
        assert source.expose().shape == (4, 6)


# refusals


@pytest.mark.parametrize("member", ["connected", "cameraxsize", "startexposure", "imageready", "imagearray"])
def test_an_error_of_the_camera_is_told_in_its_words(member):
    fake = FakeCamera()
    fake.says[member] = lambda c: c.sendall(value(None, 0x500, "shutter stuck"))
    text, _ = refused(fake, CameraRefused)
    assert f"error 0x500 at {member}: shutter stuck" in text


@pytest.mark.parametrize("member", ["startexposure", "imagearray"])
def test_a_status_of_500(member):
    fake = FakeCamera()
    fake.says[member] = lambda c: c.sendall(http(b"oh dear", "text/plain", "500 Internal Server Error"))
    text, _ = refused(fake, CameraRefused)
    assert "answers 500 Internal Server Error" in text
    assert "oh dear" in text


@pytest.mark.parametrize("nonsense", [b"", b"[]", b"<html>", b"{}", b'{"ErrorNumber": "x"}', b"\xff\xfe"])
def test_answers_that_are_none(nonsense):
    fake = FakeCamera()
    fake.says["startexposure"] = lambda c: c.sendall(http(nonsense))
    assert "not of Alpaca" in refused(fake, CameraRefused)[0]


def test_what_is_no_http_is_named():
    fake = FakeCamera()
    fake.says["connected"] = lambda c: c.sendall(b"SSH-2.0-OpenSSH_9.2\r\n\r\n")
    assert "SSH-2.0" in refused(fake, CameraSilent)[0]


@pytest.mark.parametrize(("member", "said"), [("sensortype", 2), ("cameraxsize", 0), ("cameraysize", "many")])
def test_cameras_that_cannot_be_used(member, said):
    fake = FakeCamera()
    fake.values[member] = said
    refused(fake, CameraRefused)


def test_a_state_of_error_ends_the_waiting():
    fake = FakeCamera()
    fake.values |= {"imageready": False, "camerastate": 5}
    assert "its state is error" in refused(fake, CameraRefused)[0]


# images that are none


def test_half_an_image():
    def half(connection):
        connection.sendall(HALF)
        connection.close()

    fake = FakeCamera()
    fake.says["imagearray"] = half
    assert "60 of 92 bytes came" in refused(fake, ImageBroken)[0]


@pytest.mark.parametrize("said", [None, [], [[]], [1, 2], [[1, 2], [3]], [[["a"]]], [["a"]], "image", 7])
def test_json_that_is_no_image(said):
    fake = FakeCamera()
    fake.says["imagearray"] = lambda c: c.sendall(value(said))
    refused(fake, ImageBroken)


def test_more_bytes_than_the_camera_has_pixels_are_not_read():
    fake = FakeCamera()
    head = http(b"", imagebytes.CONTENT_TYPE, length=1 << 40)
    fake.says["imagearray"] = lambda c: c.sendall(head)
    assert f"{1 << 40} bytes announced" in refused(fake, ImageBroken)[0]


def test_a_body_in_chunks_is_read_to_its_limit():
    def chunks(n):
        piece = b"10000\r\n" + bytes(65536) + b"\r\n"
        kind = f"Content-Type: {imagebytes.CONTENT_TYPE}\r\nTransfer-Encoding: chunked"
        head = f"HTTP/1.1 200 OK\r\n{kind}\r\n\r\n"
        return lambda connection: connection.sendall(head.encode() + n * piece + b"0\r\n\r\n")

    fake = FakeCamera()
    fake.says["imagearray"] = chunks(1)
    assert "no ImageBytes of version 1" in refused(fake, ImageBroken)[0]
    fake.says["imagearray"] = chunks(100)
    assert "more than" in refused(fake, ImageBroken)[0]


def test_another_size_than_the_instrument_has():
    assert "6 x 4 px instead of 6000 x 6132" in refused(FakeCamera(), ImageBroken, size_px=(6000, 6132))[0]


# old images


def test_an_exposure_that_began_before_it_was_asked_for():
    fake = FakeCamera()
    fake.begun = lambda: utc_text(time.time() - 86400.0)
    told = re.search(r"began ([\d.]+) s before it was asked for", refused(fake, ImageStale)[0])
    assert 86300.0 < float(told[1]) <= 86400.0  # some of it went by while the camera was asked
    begun_utc_s = time.time() - 100.0
    fake.begun = lambda: utc_text(begun_utc_s)
    with camera_at(fake, clock_s=1000.0) as source:
        source.expose()  # so much the clocks may differ
    refused(fake, ImageStale, clock_s=99.0)


def test_the_same_image_again_whatever_its_stamp():
    fake = FakeCamera()
    pixels = fake.pixels()
    fake.pixels = lambda: pixels
    with camera_at(fake) as source:
        source.expose()
        with pytest.raises(ImageStale, match="same image again"):
            source.expose()


# retries, giving up


def test_what_fails_is_tried_again_and_told():
    fake = FakeCamera()
    answers = iter([value(None, 0x500, "once"), value(None, 0x500, "twice"), value(None)])
    fake.says["startexposure"] = lambda c: c.sendall(next(answers))
    told = []
    with camera_at(fake, retries=2) as source:
        source.watchers.append(told.append)
        assert source.expose().shape == (4, 6)
    assert [str(e).rsplit(": ", 1)[1] for e in told] == ["once", "twice"]
    assert all(isinstance(e, CameraError) for e in told)


@pytest.mark.parametrize("member", ["startexposure", "imageready", "imagearray"])
def test_abort_from_another_thread_ends_the_exposure_at_once(member):
    fake = FakeCamera()
    fake.says[member] = lambda c: None
    aborted_s = []

    def abort():
        while member not in fake.asked:
            time.sleep(0.01)
        aborted_s.append(time.monotonic())
        source.abort()

    with camera_at(fake, retries=5) as source:
        threading.Thread(target=abort, daemon=True).start()
        with pytest.raises(CameraAborted):
            source.expose()
        assert time.monotonic() - aborted_s[0] < CUT_S
        del fake.says[member]
        assert source.expose().shape == (4, 6)  # the next one is not hurt


def test_abort_without_an_exposure_does_nothing():
    with camera_at(FakeCamera()) as source:
        source.abort()
        assert source.expose().shape == (4, 6)


def test_the_form_of_startexposure():
    bodies = []
    fake = FakeCamera()

    def note(connection, request, body):
        if "startexposure" in request:
            bodies.append(body)
        fake(connection, request, body)

    with server_that(note) as port:
        AlpacaSource("127.0.0.1", port, 0, ExposureSettings(1e-5, 5.0, 0)).expose()
    assert bodies[0].startswith("Duration=1e-05&Light=True&ClientID=")
