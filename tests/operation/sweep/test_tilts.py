"""A still array that is tilted: images tell its sag, and an observation leads its fibres by it."""

from dataclasses import replace

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.blocking import finish
from fiberloom.calibration.gravity.estimate import UNSEEN, UNTOLD, estimate
from fiberloom.errors import InputError
from fiberloom.instruments.pointing import ExposurePointing, Pointing
from fiberloom.operation.past.rebuild import observation_of
from fiberloom.operation.results.budget import EXPECTED, budget
from fiberloom.operation.sweep.tilts import TiltRun, TiltSettings, record_tilts
from fiberloom.report.outputs import marks
from fiberloom.report.tables import budget_line
from fiberloom.store import Store
from fiberloom.targets.generate import random_targets

PLANE = fl.FocalPlane.of("sdssv", n=19)
TARGETS = random_targets(PLANE, 40, 1)
HALF_TURN = ExposurePointing(Pointing(60.0, 20.0), turn_deg=180.0, swing_deg=10.0)


def field_with(errors):
    return fl.Field.twin(PLANE, camera="noise", errors=errors)


def tilted(field, folder, **settings):
    run = TiltRun("a test", folder, marks(PLANE, 0))
    known = PLANE, field.run.calibrate()
    return finish(record_tilts(known, field.source, TiltSettings(**settings), run))


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """Images of the twin, and the file of what they tell."""
    folder = tmp_path_factory.mktemp("gravity")
    images = tilted(field_with("gravity"), folder)
    estimate(PLANE, images).write(folder / "gravity.ecsv", marks(PLANE, 0))
    return images, folder / "gravity.ecsv"


@pytest.fixture(scope="module")
def observed(calibrated, tmp_path_factory):
    """A field whose rotator turns by half a turn after the images: without the calibration, and with it."""
    out = {}
    for name, more in (("without", {}), ("with", {"gravity": calibrated[1]}), ("level", None)):
        field = field_with("gravity")
        how = {"corrections": 2, "out": tmp_path_factory.mktemp(name)}
        told = {} if more is None else {"pointing": HALF_TURN, **more}
        out[name] = field.run.observe(TARGETS, **how, **told), field.source.hardware.truth
    return out


def test_the_array_stands_still_while_it_is_tilted(calibrated):
    images, _ = calibrated
    assert len(images.pointing) == 36
    for one in np.unique(images.configuration):
        at = images.configuration == one
        assert np.ptp(images.angles_deg[:, at], axis=1).max() == 0.0
    first = images.angles_deg[:, [0, 6, 12]]
    assert np.abs(np.diff(first, axis=1)).max() > 20.0
    # opposite rotator angles: shifts of the same size, against each other
    here, there = images.xy_mm[:, ::6] - images.xy_mm[:, 1::6], images.xy_mm[:, 3::6] - images.xy_mm[:, 4::6]
    assert np.corrcoef(here.ravel(), there.ravel())[0, 1] < -0.3


def test_the_twins_own_sag_is_found(calibrated):
    field = field_with("gravity")
    units = field.source.units
    at_1_g = [
        units.load[name][:, axis] * 9.80665 / units.plant["stiffness"][:, axis]
        for axis in (0, 1)
        for name in ("moment_x", "moment_y")
    ]
    found = estimate(PLANE, calibrated[0])
    assert found.ok.all()
    off = found.sag_rad - np.column_stack(at_1_g)
    told = np.einsum("npp->np", found.covariance_rad2)
    # of 80 urad, from 36 images with 0.67 um of noise each
    assert np.sqrt((off**2).mean()) < 1.3 * np.sqrt(told.mean()) < 30e-6


def test_the_exposure_misses_by_what_gravity_does_meanwhile(observed):
    seen, twin = observed["without"]
    final = seen.final
    here, then = (twin.fibre_xy_at("BOSS", at) for at in (HALF_TURN.image, HALF_TURN.middle))
    moved_um = 1e3 * np.hypot(*(then - here).T)
    rows = (seen.assignment.target >= 0) & (seen.assignment.fibre == "BOSS")
    np.testing.assert_allclose(
        1e3 * np.hypot(*(final.true_mm - final.true_image_mm).T)[rows], moved_um[rows], atol=1e-3
    )
    parts = budget(seen)
    assert parts["gravity_um"] > 1.5
    # the loop does at the image what it does in the zenith
    at_image = (final.true_image_mm - seen.target_mm())[seen.counted(final)]
    level_um = budget(observed["level"][0])["science_um"]
    assert 1e3 * np.sqrt((at_image**2).sum(axis=1).mean()) == pytest.approx(level_um, rel=0.35)


def test_with_the_calibration_it_is_back(observed):
    without, led, level = (budget(observed[name][0]) for name in ("without", "with", "level"))
    assert led["gravity_um"] < 0.35 * without["gravity_um"]
    assert led["science_um"] < 0.6 * without["science_um"]
    assert led["science_um"] < level["science_um"] + 0.5
    for part in ("loop_um", "camera_um", "fibre_um"):
        assert led[part] == pytest.approx(without[part], rel=0.35, abs=0.1)
    assert level["gravity_um"] is None


