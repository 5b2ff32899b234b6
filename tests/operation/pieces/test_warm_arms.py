"""The thermometer and the model of the arms on the twin: blind errors as at the calibration, and no harm."""

import dataclasses

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.bus.outcome import Outcome, Result, Results
from fiberloom.calibration.transmission.cache import load_for
from fiberloom.instruments.model import Expansion
from fiberloom.operation.care.thermometer import Felt, judged
from fiberloom.operation.care.warm_arms import WarmArms, nights_of
from fiberloom.report.tables import temperature_line
from fiberloom.store import Store
from fiberloom.studies.star_fields import stars
from fiberloom.twin.errors.sizes import TwinErrors

PLANE = fl.FocalPlane.of("sdssv", n=37)
SEED = 0
NIGHTS_C = (14.0, 2.0, 26.0, -4.0, 9.0, 20.0)


def with_expansion(plane, **told):
    known = plane.instrument.expansion.model_dump() | told
    instrument = plane.instrument.model_copy(update={"expansion": Expansion.model_validate(known)})
    return dataclasses.replace(plane, instrument=instrument)


def on_invar(plane):
    """Nothing of the arms' growth is hidden, so that 20 K are 7 um of blind error."""
    table = {"plate_per_K": 0.0, "plate_scatter_per_K": 0.0, "lens_um_per_K": 0.0}
    twin = {**plane.instrument.twin, "errors": {"temperature": table}}
    return dataclasses.replace(plane, instrument=plane.instrument.model_copy(update={"twin": twin}))


INVAR = with_expansion(on_invar(PLANE), arms_per_K=22e-6, arms_per_K_sd=4e-6)
"""The instrument knows nearly what its arms do: 23e-6."""
UNAWARE = dataclasses.replace(INVAR, instrument=INVAR.instrument.model_copy(update={"expansion": None}))


@pytest.fixture(scope="module")
def maps(tmp_path_factory):
    file = tmp_path_factory.mktemp("warm") / "maps.npz"
    fl.Field.twin(PLANE, SEED, camera="noise").run.calibrate().save(file)
    return file


def observed(plane, maps, at_C, out, field=7, **asked):
    night = fl.Field.twin(plane, SEED, camera="noise", errors=f"temperature,at_C={at_C:g}", calibration=maps)
    asked = {"corrections": 0} | asked
    return night.run.observe(stars(PLANE, "BOSS", field), out=out, **asked)


def blind_um(seen):
    error_um = seen.moves[0].measured_error_um
    return float(np.sqrt(np.nanmean(error_um**2)))


def told(seen):
    return seen.summary()["temperature"]


# what the thermometers say


def answers(*at_C, silent=0):
    care = PLANE.instrument.care
    counts = [round((t - care.temperature_zero_C) / care.temperature_C_per_count) for t in at_C]
    results = Results({i: Result(i, Outcome.DONE, values=(c,)) for i, c in enumerate(counts)})
    return Results(results | {100 + i: Result(100 + i, Outcome.TIMED_OUT) for i in range(silent)})


def test_a_few_wrong_thermometers_do_not_matter():
    assert judged(PLANE.instrument, answers(3.0, 4.0, 5.0, 4.0, 80.0)).at_C == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (answers(silent=5), "0 of 5 positioners tell"),
        (answers(4.0, 4.0, silent=3), "2 of 5 positioners tell"),
        (answers(4.0, 12.0, 25.0, -9.0, 31.0), "scatter by"),
        (answers(57.0, 57.0, 57.0), "say 57 deg C, which cannot be"),
    ],
)
def test_thermometers_that_cannot_be_right_are_not_believed(raw, words):
    felt = judged(PLANE.instrument, raw)
    assert felt.at_C is None
    assert words in felt.why


# blind errors


def test_with_the_thermometer_a_blind_move_is_as_good_as_at_the_calibration(maps, tmp_path):
    warm = observed(UNAWARE, maps, 20.0, tmp_path / "warm")
    unaware = observed(UNAWARE, maps, 0.0, tmp_path / "unaware")
    aware = observed(INVAR, maps, 0.0, tmp_path / "aware")
    assert "temperature" not in unaware.summary()
    # 23e-6 x 20 K x the distance from the centre, beside what maps and seats leave
    out_mm = PLANE.forward(*unaware.moves[0].commanded_deg.T) - PLANE.centres_mm
    by_growth_um = 1e3 * 23e-6 * 20.0 * np.sqrt((out_mm**2).sum(axis=1).mean())
    assert by_growth_um == pytest.approx(7.4, abs=0.6)
    assert blind_um(unaware) == pytest.approx(np.hypot(blind_um(warm), by_growth_um), rel=0.15)
    assert blind_um(aware) == pytest.approx(blind_um(warm), rel=0.07)
    assert blind_um(aware) < blind_um(unaware) - 1.0
    said = told(aware)
    assert said["arms_grown_ppm"] == pytest.approx(22.0 * (said["at_C"] - 20.0))
    assert said["arms_seen_ppm"] == pytest.approx(-460.0, abs=4 * said["arms_seen_sd_ppm"])
    assert said["contradiction"] == said["why_not"] == ""


