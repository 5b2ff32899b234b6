"""Fiducials, lens and arms together: found where turned images tell them, and no better is claimed."""

from dataclasses import replace

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.calibration.fibres.guider import guided
from fiberloom.calibration.focal_plane.arms_file import load_arms, save_arms
from fiberloom.calibration.focal_plane.bundle import calibrate_fiducials
from fiberloom.calibration.focal_plane.fit import fit_focal_plane, layout_parameters, model
from fiberloom.calibration.focal_plane.survey_data import Looks
from fiberloom.errors import InputError
from fiberloom.metrology import zhao_burge
from fiberloom.metrology.transform import Distortion, PlaceErrors, fit_transform
from fiberloom.twin.camera.imaging import Optics
from fiberloom.twin.camera.models import model_for
from fiberloom.twin.errors.sizes import TwinErrors

PLANE = fl.FocalPlane.of("sdssv")
TABLE_MM = PLANE.fiducials[:, :2]
ANGLES_DEG = (0.023, 0.014)
EVERY = tuple(range(zhao_burge.N_TERMS))


class Survey:
    """Spots of S configurations by the twin's lens, by independent code, with noise."""

    def __init__(self, seed, turned_deg=360.0, size=1.0, spot_um=0.7, images=12):
        rng = np.random.default_rng([seed, 7])
        self.true_mm = TwinErrors.of(PLANE.instrument, f"fiducial={size}").fiducials_mm(PLANE, seed)
        arms = layout_parameters(PLANE)
        arms[:, :4] += rng.normal(0.0, 0.01, (PLANE.n, 4))
        self.theta_deg = np.stack(
            [rng.uniform(5, 355, (PLANE.n, images)), rng.uniform(60, 178, (PLANE.n, images))], axis=-1
        )
        off = rng.normal(0.0, 1.0, self.theta_deg.shape) * ANGLES_DEG
        fibres = model(arms, self.theta_deg + off, PLANE.metrology_phi_rad, slopes=False)[0]
        optics = model_for(PLANE).optics
        flat = optics.geometry.similarity()
        rows = []
        for k in range(images):
            turned = replace(optics, turned_deg=turned_deg * k / images)
            spots = turned.to_px(np.vstack([self.true_mm, fibres[:, k]]))
            spots = flat.to_mm(spots) + rng.normal(0.0, 1e-3 * spot_um, spots.shape)
            rows.append(np.split(spots, [len(TABLE_MM)]))
        self.looks = Looks(np.arange(images), *(np.stack(part) for part in zip(*rows, strict=True)))

    def seen_mm(self):
        """(N, S, 2) as each image alone has the fibres, by the table."""
        wide = np.broadcast_to(1e-6 * np.eye(2), (len(TABLE_MM), 2, 2))
        out = []
        for fiducial, fibre in zip(self.looks.fiducial_mm, self.looks.fibre_mm, strict=True):
            errors = PlaceErrors(wide, 8e-3)
            fit = fit_transform(fiducial, TABLE_MM, Distortion(330.0, EVERY), errors=errors)
            out.append(fit.transform.to_mm(fibre))
        return np.stack(out, axis=1)

    def calibrated(self):
        fit = fit_focal_plane(PLANE, self.theta_deg, self.seen_mm())
        return fit, *calibrate_fiducials(PLANE, fit, self.theta_deg, self.looks, 8.0)

    def off_um(self, fiducials_mm):
        """(F, 2) from where they are, less what a guider takes."""
        every = np.ones(len(fiducials_mm), dtype=bool)
        return 1e3 * guided(fiducials_mm - self.true_mm, self.true_mm, every)


def rms(off_um):
    return np.sqrt((off_um**2).sum(axis=-1).mean())


def frame_um(off_um):
    """2-D rms at the fibres of what a frame of 34 terms makes of fiducials that are so far off."""
    radius_mm = 305.0
    design = zhao_burge.basis(TABLE_MM / radius_mm, EVERY).reshape(len(EVERY), -1).T
    size = np.linalg.lstsq(design, off_um.ravel(), rcond=None)[0]
    return rms(np.einsum("k,knc->nc", size, zhao_burge.basis(PLANE.centres_mm / radius_mm, EVERY)))


@pytest.mark.parametrize(("seed", "size"), [(0, 1.0), (1, 1.0), (2, 1.0), (2, 2.0)])
def test_the_fixed_error_of_the_frame_falls_below_a_micrometre(seed, size):
    survey = Survey(seed, size=size)
    _, found, _ = survey.calibrated()
    before, after = frame_um(survey.off_um(TABLE_MM)), frame_um(survey.off_um(found.xy_mm))
    print(f"fiducials {8 * size:g} um, array {seed}: frame {before:.2f} to {after:.2f} um")
    assert after < 1.0
    assert after < 0.4 * before


