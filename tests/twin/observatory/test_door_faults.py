"""Faults of the served camera, switched by hand: what each is to a host, and that it leaves no trace."""

import pytest
from doors import MODEL, PATIENCE_S, SeenTwin, failure
from programs import free_port

from fiberloom.metrology.sources import folder as folder_module
from fiberloom.metrology.sources.alpaca import AlpacaSource
from fiberloom.metrology.sources.errors import CameraRefused, CameraSilent, ImageBroken, ImageStale
from fiberloom.metrology.sources.folder import FolderSource
from fiberloom.metrology.sources.indi import IndiSource
from fiberloom.metrology.sources.remote import ExposureSettings
from fiberloom.twin.camera.imaging import ImagingCamera, StillScene
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.camera.alpaca import AlpacaServer
from fiberloom.twin.server.camera.exposing import TwinShutter
from fiberloom.twin.server.camera.folder import FolderWriter
from fiberloom.twin.server.camera.indi import NAME, IndiServer

SHORT_S = 1.0
"""A deadline for what never comes."""


@pytest.fixture
def twin():
    return SeenTwin()


@pytest.fixture
def shutter(twin):
    return TwinShutter(ImagingCamera(StillScene(twin.lit_mm[:0]), MODEL, seed=3, threads=1), twin, speed=10.0)


@pytest.fixture
def alpaca(shutter):
    server = AlpacaServer(shutter, "127.0.0.1", 0)
    yield AlpacaSource("127.0.0.1", server.port, 0, ExposureSettings(0.1, retries=0))
    server.close()


@pytest.fixture
def folder(shutter, tmp_path, monkeypatch):
    monkeypatch.setattr(folder_module, "SETTLED_S", 0.3)
    writer = FolderWriter(shutter, tmp_path, 5.0)
    told = ExposureSettings(0.1, retries=0)
    source = FolderSource(tmp_path, told, trigger="touch {folder}/expose_{exposure}")
    yield source
    source.close()
    writer.close()


@pytest.fixture
def indi(shutter):
    for package in ("indipyclient", "indipydriver", "indipyserver"):
        pytest.importorskip(package, reason="pip install 'fiberloom[cameras]': INDI")
    address = Address("127.0.0.1", free_port())
    IndiServer(shutter, address)
    source = IndiSource(address.host, address.port, NAME, ExposureSettings(0.1, retries=0))
    yield source
    source.close()


@pytest.mark.parametrize(
    ("door", "fault", "kind", "deadline_s"),
    [
        ("alpaca", "camera_hang", CameraSilent, SHORT_S),
        ("alpaca", "camera_error", CameraRefused, PATIENCE_S),
        ("alpaca", "camera_half", ImageBroken, PATIENCE_S),
        ("alpaca", "camera_stale", ImageStale, PATIENCE_S),
        ("folder", "camera_hang", CameraSilent, SHORT_S),
        ("folder", "camera_error", CameraSilent, SHORT_S),
        ("folder", "camera_half", ImageBroken, PATIENCE_S),
        ("folder", "camera_stale", ImageStale, SHORT_S),
        ("indi", "camera_hang", CameraSilent, SHORT_S),
        ("indi", "camera_error", CameraRefused, PATIENCE_S),
        ("indi", "camera_half", ImageBroken, PATIENCE_S),
        ("indi", "camera_stale", ImageStale, PATIENCE_S),
    ],
)
def test_faults_reach_the_host_as_what_they_are_and_go(request, twin, door, fault, kind, deadline_s):
    source, before = request.getfixturevalue(door), None
    for _ in range(2):  # the first image of a camera, and a later one
        twin.on, source.deadline_s = {fault}, deadline_s
        assert type(failure(source, kind)) is kind
        twin.on, source.deadline_s = set(), PATIENCE_S
        image = source.expose().array()
        assert before is None or (image != before).any()
        before = image
