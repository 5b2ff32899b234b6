"""The twin's camera by Alpaca: an unmodified `alpyca` reads it, and the rules of the interface hold."""

import http.client
import json
import socket
import struct
import time
from dataclasses import replace
from urllib.parse import urlencode

import numpy as np
import pytest
from doors import HEIGHT, MODEL, PATIENCE_S, WIDTH, SeenTwin

from fiberloom.metrology.images import utc_s_of
from fiberloom.metrology.sources import imagebytes
from fiberloom.metrology.sources.alpaca import AlpacaSource
from fiberloom.metrology.sources.remote import ExposureSettings
from fiberloom.twin.camera.imaging import ImagingCamera, StillScene
from fiberloom.twin.server.camera.alpaca import AlpacaServer
from fiberloom.twin.server.camera.exposing import TwinShutter


@pytest.fixture
def twin():
    return SeenTwin()


@pytest.fixture
def port(twin):
    camera = ImagingCamera(StillScene(np.zeros((0, 2))), MODEL, seed=3, threads=1)
    server = AlpacaServer(TwinShutter(camera, twin, speed=10.0), "127.0.0.1", 0)
    yield server.port
    server.close()


def expected(twin, exposures=1):
    """The same images without a server."""
    camera = ImagingCamera(StillScene(twin.lit_mm, twin.time_s), MODEL, seed=3)
    return [camera.expose() for _ in range(exposures)][-1]


