"""From true fibre positions through an image and back: as good as the photons allow."""

from dataclasses import replace

import numpy as np
import pytest

from fiberloom.errors import InputError
from fiberloom.instruments import generate
from fiberloom.metrology import SeveralImages, find_spots, one_image, write_image
from fiberloom.metrology.acquisition import AcquisitionError, CameraGeometry
from fiberloom.metrology.images import read_image
from fiberloom.metrology.pipeline import ImageCamera, ReductionSettings
from fiberloom.metrology.spots import SpotSettings, write_spots
from fiberloom.planning import read_configuration, write_configuration
from fiberloom.twin.camera.imaging import CameraModel, Detector, ImagingCamera, Light, Optics, Psf, StillScene
from fiberloom.twin.camera.models import camera_model

RADIUS_MM = 150.0
GEOMETRY = CameraGeometry(1500, 1500, 0.2, flipped=True)
MODEL = CameraModel(
    Optics(replace(GEOMETRY, rotation_deg=0.4), RADIUS_MM, {9: 0.15, 20: 0.008, 5: 0.004}),
    Psf("moffat", 3.0, beta=4.0, growth=0.1),
    Detector(1.3, 8.0, 400.0, 60_000.0, hot_share=2e-5, cosmic_rays=3),
    Light(fibre_e=150_000.0, fiducial_e=150_000.0),
)


@pytest.fixture(scope="module")
def small(sdssv):
    """91 positioners with 30 fiducials among and around them."""
    plane = generate(sdssv, seed=0, n_positioners=91)
    rng = np.random.default_rng(5)
    angle = rng.uniform(0, 2 * np.pi, 30)
    radius = np.concatenate([rng.uniform(20, 110, 12), np.full(18, 140.0)])
    xy = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    return replace(plane, fiducials=np.column_stack([xy, np.full(30, 2.0)]))


def configuration(plane, seed):
    rng = np.random.default_rng([seed, 11])
    low, high = plane.limits_deg.T
    return rng.uniform(low, high, (len(plane), 2))


def camera_on(plane, scene, model=MODEL, seed=1):
    source = ImagingCamera(scene, model, fiducials_mm=plane.fiducials, seed=seed)
    settings = ReductionSettings(replace(GEOMETRY, rotation_tolerance_deg=5.0), radius_mm=RADIUS_MM)
    return ImageCamera(source, plane, settings)


def apart(xy):
    """Fibres that do not lie on each other: random arms do, real ones cannot."""
    gap = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1)) + 1e9 * np.eye(len(xy))
    return gap.min(axis=1) > 1.5


def test_positions_are_within_half_again_of_the_photon_noise(small):
    expected = small.forward(*configuration(small, 0).T)
    true = expected + np.random.default_rng(0).normal(0, 0.02, expected.shape)
    true[[3, 50]] = np.nan
    camera = camera_on(small, StillScene(true))
    alone = apart(np.nan_to_num(true, nan=1e3)) & np.isfinite(true).all(axis=1)
    error, stated = [], []
    for _ in range(4):
        seen = camera.measure(expected)
        assert not seen.seen[[3, 50]].any()
        assert np.isnan(seen.x_mm[3])
        assert (seen.seen | ~alone).all()
        error.append((seen.xy_mm - true)[alone])
        stated.append(seen.covariance_mm2[alone])
    reduction = camera.last
    photon_mm2 = np.mean(np.trace(reduction.spots.covariance_px2, axis1=1, axis2=2)) * 0.2**2
    rms_mm = np.sqrt(np.mean(np.sum(np.square(error), axis=2)))
    assert rms_mm < 1.5 * np.sqrt(photon_mm2)
    pull = np.sqrt(np.mean(np.square(error)) / np.mean(np.trace(stated, axis1=2, axis2=3) / 2))
    assert 0.85 < pull < 1.2
    assert len(reduction.acquisition.fiducial) == 30


def test_the_camera_remembers_and_forgets(small):
    scene = StillScene(small.forward(*configuration(small, 1).T))
    camera = camera_on(small, scene)
    camera.measure(scene.xy_mm)
    assert camera.profile is not None
    # somebody kicks the camera: the old transform does not hold, it is found anew
    off = replace(MODEL, optics=replace(MODEL.optics, geometry=replace(GEOMETRY, rotation_deg=-3.0)))
    camera.source = ImagingCamera(scene, off, fiducials_mm=small.fiducials, seed=2)
    seen = camera.measure(scene.xy_mm)
    assert seen.seen.sum() > 85
    assert camera.last.transform.similarity.rotation_deg == pytest.approx(-3.0, abs=0.01)


