"""Drawn units: what they leave in the focal plane, and that they are reproducible."""

from typing import get_args

import numpy as np
import pytest

from fiberloom.calibration.commissioning.backlash import BACKLASH_WAVES
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Fault, Twin, draw_units, worn
from fiberloom.twin.draw import BACKLASH_SD_DEG
from fiberloom.twin.errors.switches import GearSpectrum
from fiberloom.twin.units import ORDERS

PLANE = generate(load_instrument("sdssv"), seed=2, n_positioners=30)
UNITS = draw_units(PLANE, seed=7)
SPECTRA = {gears: draw_units(PLANE, seed=7, gears=gears) for gears in get_args(GearSpectrum)}
RANGE_DEG = ((0.0, 360.0), (0.0, 180.0))
L_ALPHA, L_BETA = 7.4, 14.3


def targets(rng, n):
    """Angles of targets spread evenly over the patrol area, deg."""
    r2 = rng.uniform((L_BETA - L_ALPHA) ** 2, (L_BETA + L_ALPHA) ** 2, n)
    bend = (r2 - L_ALPHA**2 - L_BETA**2) / (2 * L_ALPHA * L_BETA)
    return rng.uniform(0, 360, n), np.rad2deg(np.arccos(np.clip(bend, -1, 1)))


def blind_errors_um(units, row, rng, points):
    """Square error in the focal plane with a linear ratio and with a map of so many points."""
    errors = {"linear": [], "map": []}
    angles = targets(rng, 300)
    for axis in (0, 1):
        knots = np.linspace(*RANGE_DEG[axis], points)
        wire = units.transmission(row, axis, knots)[0]
        asked = units.transmission(row, axis, angles[axis])[0]
        offset = np.mean(wire - knots)  # the ratio itself is the gear's 1024
        errors["linear"].append(np.deg2rad(asked - offset - angles[axis]))
        errors["map"].append(np.deg2rad(np.interp(asked, wire, knots) - angles[axis]))
    a, b = np.deg2rad(angles)
    lever_a = L_ALPHA * np.exp(1j * a) + L_BETA * np.exp(1j * (a + b))
    lever_b = L_BETA * np.exp(1j * (a + b))
    return {k: np.abs(lever_a * e[0] + lever_b * e[1]) ** 2 * 1e6 for k, e in errors.items()}


@pytest.mark.parametrize("gears", SPECTRA)
def test_tuned_to_the_papers_blind_errors(gears):
    """TUNED: linear about 36 um, 200 points about 10 um (Kronig 2020, Fig. 19 and 26), whatever orders."""
    rng = np.random.default_rng(0)
    rows = [blind_errors_um(SPECTRA[gears], i, rng, 200) for i in range(len(UNITS))]
    rms = {k: np.sqrt(np.mean([r[k] for r in rows])) for k in ("linear", "map")}
    assert rms["linear"] == pytest.approx(36.0, rel=0.15)
    assert rms["map"] == pytest.approx(9.5, rel=0.15)  # camera and repeatability add the rest
    assert rms["linear"] / rms["map"] == pytest.approx(3.5, rel=0.25)


@pytest.mark.parametrize("gears", SPECTRA)
def test_gears_pass_acceptance(gears):
    """SDSS-V bench at 183 steps: non-linearity 0.6 deg, derivative 0.15; hysteresis 0.3 deg."""
    for row in range(len(UNITS)):
        for axis in (0, 1):
            theta = np.linspace(0, 360, 184)
            wire, backlash = SPECTRA[gears].transmission(row, axis, theta)
            delta = wire - np.polyval(np.polyfit(theta, wire, 1), theta)
            assert np.abs(delta).max() < 0.6
            assert np.abs(np.diff(delta) / np.diff(theta)).max() < 0.15
            assert (backlash / 1024).max() < 0.3