def test_the_parts_of_the_error_add_up(observed):
    seen, _ = observed["with"]
    final, lead = seen.final, seen.lead_mm()
    science = final.true_mm - seen.target_mm()
    later = final.true_mm - final.true_image_mm + lead
    loop = final.measurement.xy_mm - seen.metrology_goal_mm(final)
    camera = final.true_metrology_mm - seen.metrology_goal_mm(final) - seen.frame_mm() - loop
    rows = seen.counted(final)
    fibre = (final.true_image_mm - final.true_metrology_mm) - (
        seen.target_mm() + lead - seen.metrology_goal_mm(final) - seen.frame_mm()
    )
    np.testing.assert_allclose((loop + camera + fibre + later)[rows], science[rows], atol=1e-12)
    rms_um = 1e3 * np.sqrt((fibre[rows] ** 2).sum(axis=1).mean())
    assert budget(seen)["fibre_um"] == pytest.approx(rms_um)
    assert np.abs(seen.frame_mm()[rows]).max() < 1e-9
    assert 1.0 < 1e3 * np.sqrt((lead[rows] ** 2).sum(axis=1).mean()) < 5.0


def test_the_worst_of_the_exposure_is_at_its_ends(observed):
    seen, _ = observed["with"]
    final = seen.final
    middle, worst = seen.true_error_um(final), seen.worst_error_um(final)
    rows = seen.counted(final)
    assert (worst[rows] >= middle[rows]).all()
    assert (worst[rows] > middle[rows]).any()
    assert final.true_ends_mm.shape == (2, 19, 2)
    row = seen.summary()["moves"][-1]
    assert row["worst_in_exposure_rms_um"] > row["true_rms_um"]
    assert observed["level"][0].worst_error_um(observed["level"][0].final) is None


def test_pointing_and_calibration_are_in_the_summary_and_on_record(observed, calibrated):
    seen, _ = observed["with"]
    summary = seen.summary()
    assert summary["pointing"] == HALF_TURN.about()
    assert 0.0 < summary["gravity_calibration"]["formal_um"] < 1.0
    assert f"gravity {summary['budget']['gravity_um']:.2f}" in budget_line(summary["budget"])
    assert "pointing" not in observed["level"][0].summary()


def test_an_observation_comes_back_from_the_store(observed, calibrated, tmp_path):
    seen = field_with("gravity").run.observe(
        TARGETS, corrections=1, out=tmp_path, pointing=HALF_TURN, gravity=calibrated[1]
    )
    with Store.read(tmp_path / "store.sqlite") as store:
        again, _ = observation_of(store, store.runs()[-1])
    assert again.summary()["budget"] == seen.summary()["budget"]
    np.testing.assert_array_equal(again.lead_mm(), seen.lead_mm())
    np.testing.assert_array_equal(again.final.true_ends_mm, seen.final.true_ends_mm)


def test_on_hardware_the_part_is_what_the_calibration_leaves_open(observed):
    seen, _ = observed["with"]
    nobody = {"true_mm": None, "true_metrology_mm": None, "true_image_mm": None, "true_ends_mm": None}
    blind = replace(seen, moves=[*seen.moves[:-1], replace(seen.moves[-1], **nobody)])
    found = budget(blind)
    assert found["known"] == EXPECTED
    formal_um = seen.about["gravity_calibration"]["formal_um"]
    # gravity turns by half a turn at 60 deg
    assert found["gravity_um"] == pytest.approx(formal_um * 2.0 * np.sin(np.deg2rad(60.0)))


# no gain


@pytest.mark.parametrize(
    ("errors", "settings", "reason"),
    [
        ("none", {}, UNSEEN),
        ("gravity", {"zenith_deg": 0.0}, UNTOLD),
    ],
    ids=["arms without mass", "zenith"],
)
def test_images_without_information_lead_no_fibre(errors, settings, reason, tmp_path):
    found = estimate(PLANE, tilted(field_with(errors), tmp_path, **settings))
    assert set(found.reason.tolist()) == {reason}
    found.write(tmp_path / "gravity.ecsv", marks(PLANE, 0))
    seen = field_with("gravity").run.observe(
        TARGETS, corrections=0, out=tmp_path, pointing=HALF_TURN, gravity=tmp_path / "gravity.ecsv"
    )
    assert not seen.lead_mm().any()


def test_a_telescope_that_is_pointed_from_elsewhere_is_told(tmp_path):
    class Elsewhere:
        def __init__(self, source):
            self.open_all = source.open

        async def open(self):
            return replace(await self.open_all(), telescope=None)

    field = field_with("gravity")
    run = TiltRun("a test", tmp_path, marks(PLANE, 0))
    known = PLANE, field.run.calibrate()
    with pytest.raises(InputError, match="--images FILE"):
        finish(record_tilts(known, Elsewhere(field.source), TiltSettings(), run))
    with pytest.raises(InputError, match="rotators = 1: must be 2 or more"):
        TiltSettings(rotators=1)
