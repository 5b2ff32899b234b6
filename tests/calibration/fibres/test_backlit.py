"""Science fibres lit from behind: their offsets come back, with honest errors; other lights are not taken."""

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.calibration.fibres.backlit import arms_deg, offsets_of_backlit
from fiberloom.calibration.fibres.offsets import FibreOffsets
from fiberloom.errors import InputError
from fiberloom.instruments import METROLOGY
from fiberloom.operation.survey import SurveySettings
from fiberloom.twin import draw_units
from fiberloom.twin.errors.sizes import TwinErrors

PLANE = fl.FocalPlane.of("sdssv", n=19)
NOISE_UM = 0.7


def lit(seed, images=8, noise_um=NOISE_UM):
    """Angles, differences by the layout's own kinematics, and the offsets put in, mm."""
    rng = np.random.default_rng(seed)
    theta = np.stack([rng.uniform(5, 355, (19, images)), rng.uniform(60, 178, (19, images))], axis=-1)
    offset = {name: 0.015 * rng.standard_normal((19, 2)) for name in PLANE.science_fibres}
    apart = {}
    for name in PLANE.science_fibres:
        places = {}
        for which, added in ((METROLOGY, 0.0), (name, offset[name])):
            points = PLANE.points | {which: PLANE.points[which] + added}
            moved = fl.FocalPlane(**vars(PLANE) | {"points": points})
            places[which] = np.stack([moved.forward(*theta[:, s].T, which) for s in range(images)], axis=1)
        apart[name] = places[name] - places[METROLOGY] + rng.normal(0, 1e-3 * noise_um, (19, images, 2))
    return theta, apart, offset


def off_um(found, offset):
    row = {int(p): k for k, p in enumerate(PLANE.positioner_id)}
    true = [offset[f][row[int(p)]] for p, f in zip(found.positioner_id, found.fibre, strict=True)]
    return 1e3 * (found.offset_mm - true)[found.ok]


def test_offsets_come_back_and_their_errors_are_those_that_it_says():
    theta, apart, offset = lit(0)
    found = offsets_of_backlit(PLANE, theta, apart)
    assert found.ok.all()
    assert len(found) == sum(int(PLANE.carries(name).sum()) for name in PLANE.science_fibres)
    rms = np.sqrt((off_um(found, offset) ** 2).sum(axis=1).mean())
    assert found.formal_um == pytest.approx(np.sqrt(2.0) * NOISE_UM / np.sqrt(8), rel=0.15)
    assert rms == pytest.approx(found.formal_um, rel=0.3)


def test_it_is_used_as_offsets_of_stars_are(tmp_path):
    theta, apart, offset = lit(1, noise_um=0.0)
    found = offsets_of_backlit(PLANE, theta, apart)
    found.write(tmp_path / "fibres.ecsv", {"version": "test"})
    moved = FibreOffsets.load(tmp_path / "fibres.ecsv").applied(PLANE)
    has = PLANE.carries("BOSS")
    np.testing.assert_allclose(
        (moved.points["BOSS"] - PLANE.points["BOSS"])[has], offset["BOSS"][has], atol=1e-8
    )


def test_another_light_and_a_dark_fibre_do_no_harm():
    theta, apart, offset = lit(2)
    apart["BOSS"][3, 2] += 0.15
    apart["BOSS"][5] = np.nan
    apart["BOSS"][6, :6] = np.nan
    found = offsets_of_backlit(PLANE, theta, apart)
    refused = dict(
        zip(found.positioner_id[~found.ok].tolist(), found.reason[~found.ok].tolist(), strict=True)
    )
    ids = PLANE.positioner_id
    assert refused == {
        int(ids[5]): "seen in 0 images, 3 needed",
        int(ids[6]): "seen in 2 images, 3 needed",
    }
    assert np.hypot(*off_um(found, offset).T).max() < 3.0


def test_images_without_information_are_no_gain():
    theta, apart, _ = lit(3, noise_um=100.0)
    found = offsets_of_backlit(PLANE, theta, apart)
    assert found.formal_um > 25.0  # larger than what fibres are off: said, not hidden


def test_directions_are_the_layouts_own():
    theta = np.array([[[12.0, 80.0]]] * 19)
    at = np.stack([PLANE.forward(12.0, 80.0, name) for name in (METROLOGY, "BOSS")])
    z = (at[1] - at[0]) @ [1.0, 1.0j]
    lever = (PLANE.points["BOSS"] - PLANE.points[METROLOGY]) @ [1.0, 1.0j]
    turned = np.rad2deg(np.angle(z / lever))
    np.testing.assert_allclose((arms_deg(PLANE, theta)[:, 0] - turned + 180.0) % 360.0, 180.0, atol=1e-6)


def test_a_camera_without_images_is_refused(tmp_path):
    field = fl.Field.twin(fl.FocalPlane.of("sdssv", n=7), camera="noise")
    with pytest.raises(InputError, match="takes no images"):
        field.run.survey(SurveySettings(4, backlit=("BOSS",)), out=tmp_path)


@pytest.mark.slow
def test_on_the_twin_they_are_found_to_half_a_micrometre(tmp_path):
    field = fl.Field.twin(PLANE, 4, camera="image", errors="all")
    asked = SurveySettings(8, seed=4, backlit=("BOSS",))
    found = field.run.survey(asked, out=tmp_path).science
    errors = TwinErrors.of(PLANE.instrument)
    true = draw_units(PLANE, 4, errors=errors).fibre_offset_mm["BOSS"]
    assert found.ok.all()
    off = np.sqrt(((1e3 * (found.offset_mm - true)) ** 2).sum(axis=1).mean())
    put_in = 1e3 * np.sqrt((true**2).sum(axis=1).mean())
    print(f"BOSS: {put_in:.1f} um put in, found to {off:.2f}, said {found.formal_um:.2f}")
    assert off < 1.0
    assert off < 1.6 * found.formal_um