@pytest.mark.parametrize("gears", SPECTRA)
def test_backlash_of_figure_10(gears):
    units = SPECTRA[gears]
    theta = np.linspace(0, 360, 4097)
    low, high = np.array(
        [
            (b.min(), b.max())
            for i in range(len(UNITS))
            for b in [units.transmission(i, 0, theta)[1], units.transmission(i, 1, theta)[1]]
        ]
    ).T
    assert low.min() >= 39.9
    assert high.max() <= 250.1
    assert (high - low).min() > 100


def lines(units):
    """(N, orders) whether alpha's delta has that order at all."""
    return units.gear["delta_rad"][:, 0].any(axis=-1)


def test_spectra_have_the_orders_of_their_name():
    has = {gears: {int(m) for m in ORDERS[lines(units).any(axis=0)]} for gears, units in SPECTRA.items()}
    assert has["stages"] == {1, 2, 3, 35, 36, 37, 72, 108, 204}
    assert has["teeth"] == {1, 2, 3, 35, 36, 37, 71, 72, 73, 108}
    assert has["family"] == set(map(int, ORDERS))


def test_every_gear_of_the_family_has_its_own_orders():
    """72, 108 and/or 204: each is missing somewhere, never all of them; amplitudes span a factor of four."""
    some = lines(SPECTRA["family"])[:, np.isin(ORDERS, (72, 108, 204))]
    assert some.any(axis=1).all()
    assert (some.mean(axis=0) > 0.3).all()
    assert (some.mean(axis=0) < 0.95).all()
    assert len({tuple(row) for row in some}) >= 4
    teeth = np.linalg.norm(SPECTRA["family"].gear["delta_rad"][:, :, ORDERS == 36], axis=-1)
    assert teeth.max() / teeth.min() > 2.5


@pytest.mark.parametrize("gears", ["teeth", "family"])
def test_another_spectrum_is_the_same_unit_with_other_gears(gears):
    other = SPECTRA[gears]
    for name in ("plant", "arms"):
        assert getattr(other, name).tobytes() == getattr(UNITS, name).tobytes()
    # the firmware knows the backlash of its own gear
    of_gear = [n for n in UNITS.firmware.dtype.names if n.startswith("backlash")]
    for name in UNITS.firmware.dtype.names:
        assert (name in of_gear) != np.array_equal(other.firmware[name], UNITS.firmware[name]), name
    assert (other.gear["delta_rad"][..., 0, 0] != UNITS.gear["delta_rad"][..., 0, 0]).all()
    alone = draw_units(PLANE.select([17]), seed=7, gears=gears)
    assert alone.gear.tobytes() == other.gear[[17]].tobytes()
    with pytest.raises(InputError, match="gears 'worm': must be one of stages, teeth, family"):
        draw_units(PLANE.select([0]), seed=7, gears="worm")


def told_backlash(units):
    """(N, 2, 9) motor deg: the mean, then cosine and sine of each wave that the firmware was told."""
    told = units.firmware
    waves = [
        turned
        for name in BACKLASH_WAVES
        for turned in (
            told[name] * np.sin(told[f"{name}_phase"]),
            told[name] * np.cos(told[f"{name}_phase"]),
        )
    ]
    return np.stack([told["backlash"], *waves], axis=-1)


def test_the_firmware_knows_the_backlash_of_its_gear_as_maps_tell_it():
    """The mean and each wave wrong by a motor degree; or exactly."""
    gear = UNITS.gear
    waves = gear["backlash_rad"][:, :, np.isin(ORDERS, list(BACKLASH_WAVES.values()))].reshape(-1, 2, 8)
    true = np.rad2deg(np.concatenate([gear["backlash_mean_rad"][..., None], waves], axis=-1))
    exact = draw_units(PLANE, seed=7, firmware="true")
    np.testing.assert_allclose(told_backlash(exact), true, atol=1e-3)
    off = told_backlash(UNITS) - true
    assert np.sqrt(np.mean(off**2, axis=(0, 1))) == pytest.approx(np.full(9, BACKLASH_SD_DEG), rel=0.3)


