"""The frame that wrong fiducials give a camera is the same in every image, however the camera is turned."""

from dataclasses import replace

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.metrology.acquisition import acquire
from fiberloom.metrology.cameras import image_camera_of, reduction_settings
from fiberloom.metrology.transform import PlaceErrors
from fiberloom.metrology.zhao_burge import DEFAULT_TERMS
from fiberloom.twin.camera.imaging import StillScene
from fiberloom.twin.camera.models import imaging_camera, misaligned, model_for
from fiberloom.twin.errors.sizes import TwinErrors

PLANE = fl.FocalPlane.of("sdssv")
MODEL = model_for(PLANE)
FIBRES_MM = PLANE.forward(40.0, 90.0)
NOISE_PX = 0.002


def guided_um(off_um):
    """Less shift, rotation and scale."""
    x, y = FIBRES_MM.T / 300.0
    one, none = np.ones(len(x)), np.zeros(len(x))
    patterns = np.stack(
        [np.column_stack(p) for p in ((one, none), (none, one), (x, y), (-y, x))], axis=-1
    ).reshape(-1, 4)
    size = np.linalg.lstsq(patterns, off_um.ravel(), rcond=None)[0]
    return off_um - (patterns @ size).reshape(-1, 2)


def frame_um(fiducials_mm, turned_deg, seed=0, terms="all"):
    """(N, 2) um by which fibres are seen beside where they are, spots taken as found."""
    rng = np.random.default_rng(seed)
    optics = misaligned(MODEL, 0).optics
    optics = replace(optics, turned_deg=turned_deg)
    spots = optics.to_px(np.vstack([fiducials_mm, FIBRES_MM]))
    spots += rng.normal(0.0, NOISE_PX, spots.shape)
    settings = reduction_settings(PLANE.instrument.camera, MODEL.optics.geometry)
    search = settings.search if terms == "all" else replace(settings.search, terms=terms)
    nominal = replace(settings.geometry, rotation_deg=turned_deg)
    wide = np.broadcast_to(NOISE_PX**2 * np.eye(2), (len(spots), 2, 2))
    found = acquire(
        spots, PLANE.fiducials[:, :2], nominal, expected_mm=FIBRES_MM,
        errors=PlaceErrors(wide, 8e-3), settings=search,
    )  # fmt: skip
    return guided_um(1e3 * (found.transform.to_mm(spots[len(fiducials_mm) :]) - FIBRES_MM))


def rms(off_um):
    return np.sqrt((off_um**2).sum(axis=1).mean())


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_it_belongs_to_the_focal_plane_and_not_to_the_camera(seed):
    fiducials_mm = TwinErrors.of(PLANE.instrument, "fiducial").fiducials_mm(PLANE, seed)
    here = frame_um(fiducials_mm, 0.0)
    assert rms(here) > 2.0
    for number, turned_deg in enumerate((0.0, 5.0, 90.0, 180.0), 1):
        there = frame_um(fiducials_mm, turned_deg, number)
        # what is left is the lens: 34 terms of camera px for terms of the focal plane
        assert rms(there - here) < 0.25 * rms(here), turned_deg


@pytest.mark.parametrize("size", [1, 2, 3])
def test_no_fiducial_is_in_one_image_and_out_of_the_next(size):
    """A limit to the residuals over what the table says left rim fiducials out of some images, not of all."""
    errors = TwinErrors.of(PLANE.instrument, f"fiducial={size}")
    for seed in range(4):
        fiducials_mm = errors.fiducials_mm(PLANE, seed)
        images = np.array([frame_um(fiducials_mm, 0.0, number) for number in range(6)])
        jump_um = np.hypot(*np.moveaxis(images - images.mean(axis=0), -1, 0)).max()
        print(f"fiducials {8 * size} um, array {seed}: {jump_um:.2f} um between images, worst fibre")
        assert jump_um < 1.5, seed


def test_fewer_terms_leave_micrometres_of_the_lens():
    table_mm = PLANE.fiducials[:, :2]
    few, every = (rms(frame_um(table_mm, 0.0, terms=terms)) for terms in (DEFAULT_TERMS, "all"))
    print(f"right fiducials: 13 terms {few:.2f} um, all 34 {every:.2f} um")
    assert few > 3.0
    assert every < 0.6


def test_terms_that_were_found_are_kept():
    """Without that, the second or third of these images takes 34 terms for the 14 of the others."""
    plane = fl.FocalPlane.of("sdssv", n=37)
    errors = TwinErrors.of(plane.instrument, "fiducial,air")
    source = imaging_camera(StillScene(plane.forward(40.0, 90.0)), plane, 1, MODEL, errors=errors)
    camera = image_camera_of(source, plane, MODEL.optics.geometry, MODEL.optics.field_radius_mm)
    camera.settings = replace(camera.settings, terms=None)
    used = []
    for _ in range(6):
        camera.measure(plane.forward(40.0, 90.0))
        used.append(camera.last.transform.terms)
    assert set(used) == {used[0]}


def test_the_preset_fits_all_terms():
    camera = PLANE.instrument.camera
    assert len(reduction_settings(camera, MODEL.optics.geometry).terms) == 34
    found = camera.model_copy(update={"terms": "found"})
    assert reduction_settings(found, MODEL.optics.geometry).terms is None