def test_its_errors_are_those_that_it_says():
    squares = []
    for seed in range(4):
        survey = Survey(seed)
        _, found, _ = survey.calibrated()
        squares.append((rms(survey.off_um(found.xy_mm)) / found.formal_um) ** 2)
    assert 0.5 < np.mean(squares) < 2.0, squares


def test_images_that_are_not_turned_tell_little_and_little_is_claimed():
    turned, still = Survey(0), Survey(0, turned_deg=0.0)
    assert still.calibrated()[1].formal_um > 2.0 * turned.calibrated()[1].formal_um
    found = still.calibrated()[1]
    assert rms(still.off_um(found.xy_mm)) < 1.5 * found.formal_um
    assert found.turned_deg < 0.1


def test_images_without_information_give_nothing():
    """Spots fifty times worse: fiducials stay nearly where the table has them, and so it is said."""
    survey = Survey(0, spot_um=50.0)
    fit = fit_focal_plane(PLANE, survey.theta_deg, Survey(0).seen_mm())
    found, _ = calibrate_fiducials(PLANE, fit, survey.theta_deg, survey.looks, 8.0)
    assert rms(survey.off_um(found.xy_mm)) > 0.6 * rms(survey.off_um(TABLE_MM))
    assert found.formal_um > 0.6 * np.sqrt(2.0) * 8.0


def test_arms_are_better_in_the_frame_that_they_make():
    survey = Survey(1)
    fit, _, xy_mm = survey.calibrated()
    again = fit_focal_plane(PLANE, survey.theta_deg, xy_mm)
    assert np.isfinite(xy_mm).all()
    true = layout_parameters(PLANE)
    off = [1e3 * (f.parameters[:, :2] - true[:, :2]) for f in (fit, again)]
    # both have the arms' own 10 um; what is left of the frame is taken off by the second
    assert rms(off[1]) < rms(off[0])


def test_a_light_that_is_no_fiducial_does_no_harm():
    survey = Survey(0)
    fit = fit_focal_plane(PLANE, survey.theta_deg, survey.seen_mm())
    survey.looks.fiducial_mm[3, 7] += 0.5
    survey.looks.fiducial_mm[4, 11] = np.nan
    found, _ = calibrate_fiducials(PLANE, fit, survey.theta_deg, survey.looks, 8.0)
    assert frame_um(survey.off_um(found.xy_mm)) < 1.0


@pytest.mark.parametrize("turned_deg", [0.0, 33.0, 180.0, -90.0])
def test_a_turned_lens_is_the_same_lens(turned_deg):
    """By rotating the plane by hand."""
    optics = Optics(model_for(PLANE).optics.geometry, 330.0, {9: 0.64, 5: 0.02, 30: 0.004})
    z = TABLE_MM @ [1.0, 1.0j] * np.exp(-1j * np.deg2rad(turned_deg))
    by_hand = optics.to_px(np.column_stack([z.real, z.imag]))
    np.testing.assert_allclose(replace(optics, turned_deg=turned_deg).to_px(TABLE_MM), by_hand, atol=1e-9)


def test_a_positioner_without_arms_is_left_out():
    survey = Survey(0)
    seen_mm = survey.seen_mm()
    survey.looks.fibre_mm[:, [3, 50]] = seen_mm[[3, 50]] = np.nan
    fit = fit_focal_plane(PLANE, survey.theta_deg, seen_mm)
    assert [bool(r) for r in fit.reason].count(True) == 2
    found, xy_mm = calibrate_fiducials(PLANE, fit, survey.theta_deg, survey.looks, 8.0)
    assert frame_um(survey.off_um(found.xy_mm)) < 1.0
    assert np.flatnonzero(np.isnan(xy_mm).any(axis=(1, 2))).tolist() == [3, 50]


def test_the_file_of_the_arms_keeps_them(tmp_path):
    survey = Survey(0)
    fit, found, _ = survey.calibrated()
    path = tmp_path / "arms.ecsv"
    save_arms(path, fit, {"version": "test"} | found.to_meta())
    plane = load_arms(path, PLANE)
    np.testing.assert_allclose(plane.fiducials[:, :2], found.xy_mm, atol=1e-9)
    np.testing.assert_array_equal(plane.fiducials[:, 2], PLANE.fiducials[:, 2])
    other = PLANE.fiducials.copy()
    other[3, 0] += 0.01
    with pytest.raises(InputError, match=r"arms\.ecsv.*another layout"):
        load_arms(path, replace(PLANE, fiducials=other))


def test_too_few_images_are_refused():
    survey = Survey(0, images=12)
    few = Looks(np.arange(2), survey.looks.fiducial_mm[:2], survey.looks.fibre_mm[:2])
    fit = fit_focal_plane(PLANE, survey.theta_deg, survey.seen_mm())
    with pytest.raises(InputError, match="2 images"):
        calibrate_fiducials(PLANE, fit, survey.theta_deg, few, 8.0)
