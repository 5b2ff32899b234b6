"""What is off its tables: sizes as measured, each can be switched, and the same unit in any company."""

import dataclasses

import numpy as np
import pytest
from benchmarks.tables import of_fiducials, sizes

from fiberloom.errors import InputError
from fiberloom.instruments import METROLOGY, FocalPlane, Instrument
from fiberloom.twin import draw_units
from fiberloom.twin.draw import put_in
from fiberloom.twin.errors import loads, temperature
from fiberloom.twin.errors import sizes as sizes_of
from fiberloom.twin.errors.frame import WrongFrame
from fiberloom.twin.errors.sizes import FREEDOM, NO_ERRORS, TwinErrors, heavy
from fiberloom.twin.errors.switches import factors_of

SDSSV = FocalPlane.of("sdssv")
ALL = TwinErrors.of(SDSSV.instrument)


def rms(values):
    return np.sqrt(np.nanmean(np.square(values)))


def off_um(errors, seed=0, plane=SDSSV):
    """Truth less table: arms, and each fibre along and across."""
    exact, built = draw_units(plane, seed), draw_units(plane, seed, errors=errors)
    fibres = {name: 1e3 * mm for name, mm in built.fibre_offset_mm.items()}
    return {
        "alpha": 1e3 * (built.arms[:, 2] - exact.arms[:, 2]),
        "beta": 1e3 * built.beta_longer_mm,
        **fibres,
    }


def test_sizes_of_the_preset_are_those_of_two_real_tables(shared_sdssv):
    found = sizes(shared_sdssv)
    assert found["robots in both tables"]["number"] == 461
    measured = [found[name]["rms"] for name in ("alpha arm", "metrology fibre, along")]
    assert ALL.arm_um == pytest.approx(measured, rel=0.01)
    for fibre in ("BOSS", "APOGEE"):
        measured = [found[f"{fibre}, {way}"]["rms"] for way in ("along", "across")]
        assert ALL.fibre_um[fibre] == pytest.approx(measured, rel=0.01)
    assert ALL.fiducial_um == pytest.approx(found["fiducials, each coordinate"]["median"], rel=0.02)


def test_units_are_off_by_these_sizes():
    drawn = [off_um(ALL, seed) for seed in range(6)]
    found = {name: rms(np.concatenate([one[name] for one in drawn])) for name in ("alpha", "beta")}
    assert found == pytest.approx({"alpha": 10.9, "beta": 13.3}, rel=0.08)
    for fibre, size in ALL.fibre_um.items():
        per_axis = rms(np.concatenate([one[fibre] for one in drawn])[:, 0]), rms(
            np.concatenate([one[fibre] for one in drawn])[:, 1])  # fmt: skip
        assert per_axis == pytest.approx(size, rel=0.08)


def test_tails_are_heavier_than_a_gaussian_s():
    drawn = np.abs(heavy(np.random.default_rng(0), 200_000))
    assert rms(drawn) == pytest.approx(1.0, abs=0.02)
    assert np.median(drawn) == pytest.approx(0.727 / np.sqrt(FREEDOM / (FREEDOM - 2.0)), abs=0.01)


def test_each_can_be_switched_and_scaled():
    terms = ("arm", "fibre", "fiducial", "air", "power", "temperature", "gravity", "torque", "pointing")
    every = dict.fromkeys(terms, 1.0)
    assert factors_of("all") == every
    assert factors_of("") == factors_of("none") == dict.fromkeys(every, 0.0)
    assert factors_of("all, fibre=2") == every | {"fibre": 2.0}
    assert TwinErrors.of(SDSSV.instrument, "air=2") == dataclasses.replace(
        TwinErrors.of(SDSSV.instrument, "none"), air_um=2.0 * ALL.air_um
    )
    once, twice = off_um(ALL.at_calibration()), off_um(TwinErrors.of(SDSSV.instrument, "fibre=2"))
    assert not twice["alpha"].any()
    np.testing.assert_allclose(twice["BOSS"], 2.0 * once["BOSS"])
    assert TwinErrors.of(SDSSV.instrument, "none") == dataclasses.replace(
        NO_ERRORS, fibre_um=dict.fromkeys(ALL.fibre_um, (0.0, 0.0))
    )


