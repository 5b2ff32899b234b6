"""Cameras of the twin: those of instruments, from their TOML, and the two of the paper's bench.

What the host knows of a camera is the instrument's `[camera]`; what only the twin knows (light,
optics, detector, air) is `[twin.camera]`:

    [twin.camera]
    average = 1                                     # exposures in one image
    optics = { turbulence_um = 5.0 }                # fields of `imaging.Optics`
    optics.distortion_mm = { 9 = 0.64, 20 = 0.028 } # Zhao-Burge terms
    psf = { kind = "moffat", fwhm_px = 3.5 }        # of `imaging.Psf`
    detector = { read_noise_e = 10.0 }              # of `imaging.Detector`
    light = { fibre_e = 250000.0 }                  # of `imaging.Light`
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane, Instrument, instrument_names, load_instrument
from fiberloom.metrology import zhao_burge
from fiberloom.metrology.acquisition import CameraGeometry
from fiberloom.metrology.cameras import (
    BENCHES,
    camera_of,
    check_fiducials,
    geometry_of,
    image_camera_of,
    view_of,
)
from fiberloom.metrology.pipeline import ImageCamera
from fiberloom.twin.camera.imaging import (
    CameraModel,
    Detector,
    ImagingCamera,
    Light,
    Optics,
    Psf,
    Scene,
    TwinScene,
)
from fiberloom.twin.errors.sizes import AIR_LENGTH_MM, NO_ERRORS, TwinErrors

FIBRE_DIAMETER_UM = 120.0
"""Core of the back-lit fibre of the bench (SDSS-V)."""
WORKSPACE_E = 6250.0
CLOSE_UP_E = 19600.0


def workspace() -> CameraModel:
    """Kronig 2020, Fig. 18 right: the whole workspace in view, one image; 669 nm rms.

    22.5 um/px puts 46 mm on 2048 px; the tip of the fibre is five pixels wide. The flux, 6 250
    electrons, is the one free number, TUNED: photons and pixels do the rest.
    """
    optics = Optics(BENCHES["workspace"], 23.0)
    psf = Psf("disc", FIBRE_DIAMETER_UM / 22.5, edge=0.25)
    light = Light(fibre_e=WORKSPACE_E, scatter=0.0, background_e=5.0)
    return CameraModel(optics, psf, Detector(1.0, 3.0, 100.0), light, exposure_s=0.1)


def close_up() -> CameraModel:
    """Kronig 2020, Fig. 18 left: a small part of the workspace, ten images averaged; 101 nm rms.

    Again the flux of one image is the one free number.
    """
    optics = Optics(BENCHES["close-up"], 4.0)
    psf = Psf("disc", FIBRE_DIAMETER_UM / 8.0, edge=0.15)
    light = Light(fibre_e=CLOSE_UP_E, scatter=0.0, background_e=5.0)
    return CameraModel(optics, psf, Detector(1.0, 3.0, 100.0), light, exposure_s=0.1, average=10)


_BENCHES: dict[str, Callable[[], CameraModel]] = {"workspace": workspace, "close-up": close_up}


def camera_model(name: str) -> CameraModel:
    """Of a bench (workspace, close-up), or of a preset instrument that has a camera."""
    if name in _BENCHES:
        return _BENCHES[name]()
    seeing = [n for n in instrument_names() if load_instrument(n).camera is not None]
    if name not in seeing:
        raise InputError(f"camera '{name}': known are {', '.join([*_BENCHES, *seeing])}")
    return model_of(load_instrument(name))


def model_of(instrument: Instrument) -> CameraModel:
    """The true camera of an instrument that has a `[camera]`."""
    camera, geometry = camera_of(instrument), geometry_of(instrument)
    asked = dict(instrument.twin.get("camera", {}))
    where = f"{instrument.name}: twin.camera"
    optics = _optics(dict(asked.pop("optics", {})), geometry, camera.field_radius_mm, where)
    parts = {key: _filled(kind, asked.pop(key, {}), f"{where}.{key}") for key, kind in _PARTS.items()}
    average = asked.pop("average", 1)
    if asked:
        known = ", ".join(["average", "optics", *_PARTS])
        raise InputError(f"{where}.{next(iter(asked))}: no such key; known are {known}")
    return CameraModel(optics, **parts, exposure_s=camera.exposure_s, average=average)


_PARTS: dict[str, type] = {"psf": Psf, "detector": Detector, "light": Light}


def _optics(asked: dict[str, Any], geometry: CameraGeometry, radius_mm: float, where: str) -> Optics:
    for name in ("geometry", "field_radius_mm"):
        if name in asked:
            raise InputError(f"{where}.optics.{name}: belongs into [camera]")
    terms = asked.pop("distortion_mm", {})
    for key in terms:
        if not str(key).isdecimal() or int(key) >= zhao_burge.N_TERMS:
            raise InputError(
                f"{where}.optics.distortion_mm.{key}: terms are numbered 0 to {zhao_burge.N_TERMS - 1}"
            )
    distortion_mm = {int(k): float(v) for k, v in terms.items()}
    fixed = {"geometry": geometry, "field_radius_mm": radius_mm, "distortion_mm": distortion_mm}
    optics: Optics = _filled(Optics, asked, f"{where}.optics", fixed)
    return optics


def _filled(kind: type, asked: Mapping[str, Any], where: str, fixed: Mapping[str, Any] | None = None) -> Any:
    """A dataclass from a table of the file: numbers and names of its fields only."""
    usual = {f.name: f.default for f in dataclasses.fields(kind) if f.default is not dataclasses.MISSING}
    for key, value in asked.items():
        if key not in usual:
            raise InputError(f"{where}.{key}: no such key; known are {', '.join(usual)}")
        want_text = isinstance(usual[key], str)
        if isinstance(value, str) != want_text or isinstance(value, bool):
            raise InputError(f"{where}.{key} = {value!r}: must be a {'name' if want_text else 'number'}")
    return kind(**(fixed or {}), **asked)


def model_for(plane: FocalPlane) -> CameraModel:
    """The camera of a focal plane: its instrument's, or one that just sees all of it.

    The latter spreads the field over 4096 px and has a little third-order distortion (assumed).
    """
    if plane.instrument.camera is not None:
        return model_of(plane.instrument)
    geometry, radius_mm = view_of(plane)
    return CameraModel(Optics(geometry, radius_mm, {9: 2e-3 * radius_mm}))


def misaligned(model: CameraModel, seed: int) -> CameraModel:
    """The camera as it hangs there: turned by 0.3 deg, off by 1 mm and by 1e-3 in scale (sd)."""
    rng = np.random.default_rng([seed, 0x0FF5])
    g = model.optics.geometry
    x, y = g.middle_px
    shift = rng.normal(0.0, 1.0 / g.scale_mm_px, 2)
    off = replace(
        g,
        rotation_deg=g.rotation_deg + rng.normal(0.0, 0.3),
        scale_mm_px=g.scale_mm_px * (1 + rng.normal(0.0, 1e-3)),
        centre_px=(x + shift[0], y + shift[1]),
    )
    return replace(model, optics=replace(model.optics, geometry=off))


def image_camera(
    twin: Any, seed: int, model: CameraModel | None = None, errors: TwinErrors = NO_ERRORS
) -> ImageCamera:
    """A camera with images on a `twin`; the host knows its geometry but not how it is misaligned.

    `seed`: of the misalignment and all noise; `model`: by default that of the twin's plane; `errors`: of the
    fiducials' table, the air and the lens, um rms.
    """
    plane = twin.plane
    check_fiducials(plane)
    nominal = model or model_for(plane)
    source = imaging_camera(TwinScene(twin), plane, seed, nominal, errors=errors)
    return image_camera_of(source, plane, nominal.optics.geometry, nominal.optics.field_radius_mm)


def imaging_camera(
    scene: Scene,
    plane: FocalPlane,
    seed: int,
    nominal: CameraModel,
    *,
    threads: int | None = None,
    errors: TwinErrors = NO_ERRORS,
) -> ImagingCamera:
    """The true camera that looks at a scene of `plane`: `nominal`, but misaligned by the `seed`.

    `scene`: the fibres; `threads` that paint, all cores when None; `errors`: as of `image_camera`.
    """
    return ImagingCamera(
        scene, misaligned(_at_night(_in_air(nominal, errors), errors, seed), seed),
        fiducials_mm=errors.fiducials_mm(plane, seed), seed=seed, instrument=plane.instrument.name,
        threads=threads,
    )  # fmt: skip


def _in_air(model: CameraModel, errors: TwinErrors) -> CameraModel:
    """With the air of `errors`, unless the instrument says its own."""
    if model.optics.turbulence_um > 0.0:
        return model
    air = replace(model.optics, turbulence_um=errors.air_um, turbulence_length_mm=AIR_LENGTH_MM)
    return replace(model, optics=air)


def _at_night(model: CameraModel, errors: TwinErrors, seed: int) -> CameraModel:
    """At the temperature of the night: more of the plate on a pixel, and a lens that has changed a little."""
    night = errors.temperature
    warmer_K = night.warmer_K(seed)
    if warmer_K == 0.0:
        return model
    optics = model.optics
    # the frame is the plate's: where it has grown, a pixel sees less of it
    scale = optics.geometry.scale_mm_px / (1.0 + night.plate_growth(seed))
    geometry = replace(optics.geometry, scale_mm_px=scale)
    drift_um = float(np.hypot(optics.drift_um, night.lens_um_per_K * warmer_K))
    return replace(model, optics=replace(optics, geometry=geometry, drift_um=drift_um, drift_seed=seed))
