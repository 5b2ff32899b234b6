"""Fiducials beside their table: both cameras see fibres beside where they are, until the table is right."""

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.instruments import METROLOGY
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.camera.models import image_camera
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.errors.sizes import TwinErrors

PLANE = fl.FocalPlane.of("sdssv", n=217)
TABLE_MM = PLANE.fiducials[:, :2]
SHIFT_MM = np.array([0.05, -0.03])
SEED = 2


class Shifted(TwinErrors):
    """All fiducials are off by the same, so that no fit can tell: fibres are seen off by the opposite."""

    def fiducials_mm(self, plane, seed):
        return plane.fiducials[:, :2] + SHIFT_MM


@pytest.fixture(scope="module")
def twin():
    return Twin(PLANE, draw_units(PLANE, SEED), seed=SEED)


def camera_of(kind, twin, errors):
    if kind == "noise":
        return NoiseCamera(twin, 0.01, SEED, errors)
    return image_camera(twin, SEED, errors=errors)


def off_um(camera, twin):
    """(N, 2) where fibres are seen, less where they are."""
    true_mm = twin.fibre_xy(METROLOGY)
    return 1e3 * (camera.measure(true_mm).xy_mm - true_mm)


def rms(um):
    return np.sqrt((um**2).sum(axis=1).mean())


@pytest.mark.parametrize("kind", ["noise", "image"])
def test_fibres_are_seen_beside_their_places_until_the_table_is_right(kind, twin):
    errors = TwinErrors.of(PLANE.instrument, "fiducial=3")
    camera = camera_of(kind, twin, errors)
    wrong = off_um(camera, twin)
    true_mm = errors.fiducials_mm(PLANE, SEED)
    camera.know_fiducials(true_mm)
    right = off_um(camera, twin)
    # three times 8 um in each coordinate, by 13 or 34 terms on 61 fiducials
    put_in = rms(1e3 * (true_mm - TABLE_MM))
    assert 0.1 * put_in < rms(wrong) < put_in
    assert rms(right) < 0.2 * rms(wrong)


@pytest.mark.parametrize("kind", ["noise", "image"])
def test_a_shift_of_all_fiducials_is_a_shift_of_all_fibres(kind, twin):
    none = TwinErrors.of(PLANE.instrument, "none")
    moved = off_um(camera_of(kind, twin, Shifted(**vars(none))), twin)
    still = off_um(camera_of(kind, twin, none), twin)
    np.testing.assert_allclose(np.mean(moved - still, axis=0), -1e3 * SHIFT_MM, atol=0.5)