def test_gears_can_be_of_another_spectrum():
    plane = FocalPlane.of("sdssv", n=7)
    errors = TwinErrors.of(plane.instrument, "all, gears=family")
    assert errors == dataclasses.replace(ALL, gears="family")
    drawn = draw_units(plane, 0, errors=errors)
    assert drawn.gear.tobytes() == draw_units(plane, 0, errors=ALL, gears="family").gear.tobytes()
    assert drawn.gear.tobytes() != draw_units(plane, 0, errors=ALL).gear.tobytes()
    assert "lines of its own" in put_in(plane, errors=errors)["gear non-linearity"]
    assert "0.100 / 0.146 deg once a turn" in put_in(plane, errors=ALL)["gear non-linearity"]
    teeth = TwinErrors.of(plane.instrument, "gears=teeth")
    assert "0.034 deg at the 36" in put_in(plane, errors=teeth)["gear non-linearity"]


@pytest.mark.parametrize(
    "text", ["fibres", "fibre=", "fibre=x", "fibre=-1", "arm=nan", "arm=1000", "gears", "gears=worm"]
)
def test_bad_switches_are_refused(text):
    with pytest.raises(InputError, match="--errors"):
        TwinErrors.of(SDSSV.instrument, text)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"arm": 1.0}, "twin.errors.arm: no such key"),
        ({"arm_um": 3.0}, "twin.errors.arm_um = 3.0: must be two numbers"),
        ({"fibre_um": {"BOSS": [1.0, -1.0]}}, "must be 0 to 1000 um"),
        ({"fiducial_um": True}, "must be 0 to 1000 um"),
        ({"air_um": -1.0}, "twin.errors.air_um = -1.0: must be 0 to 1000 um"),
    ],
)
def test_bad_tables_of_an_instrument_are_refused(table, words):
    instrument = Instrument.of("sdssv").model_copy(update={"twin": {"errors": table}})
    with pytest.raises(InputError, match=words):
        TwinErrors.of(instrument)


def test_a_unit_is_the_same_in_any_company():
    few = FocalPlane.of("sdssv", n=7)
    rows = SDSSV.index_of(few.positioner_id)
    for name, values in off_um(ALL, plane=few).items():
        np.testing.assert_array_equal(values, off_um(ALL)[name][rows], err_msg=name)
    assert draw_units(few, 0, errors=ALL).digest() != draw_units(few, 0).digest()


def test_what_is_put_in_is_told():
    told = put_in(SDSSV, errors=ALL)
    assert "APOGEE 16.1 along and 5.1 um across" in told["science fibres against the metrology fibre"]
    assert "8 um rms per coordinate" in told["fiducials against their table"]
    assert "1.5 um rms per coordinate" in told["air before the camera"]


def test_no_two_terms_share_their_random_numbers():
    streams = [sizes_of._STREAM, sizes_of._POWER_STREAM, loads._STREAM, temperature._STREAM]
    assert len(set(streams)) == len(streams)


# fiducials


def test_wrong_fiducials_move_every_fibre_by_the_same_in_every_image():
    fibres_mm = SDSSV.forward(40.0, 90.0, METROLOGY)
    frame = WrongFrame(SDSSV, ALL.fiducials_mm(SDSSV, 0))
    np.testing.assert_array_equal(frame.seen_mm(fibres_mm), frame.seen_mm(fibres_mm))
    (found,) = of_fiducials(seeds=20).values()
    # 17 terms on 61 fiducials: 4.2 um at the fiducials; fibres are within them
    assert found["rms"] == pytest.approx(3.3, rel=0.1)
    assert found["rms"] < 8.0 * np.sqrt(17 / len(SDSSV.fiducials))


def test_right_fiducials_change_nothing():
    table = TwinErrors.of(SDSSV.instrument, "none").fiducials_mm(SDSSV, 0)
    np.testing.assert_array_equal(table, SDSSV.fiducials[:, :2])
    xy = np.array([[3.0, 4.0]])
    assert WrongFrame(SDSSV, table).seen_mm(xy) is xy
