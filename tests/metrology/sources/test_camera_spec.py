"""Addresses of cameras: what they mean, what is wrong with them, what makes an ImageCamera of them."""

from dataclasses import replace

import pytest

from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.metrology.acquisition import CameraGeometry
from fiberloom.metrology.pipeline import ImageCamera
from fiberloom.metrology.sources import spec as spec_module
from fiberloom.metrology.sources.alpaca import AlpacaSource
from fiberloom.metrology.sources.folder import FolderSource
from fiberloom.metrology.sources.spec import CameraSpec, open_camera, open_source
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.camera.models import image_camera


@pytest.mark.parametrize(
    ("text", "scheme", "place", "name"),
    [
        ("alpaca://10.0.0.5:11112/3?exposure=2.5", "alpaca", "10.0.0.5:11112", "3"),
        ("alpaca://fvc.example", "alpaca", "fvc.example", ""),
        ("folder:/data/fvc", "folder", "/data/fvc", ""),
        ("folder:rel/a%3Fb?trigger=take -t {exposure}", "folder", "rel/a?b", ""),
        ("indi://localhost/CCD%20Simulator", "indi", "localhost", "CCD Simulator"),
        ("aravis:Fake_1?exposure=0.1", "aravis", "Fake_1", ""),
    ],
)
def test_addresses(text, scheme, place, name):
    spec = CameraSpec.parse(text)
    assert (spec.scheme, spec.place, spec.name) == (scheme, place, name)


def test_parameters():
    spec = CameraSpec.parse(
        "folder:/d?exposure=5&deadline=12.5&clock=0.2&retries=4&gain=1.3&saturation=5e4&trigger=a%26b --x=1"
    )
    assert spec.told == {
        "exposure_s": 5.0, "deadline_s": 12.5, "clock_s": 0.2, "retries": 4, "gain_e_adu": 1.3,
        "saturation_adu": 5e4,
    }  # fmt: skip
    assert spec.own == {"trigger": "a&b --x=1"}
    assert CameraSpec.parse("indi://h/N").host == ("h", 7624)
    assert CameraSpec.parse("alpaca://h:99/0").host == ("h", 99)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "write alpaca://HOST:PORT/NUMBER"),
        ("ftp://host/0", "write alpaca://HOST:PORT/NUMBER"),
        ("alpaca:host", "write alpaca://HOST:PORT/"),
        ("alpaca://", "write alpaca://HOST:PORT/NUMBER"),
        ("indi://host", "write indi://HOST:PORT/NAME"),
        ("folder:", "write folder:PATH"),
        ("folder:/d?exposure=long", "exposure=long is no number"),
        ("folder:/d?exposure=-1", "exposure=-1 is no number"),
        ("folder:/d?exposure=nan", "exposure=nan is no number"),
        ("folder:/d?retries=1.5", "retries=1.5 is no count"),
        ("folder:/d?expose=1", "no parameter expose; there are exposure"),
        ("alpaca://h/0?trigger=x", "no parameter trigger"),
    ],
)
def test_what_is_wrong_is_told(text, why):
    with pytest.raises(InputError, match=why):
        CameraSpec.parse(text)


@pytest.mark.parametrize("text", ["alpaca://h:x/0", "alpaca://h:0/0", "alpaca://h:70000/0", "alpaca://:1/0"])
def test_ports_are_numbers(text):
    with pytest.raises(InputError, match="the port is a number"):
        open_source(CameraSpec.parse(text))


def test_the_number_of_an_alpaca_camera():
    with pytest.raises(InputError, match="the camera is a number"):
        open_source(CameraSpec.parse("alpaca://h/main"))


def test_a_missing_package_is_named_with_how_to_install_it(monkeypatch):
    def missing(name):
        raise ImportError(name)

    monkeypatch.setattr(spec_module.importlib, "import_module", missing)
    with pytest.raises(InputError, match=r"INDI needs the package indipyclient.*pip install"):
        open_source(CameraSpec.parse("indi://h/N"))
    with pytest.raises(InputError, match=r"GenICam needs the package gi.*apt-get install"):
        open_source(CameraSpec.parse("aravis:Fake_1"))


@pytest.fixture(scope="module")
def patch():
    return generate(load_instrument("sdssv"), 0, n_positioners=7)


def test_a_camera_has_the_settings_of_the_instrument(patch, tmp_path):
    """The same as those with which the twin's images are read."""
    camera = open_camera(CameraSpec.parse(f"folder:{tmp_path}"), patch)
    assert isinstance(camera, ImageCamera)
    assert isinstance(camera.source, FolderSource)
    twins = image_camera(Twin(patch, draw_units(patch, 0), seed=0), 0)
    assert camera.settings == twins.settings
    assert camera.source.settings.exposure_s == patch.instrument.camera.exposure_s
    assert camera.source.settings.size_px == (6000, 6132)
    camera.close()


def test_the_address_comes_before_the_instrument(patch):
    camera = open_camera(CameraSpec.parse("alpaca://h/2?exposure=0.5&gain=2"), patch)
    assert isinstance(camera.source, AlpacaSource)
    assert (camera.source.settings.exposure_s, camera.source.settings.gain_e_adu) == (0.5, 2.0)
    assert camera.source.deadline_s == pytest.approx(20.5)
    other = open_camera(CameraSpec.parse("alpaca://h"), patch, CameraGeometry(640, 480, 1.0))
    assert other.source.settings.size_px == (640, 480)
    assert other.settings.geometry.scale_mm_px == 1.0


def test_a_plane_without_fiducials_has_no_images(patch):
    with pytest.raises(InputError, match="fiducials"):
        open_camera(CameraSpec.parse("alpaca://h"), replace(patch, fiducials=patch.fiducials[:2]))