def call(port, verb, path, body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    headers.setdefault("Content-Type", "application/x-www-form-urlencoded")
    connection.request(verb, path, body if body is None else urlencode(body), headers)
    response = connection.getresponse()
    data = response.read()
    connection.close()
    return response.status, response.headers["Content-Type"], data


def member(port, name, verb="GET", **form):
    status, _, data = call(port, verb, f"/api/v1/camera/0/{name}", form or None)
    return json.loads(data) if status == 200 else status


# alpyca, the client that observatories use


@pytest.fixture
def alpyca(port):
    module = pytest.importorskip("alpaca.camera", reason="pip install alpyca: the independent client")
    camera = module.Camera(f"127.0.0.1:{port}", 0)
    camera.Connected = True
    return camera


def finish(camera):
    end_s = time.monotonic() + PATIENCE_S
    while not camera.ImageReady:
        assert time.monotonic() < end_s, "no image"
        time.sleep(0.01)


def test_alpyca_reads_the_pixels_that_were_painted(alpyca, twin):
    from alpaca.camera import CameraStates, ImageArrayElementTypes, SensorType

    assert alpyca.CameraState == CameraStates.cameraIdle
    alpyca.StartExposure(3000.0, True)  # the next one ends it
    assert not alpyca.ImageReady
    assert alpyca.CameraState == CameraStates.cameraExposing
    begin_s = time.time()
    alpyca.StartExposure(5.0, True)
    started_s = time.time()
    finish(alpyca)
    raw = np.array(alpyca.ImageArrayRaw).reshape(WIDTH, HEIGHT).T
    np.testing.assert_array_equal(raw, expected(twin).pixels)
    np.testing.assert_array_equal(np.array(alpyca.ImageArray).T, raw)
    info = alpyca.ImageArrayInfo
    assert (info.Rank, info.Dimension1, info.Dimension2) == (2, WIDTH, HEIGHT)
    assert info.TransmissionElementType == ImageArrayElementTypes.UInt16
    assert alpyca.LastExposureDuration == 5.0
    assert begin_s - 1e-3 < utc_s_of(alpyca.LastExposureStartTime) < started_s
    assert (alpyca.SensorType, alpyca.ElectronsPerADU) == (SensorType.Monochrome, 1.5)
    assert (alpyca.CameraXSize, alpyca.CameraYSize, alpyca.MaxADU) == (WIDTH, HEIGHT, 40500)


def test_alpyca_is_told_what_cannot_be(alpyca):
    from alpaca import exceptions

    with pytest.raises(exceptions.InvalidOperationException):
        alpyca.LastExposureDuration  # noqa: B018 a property
    with pytest.raises(exceptions.InvalidValueException):
        alpyca.StartExposure(-1.0, True)
    with pytest.raises(exceptions.InvalidValueException):
        alpyca.BinX = 2
    with pytest.raises(exceptions.NotImplementedException):
        alpyca.CCDTemperature  # noqa: B018
    alpyca.NumX = WIDTH  # the whole frame
    alpyca.Connected = False
    with pytest.raises(exceptions.NotConnectedException):
        alpyca.StartExposure(1.0, True)


def test_alpyca_finds_the_camera_in_the_management_pages(port):
    management = pytest.importorskip("alpaca.management", reason="pip install alpyca: the independent client")
    assert management.apiversions(f"127.0.0.1:{port}") == [1]
    (device,) = management.configureddevices(f"127.0.0.1:{port}")
    assert (device["DeviceType"], device["DeviceNumber"]) == ("Camera", 0)
    assert management.description(f"127.0.0.1:{port}")["Manufacturer"] == "fiberloom"


def test_every_property_of_alpyca_has_an_answer(alpyca):
    """A value, or one of the errors of the interface: never a request that the server does not know."""
    from alpaca import exceptions

    known = (
        exceptions.NotImplementedException,
        exceptions.InvalidOperationException,
        exceptions.ValueNotSetException,
    )
    properties = [
        n for n in dir(type(alpyca)) if n[0].isupper() and isinstance(getattr(type(alpyca), n), property)
    ]
    assert len(properties) > 60
    other = {
        "Connecting",
        "DeviceState",
        "ImageArrayInfo",
        "ImageArrayRaw",
    }  # of Platform 7, or of alpyca itself
    lacking = []
    for name in sorted(set(properties) - other):
        try:
            getattr(alpyca, name)
        except known:
            lacking.append(name)
    assert "CCDTemperature" in lacking
    assert not {"CameraState", "ImageReady", "MaxADU", "Name", "SensorName", "NumX"} & set(lacking)


# the rules of the interface


def test_json_and_imagebytes_hold_the_same_pixels(port, twin):
    member(port, "connected", "PUT", Connected="true")
    member(port, "startexposure", "PUT", Duration="0", Light="true")
    while not member(port, "imageready")["Value"]:
        time.sleep(0.01)
    said = member(port, "imagearray")
    assert (said["Type"], said["Rank"]) == (2, 2)
    pixels = np.array(said["Value"]).T
    _, kind, data = call(port, "GET", "/api/v1/camera/0/imagearray", Accept=imagebytes.CONTENT_TYPE)
    assert kind == imagebytes.CONTENT_TYPE
    np.testing.assert_array_equal(imagebytes.unpack(data), pixels)


def test_transactions_are_counted_and_given_back(port):
    said = [
        json.loads(call(port, "GET", f"/api/v1/camera/0/name?{key}=77&ClientID=1")[2])
        for key in ("ClientTransactionID", "clienttransactionid")  # names of a query: in any case
    ]
    assert [s["ClientTransactionID"] for s in said] == [77, 77]
    assert said[1]["ServerTransactionID"] == said[0]["ServerTransactionID"] + 1
    assert (
        json.loads(call(port, "GET", "/api/v1/camera/0/name?ClientTransactionID=-5")[2])["ErrorNumber"] == 0
    )


@pytest.mark.parametrize(
    ("verb", "path", "form"),
    [
        ("GET", "/api/v1/camera/1/name", None),
        ("GET", "/api/v1/telescope/0/name", None),
        ("GET", "/api/v1/camera/0/colour", None),
        ("GET", "/api/v2/camera/0/name", None),
        ("GET", "/", None),
        ("GET", "/management/v9/nothing", None),
        ("PUT", "/api/v1/camera/0/startexposure", {"Light": "true"}),
        ("PUT", "/api/v1/camera/0/startexposure", {"duration": "1", "Light": "true"}),  # forms mind the case
        ("PUT", "/api/v1/camera/0/startexposure", {"Duration": "long", "Light": "true"}),
        ("PUT", "/api/v1/camera/0/startexposure", {"Duration": "nan", "Light": "true"}),
        ("PUT", "/api/v1/camera/0/startexposure", {"Duration": "1", "Light": "some"}),
        ("PUT", "/api/v1/camera/0/connected", {}),
    ],
)
def test_calls_that_are_none_are_bad_requests(port, verb, path, form):
    member(port, "connected", "PUT", Connected="true")
    assert call(port, verb, path, form)[0] == 400


def test_a_body_without_end_is_not_read(port):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    connection.putrequest("PUT", "/api/v1/camera/0/connected")
    connection.putheader("Content-Length", str(1 << 40))
    connection.endheaders()
    assert connection.getresponse().status == 413
    connection.close()


def test_no_image_is_told_as_json(port):
    member(port, "connected", "PUT", Connected="true")
    path = "/api/v1/camera/0/imagearray"
    _, kind, data = call(port, "GET", path, Accept=imagebytes.CONTENT_TYPE)
    assert (kind, json.loads(data)["ErrorNumber"]) == ("application/json", 0x40B)


# our own client


def source(port, exposure_s=0.1):
    return AlpacaSource("127.0.0.1", port, 0, ExposureSettings(exposure_s, PATIENCE_S, retries=0))


def test_our_client_gets_what_the_twin_paints(port, twin):
    image = source(port, exposure_s=5.0).expose()
    wanted = expected(twin)
    np.testing.assert_array_equal(image.pixels, wanted.pixels)
    assert (image.gain_e_adu, image.saturation_adu) == (wanted.gain_e_adu, wanted.saturation_adu)
    assert image.exposure_s == 5.0


def test_clients_that_go_away_are_no_news(port, capfd):
    source(port, exposure_s=1.0).expose()
    asked = b"GET /api/v1/camera/0/imagearray HTTP/1.1\r\nHost: twin\r\n\r\n"
    for _ in range(5):
        with socket.create_connection(("127.0.0.1", port)) as gone:
            gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # resets at its end
            gone.sendall(asked)
            gone.recv(1)  # it is being answered
    assert member(port, "imageready")["Value"]
    assert "Traceback" not in capfd.readouterr().err


def test_a_longer_exposure_is_brighter(port):
    short, long = (source(port, exposure_s=s).expose().pixels.astype(float) for s in (1.0, 4.0))
    bias = MODEL.detector.bias_adu
    assert (long.sum() - bias * long.size) / (short.sum() - bias * short.size) == pytest.approx(4.0, rel=0.02)


def test_the_scene_is_that_of_mid_exposure(port, twin):
    """Half a second of ours on either side, at least."""
    begin_s = time.monotonic()
    source(port, exposure_s=10.0).expose()
    (looked_s,) = twin.looked_s
    assert looked_s - begin_s >= 0.5
    assert time.monotonic() - looked_s >= 0.5


def test_averages_go_as_doubles(twin):
    model = replace(MODEL, average=3)
    camera = ImagingCamera(StillScene(np.zeros((0, 2))), model, seed=3)
    server = AlpacaServer(TwinShutter(camera, twin, speed=10.0), "127.0.0.1", 0)
    image = source(server.port, exposure_s=5.0).expose()
    server.close()
    wanted = ImagingCamera(StillScene(twin.lit_mm), model, seed=3).expose()
    np.testing.assert_array_equal(image.pixels, wanted.pixels)
    assert image.gain_e_adu == wanted.gain_e_adu