def test_a_silent_thermometer_leaves_arms_as_measured_and_says_so(maps, tmp_path, monkeypatch):
    async def silent(client, instrument):
        return Felt(None, "0 of 37 positioners tell their temperature")

    monkeypatch.setattr("fiberloom.operation.care.warm_arms.felt", silent)
    seen = observed(INVAR, maps, 0.0, tmp_path / "silent")
    unaware = observed(UNAWARE, maps, 0.0, tmp_path / "unaware")
    assert blind_um(seen) == pytest.approx(blind_um(unaware), rel=0.02)
    assert "0 of 37" in told(seen)["why_not"]
    assert temperature_line(told(seen)).startswith("arms taken as they were measured: 0 of 37")


def test_a_thermometer_that_all_agree_on_and_is_wrong_is_found_by_the_blind_move(maps, tmp_path):
    """It says 20 K more than is true, at the temperature of the calibration: without it no arm were off."""
    wrong = with_expansion(INVAR, measured_C=40.0)
    seen = observed(wrong, maps, 20.0, tmp_path / "wrong", corrections=2)
    assert "thermometers or the instrument's expansion are wrong" in told(seen)["contradiction"]
    assert "; but arms are" in temperature_line(told(seen))
    # corrections go by the camera
    assert np.nanmedian(seen.moves[-1].measured_error_um) < 1.5


def test_the_expansion_is_learnt_from_nights_within_its_sigma(maps, tmp_path):
    """The instrument knows nothing, 0 +- 30e-6; the array has 23e-6."""
    blank = with_expansion(INVAR, arms_per_K=0.0, arms_per_K_sd=30e-6)
    learnt = str(tmp_path / "learnt.sqlite")
    seen = [
        observed(blank, maps, at_C, tmp_path / "runs", field, adapt=True, learnt=learnt)
        for field, at_C in enumerate(NIGHTS_C)
    ]
    assert [told(one)["nights"] for one in seen] == [0, 0, 0, 3, 4, 5]
    true = 1e6 * TwinErrors.of(blank.instrument, "temperature").temperature.arms_per_K(SEED)
    assert true == pytest.approx(23.0)
    last = told(seen[-1])
    assert last["expansion_ppm_K"] == pytest.approx(true, abs=3.0 * last["expansion_sd_ppm_K"])
    assert last["expansion_sd_ppm_K"] < 3.0
    with Store.read(tmp_path / "runs" / "store.sqlite") as store:
        assert len(nights_of(store, blank.config_hash())) == len(NIGHTS_C)
        assert nights_of(store, "another") == []
    # without --adapt the same command gives the same bytes, whatever was observed before
    assert told(observed(blank, maps, 9.0, tmp_path / "runs"))["nights"] == 0


def test_nights_at_one_temperature_change_nothing(maps, tmp_path):
    learnt = str(tmp_path / "learnt.sqlite")
    asked = {"adapt": True, "learnt": learnt}
    for field in range(4):
        seen = observed(INVAR, maps, 8.0, tmp_path / "runs", field, **asked)
    assert (told(seen)["nights"], told(seen)["expansion_ppm_K"]) == (0, pytest.approx(22.0))


def test_learning_of_maps_and_growth_of_arms_do_not_mix(maps, tmp_path):
    """What nights in the cold teach is used in a warm one: arms are learnt as they were calibrated."""
    found = {}
    for name, plane in (("aware", INVAR), ("unaware", UNAWARE)):
        asked = {"adapt": True, "learnt": str(tmp_path / f"{name}.sqlite")}
        for field in range(4):
            observed(plane, maps, -4.0, tmp_path / name, field, **asked)
        seen = observed(plane, maps, 26.0, tmp_path / name, 9, **asked)
        found[name] = blind_um(seen)
    print(f"blind, um rms: {found}")
    assert found["aware"] < found["unaware"] - 1.0


# where arms were measured


def test_arms_of_a_survey_carry_its_temperature(maps, tmp_path):
    """Measured at 0 deg C and used there nothing grows; used at 20 they do."""
    from fiberloom.calibration.focal_plane.arms_file import ArmsFile
    from fiberloom.operation.survey import SurveySettings

    cold = fl.Field.twin(INVAR, SEED, camera="noise", errors="temperature,at_C=0", calibration=maps)
    found = cold.run.survey(SurveySettings(6, seed=SEED), out=tmp_path)
    found.save(tmp_path)
    assert ArmsFile.read(tmp_path / "arms.ecsv", INVAR).measured_C == pytest.approx(0.0, abs=0.4)
    again = cold.run.survey(
        SurveySettings(6, seed=SEED), measured=tmp_path / "store.sqlite", out=tmp_path / "b"
    )
    assert again.marks["temperature_C"] == pytest.approx(found.marks["temperature_C"], abs=1e-3)
    for at_C, ppm in ((0.0, 0.0), (20.0, 440.0)):
        seen = observed(INVAR, maps, at_C, tmp_path / "use", arms=tmp_path / "arms.ecsv")
        assert told(seen)["arms_grown_ppm"] == pytest.approx(ppm, abs=0.1)


def test_arms_of_an_unknown_temperature_are_taken_as_they_are(maps):
    warmth = WarmArms.of(INVAR, load_for(INVAR, maps), None, "layout")
    warmth.felt = Felt(0.0)
    assert warmth.growth == 0.0
    assert "was not noted" in warmth.why_not
    no_scale = INVAR.instrument.model_copy(update={"care": fl.Instrument.of("desi").care})
    deaf = dataclasses.replace(INVAR, instrument=no_scale)
    assert WarmArms.of(deaf, load_for(INVAR, maps), 20.0, "layout") is None
    assert WarmArms.of(UNAWARE, load_for(INVAR, maps), 20.0, "layout") is None