def test_36_teeth_show():
    """Beyond the slow terms delta's largest lines are at 36 and the earlier stage's 204 a turn."""
    theta = np.linspace(0, 360, 4096, endpoint=False)
    power = np.mean(
        [np.abs(np.fft.rfft(UNITS.transmission(i, 0, theta)[0] - theta)) for i in range(10)], axis=0
    )
    peaks = 10 + np.argsort(-power[10:])[:2]
    assert set(peaks) == {36, 204}


def test_a_unit_depends_on_seed_and_number_alone():
    again = draw_units(PLANE.select([5, 9]), seed=7)
    for name in ("plant", "gear", "firmware", "arms"):
        assert getattr(again, name).tobytes() == getattr(UNITS.select([5, 9]), name).tobytes()
    assert draw_units(PLANE, seed=8).plant.tobytes() != UNITS.plant.tobytes()


def test_firmware_knows_its_unit_within_a_few_percent():
    ratio = UNITS.firmware["inertia"] / (UNITS.plant["inertia_motor"] + UNITS.plant["inertia_gear"])
    assert np.abs(ratio - 1).max() < 0.07
    assert np.abs(ratio - 1).max() > 0.01
    # Eq. 23: 120 motor degrees for the least collision, with the integral at its limit
    lowest = (UNITS.firmware["collision_torque"] - UNITS.firmware["integral_limit"]) / UNITS.firmware["k_p"]
    np.testing.assert_allclose(np.rad2deg(lowest), 120.0, rtol=1e-5)


def test_instruments_may_override_plant_parameters():
    instrument = PLANE.instrument.model_copy(update={"twin": {"beta": {"coulomb_gear": 4e-6}}})
    plane = type(PLANE)(**{**PLANE.__dict__, "instrument": instrument})
    stiffer = draw_units(plane.select([0]), seed=7)
    ratio = stiffer.plant["coulomb_gear"] / UNITS.plant["coulomb_gear"][:1]
    np.testing.assert_allclose(ratio, [[1.0, 4e-6 / 1.9e-6]])
    wrong = PLANE.instrument.model_copy(update={"twin": {"alpha": {"colour": 1.0}}})
    with pytest.raises(InputError, match=r"sdssv: twin\.alpha\.colour: no such plant parameter"):
        draw_units(type(PLANE)(**{**PLANE.__dict__, "instrument": wrong}), seed=7)


def test_memory_per_positioner():
    """All that is the twin's own beside the firmware's state; what a law needs only where it is wanted."""
    twin = Twin(PLANE, UNITS, threads=1)
    sound = twin._core.bytes_per_positioner
    assert 4096 < sound < 4400
    twin.inject(Fault("lying", int(PLANE.positioner_id[0])))
    assert sound < twin._core.bytes_per_positioner < sound + 10


def test_a_touch_takes_memory_while_it_lasts():
    twin = Twin(PLANE, UNITS, threads=1)
    twin.run(0.1)
    free = twin._core.bytes_per_positioner
    twin.set_external_torque(0, 0, 1e-5)
    twin.run(0.1)
    assert twin._core.bytes_per_positioner > free
    twin.set_external_torque(0, 0, 0.0)
    twin.run(0.1)
    assert twin._core.bytes_per_positioner == free


def test_wear_grows_is_local_and_moves_arms():
    """Kronig 2020, Fig. 22: local changes of delta up to 0.15 deg."""
    theta = np.linspace(0, 360, 1001)
    new, old = (UNITS.transmission(3, 0, theta)[0], worn(UNITS, 100.0).transmission(3, 0, theta)[0])
    change = np.abs(old - new)
    assert 0.03 < change.max() < 0.25
    assert np.mean(change < 0.005) > 0.25
    early = np.abs(worn(UNITS, 10.0).transmission(3, 0, theta)[0] - new)
    assert early.max() < 0.4 * change.max()
    plane, units = PLANE.select([3]), UNITS.select([3])
    place = float(theta[np.argmax(change)])
    twin = Twin(plane, units, threads=1, start_deg=(place, 90.0))
    twin.set_gear(worn(UNITS, 100.0).select([3]))
    # the rotor stands, so the arm moves by what delta changed
    assert abs(twin.truth()[0, 0] - place) == pytest.approx(change.max(), rel=0.25)