def test_the_last_image_is_matched_anew_without_another_exposure(small):
    scene = StillScene(small.forward(*configuration(small, 1).T))
    camera, told = camera_on(small, scene), []
    camera.watchers.append(told.append)
    first = camera.measure(np.where(np.arange(91)[:, None] < 60, scene.xy_mm, np.nan))
    again = camera.rematch(scene.xy_mm, first)
    other = camera_on(small, scene)
    assert other.rematch(scene.xy_mm, first) is None  # it has no image yet
    at_once = other.measure(scene.xy_mm)  # the same image
    assert first.seen.sum() < again.seen.sum()
    np.testing.assert_array_equal(again.xy_mm, at_once.xy_mm)
    np.testing.assert_array_equal(again.covariance_mm2, at_once.covariance_mm2)
    assert camera.source.exposures == len(told) == 1
    assert camera.rematch(scene.xy_mm, at_once) is None  # another camera's
    camera.know_fiducials(small.fiducials[:, :2])
    assert camera.rematch(scene.xy_mm, again) is None
    before = camera.measure(scene.xy_mm)
    last = camera.measure(scene.xy_mm)
    assert camera.rematch(scene.xy_mm, before) is None
    assert camera.rematch(scene.xy_mm, SeveralImages([before, last]).mean()) is None
    last = camera.rematch(scene.xy_mm, last)
    assert last is not None
    camera.turn(1.0)
    assert camera.rematch(scene.xy_mm, last) is None


class Shuttered:
    """A camera whose shutter stays closed for the first so many exposures."""

    def __init__(self, source, closed):
        self.source, self.closed = source, closed

    def expose(self):
        image = self.source.expose()
        self.closed -= 1
        return replace(image, pixels=np.zeros_like(image.pixels)) if self.closed >= 0 else image


def test_a_dark_exposure_is_taken_again_and_a_third_one_is_an_error(small):
    scene = StillScene(small.forward(*configuration(small, 1).T))
    camera = camera_on(small, scene)
    camera.source = Shuttered(camera.source, 2)
    assert camera.measure(scene.xy_mm).seen.sum() > 85
    before = camera.last
    camera.source.closed = 3
    with pytest.raises(AcquisitionError, match="0 spots in the image: every pixel is 0"):
        camera.measure(scene.xy_mm)
    assert camera.last is before  # nothing that was known is lost


def test_one_that_did_not_move_is_found_where_it_was(small):
    first = small.forward(*configuration(small, 2).T)
    scene = StillScene(first.copy())
    camera = camera_on(small, scene)
    camera.measure(first)
    second = small.forward(*configuration(small, 3).T)
    scene.xy_mm = second.copy()
    scene.xy_mm[7] = first[7]
    seen = camera.measure(second)
    known = seen.seen & apart(scene.xy_mm)
    assert np.hypot(*(seen.xy_mm - scene.xy_mm)[known].T).max() < 0.01
    if apart(scene.xy_mm)[7]:
        assert seen.seen[7]


def test_turbulence_is_removed_by_those_who_stand(small):
    true = small.forward(*configuration(small, 4).T)
    windy = replace(MODEL, optics=replace(MODEL.optics, turbulence_um=8.0, turbulence_length_mm=60.0))
    scene = StillScene(true)
    rms = []
    for remove in (False, True):
        camera = camera_on(small, scene, windy, seed=3)
        camera.settings = replace(camera.settings, turbulence=remove, terms=(0, 1, 2, 3, 4, 5, 6, 9, 20, 27))
        standing = true.copy()
        standing[np.arange(91) % 4 != 0] = np.nan
        camera.standing_mm = standing
        moving = apart(true) & (np.arange(91) % 4 != 0)
        error = [(camera.measure(true).xy_mm - true)[moving] for _ in range(3)]
        rms.append(1e3 * np.sqrt(np.nanmean(np.sum(np.square(error), axis=2))))
    assert rms[0] > 5.0
    assert rms[1] < 0.6 * rms[0]


@pytest.mark.parametrize(("name", "rms_nm"), [("workspace", 669.0), ("close-up", 101.0)])
def test_figure_18_comes_out_of_photons_and_pixels(name, rms_nm):
    model = camera_model(name)
    model = replace(
        model,
        optics=replace(model.optics, geometry=replace(model.optics.geometry, width_px=200, height_px=200)),
    )
    camera = ImagingCamera(StillScene(np.array([[0.0103, 0.0201]])), model, seed=4)
    stated = []
    for _ in range(3):
        image = camera.expose()
        spots = find_spots(image.pixels, SpotSettings(image.gain_e_adu, image.saturation_adu)).spots
        assert len(spots) == 1
        stated.append(np.trace(spots.covariance_px2[0]))
    nm = 1e6 * model.optics.geometry.scale_mm_px * np.sqrt(np.mean(stated))
    assert nm == pytest.approx(rms_nm, rel=0.05)


def test_the_same_seed_gives_the_same_image(small):
    scene = StillScene(small.forward(*configuration(small, 5).T))
    one, two = (ImagingCamera(scene, MODEL, fiducials_mm=small.fiducials, seed=9) for _ in range(2))
    first = one.expose().pixels
    np.testing.assert_array_equal(first, two.expose().pixels)
    assert (one.expose().pixels != first).any()


def test_a_header_that_tells_where_a_pixel_lies():
    camera = ImagingCamera(StillScene(np.zeros((1, 2))), MODEL, seed=1)
    h = camera.header()
    px = np.array([[700.0, 900.0], [20.0, 1400.0]])
    cd = np.array([[h["CD1_1"], h["CD1_2"]], [h["CD2_1"], h["CD2_2"]]])
    by_header = (px + 1 - [h["CRPIX1"], h["CRPIX2"]]) @ cd.T
    np.testing.assert_allclose(by_header, MODEL.optics.geometry.similarity().to_mm(px), atol=1e-9)


def test_distortion_of_both_kinds_moves_spots_outwards():
    flat = Optics(GEOMETRY, 100.0)
    at = np.array([[100.0, 0.0], [50.0, 0.0]])
    bent = replace(flat, radial=(0.5, 0.1)).to_px(at) - flat.to_px(at)
    # p (k3 r^2 + k5 r^4) with p in mm
    np.testing.assert_allclose(bent[:, 0] * 0.2, [100 * 0.6, 50 * (0.125 + 0.00625)])


@pytest.fixture(scope="module")
def files(small, tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    angles = configuration(small, 6)
    true = small.forward(*angles.T)
    true[10] = np.nan
    image = ImagingCamera(StillScene(true), MODEL, fiducials_mm=small.fiducials, seed=6).expose()
    write_image(image, folder / "image.fits")
    write_configuration(folder / "goal.csv", small.positioner_id, angles)
    return folder


def identified(plane, source, expected):
    spots, width, height = one_image.read_source(source)
    geometry = replace(
        one_image.camera_geometry(plane.instrument, (width, height), scale_mm_px=0.2), flipped=True
    )
    return one_image.identify(plane, spots, geometry, expected)


def test_from_an_image_to_positions(small, files):
    image = read_image(files / "image.fits")
    found = one_image.spots_of_image(image)
    report = one_image.spots_report(image, found)
    assert report["gain_e_adu"] == 1.3
    assert 105 <= report["spots"] <= 121
    write_spots(found.spots, files / "spots.csv", one_image.image_marks(image))
    expected = small.forward(*read_configuration(files / "goal.csv", small).T)
    made = identified(small, files / "spots.csv", expected)
    one_image.write_positions(files / "positions.csv", made)
    matched = one_image.match_report(made)
    assert matched["fiducials_found"] == "30 of 30"
    assert int(small.positioner_id[10]) in matched["dark"] + matched["ambiguous"]
    assert matched["matched"] > 80
    rows = (files / "positions.csv").read_text().splitlines()
    assert sum(not r.startswith("#") for r in rows) == 92
    from_image = one_image.match_report(identified(small, files / "image.fits", expected))
    assert from_image["matched"] == matched["matched"]


def test_one_image_is_refused_in_one_line(small, files, tmp_path):
    with pytest.raises(InputError, match="no such file"):
        one_image.read_source(files / "none.fits")
    with pytest.raises(InputError, match="--scale"):
        one_image.camera_geometry(small.instrument, (100, 100), scale_mm_px=-1.0)
    (tmp_path / "s.csv").write_text("x_px,y_px\n1,2\n")
    with pytest.raises(InputError, match="1 spots"):
        identified(small, tmp_path / "s.csv", np.full((len(small), 2), np.nan))
    with pytest.raises(InputError, match="3 fiducials; at least 4"):
        one_image.require_fiducials(replace(small, fiducials=small.fiducials[:3]))


def test_plots_of_an_exposure(small, tmp_path):
    from fiberloom.report.exposure import plot_reduction

    expected = small.forward(*configuration(small, 7).T)
    true = expected.copy()
    true[5] = np.nan
    camera = camera_on(small, StillScene(true))
    camera.measure(expected)
    paths = plot_reduction(tmp_path, "e1", small, camera.last)
    assert [p.name for p in paths] == ["e1-image.png", "e1-residuals.png", "e1-distortion.png"]
    assert all(p.stat().st_size > 10_000 for p in paths)


def test_unknown_presets_are_refused():
    with pytest.raises(InputError, match="sdssv"):
        camera_model("hubble")
    with pytest.raises(InputError, match="moffat"):
        Psf("airy")
