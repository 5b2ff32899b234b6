"""Power comes on: no datum is on record, and some counters are off by whole motor turns."""

import struct

import numpy as np
import pytest
from benchmarks.array.datum import measured

from fiberloom.bus.identifier import decode, encode
from fiberloom.bus.protocol import Command, Response, Status
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane, Instrument, generate, load_instrument
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.errors.sizes import NO_ERRORS, TwinErrors
from fiberloom.twin.hardware import field_hardware, power_up
from fiberloom.units import COUNTS_PER_DEG

PLANE = generate(load_instrument("sdssv"), 0, n_positioners=7)
UNITS = draw_units(PLANE, 0)
IDS = PLANE.positioner_id.tolist()
TURN_DEG = 360.0 / 1024.0


def asked(twin, command, data=b""):
    """By number, code and data of the answer of each positioner."""
    twin.send([(encode(number, command, 3), data) for number in IDS])
    replies = twin.run(0.01)
    return {decode(r.id).positioner: (decode(r.id).code, r.data) for r in replies}


def reported_deg(twin):
    answers = asked(twin, Command.GET_ACTUAL_POSITION)
    return np.array([struct.unpack("<ii", answers[number][1]) for number in IDS]) / COUNTS_PER_DEG


def bits(twin):
    return [Status(int.from_bytes(data, "little")) for _, data in asked(twin, Command.GET_STATUS).values()]


def goto(twin, place_deg):
    counts = [round(deg * COUNTS_PER_DEG) for deg in place_deg]
    asked(twin, Command.GO_TO_ABSOLUTE_POSITION, struct.pack("<ii", *counts))
    twin.run(25.0)


def declare(twin, place_deg):
    """Tells every positioner its place, (7, 2) in wire degrees."""
    for number, deg in zip(IDS, place_deg, strict=True):
        data = struct.pack("<ii", *(round(d * COUNTS_PER_DEG) for d in deg))
        twin.send([(encode(number, Command.SET_ACTUAL_POSITION, 4), data)])
    twin.run(0.01)


def test_the_counter_is_off_by_whole_turns_and_the_firmware_says_what_it_knows():
    twin = Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False)
    before_deg, true_deg = reported_deg(twin), twin.truth()
    assert all(Status.DATUMS_INITIALIZED in b for b in bits(twin))
    turns = {number: (k - 3, 3 - 2 * k) for k, number in enumerate(IDS)}
    for number in IDS:
        twin.power_up(number, turns[number])
    assert not any(
        Status.DATUM_ALPHA_INITIALIZED in b or Status.DATUM_BETA_INITIALIZED in b for b in bits(twin)
    )
    assert all(Status.POSITION_RESTORED in b and Status.ESTIMATED_POSITION not in b for b in bits(twin))
    off_deg = reported_deg(twin) - before_deg
    np.testing.assert_allclose(off_deg, np.array(list(turns.values())) * TURN_DEG, atol=2.0 / COUNTS_PER_DEG)
    np.testing.assert_array_equal(twin.truth(), true_deg)
    # and without a datum nothing moves
    codes = {
        code for code, _ in asked(twin, Command.GO_TO_RELATIVE_POSITION, struct.pack("<ii", 0, 0)).values()
    }
    assert codes == {Response.DATUM_NOT_INITIALIZED}


def test_what_is_declared_takes_the_place_of_what_was_reported():
    """The rotor has fallen inside the backlash by then: 20 um at the fibre, if that were taken for the place.

    The same wire position, from the same side, is the same place as before: within the seat of the gear.
    """
    twin = Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False, start_deg=(40.0, 120.0))
    goto(twin, (60.0, 100.0))
    goto(twin, (50.0, 90.0))
    before_deg, reported = twin.truth(), reported_deg(twin)
    declare(twin, reported + np.array([3.0, -2.0]) * TURN_DEG)
    np.testing.assert_allclose(
        reported_deg(twin) - reported, np.tile([3.0, -2.0], (7, 1)) * TURN_DEG, atol=1e-6
    )
    # another way, on which the turns are taken back at rest
    declare(twin, reported)
    goto(twin, (60.0, 100.0))
    goto(twin, (50.0, 90.0))
    assert np.abs(twin.truth() - before_deg).max() < 0.01


def test_a_datum_search_puts_right_what_power_up_has_lost():
    twin = Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False, start_deg=(6.0, 8.0))
    goto(twin, (10.0, 12.0))
    goto(twin, (8.0, 10.0))
    before_deg = twin.truth()
    for k, number in enumerate(IDS):
        twin.power_up(number, (k - 3, k % 3 - 1))
    asked(twin, Command.GO_TO_DATUMS)
    twin.run(60.0)
    assert all(Status.DATUMS_INITIALIZED in b and Status.POSITION_RESTORED not in b for b in bits(twin))
    goto(twin, (10.0, 12.0))
    goto(twin, (8.0, 10.0))
    # a turn would be 0.35 deg
    assert np.abs(twin.truth() - before_deg).max() < 0.02


def test_a_search_repeats_by_the_hall_sensors_wherever_the_rotor_comes_to_stand():
    """By `benchmarks/array/datum.py`. The stop alone would say it within tens of motor degrees."""
    for figures in measured(units=10, searches=4, seed=0).values():
        # two places of the cogging are a quarter of a turn apart; half a turn would be another zero
        assert 5.0 < figures["standstill_worst_deg"] < 90.0
        assert figures["turns_off"] == 0
        # hall noise: 3 counts of an amplitude of 1500
        assert figures["zero_rms_deg"] < 0.5


def test_one_in_twenty_is_off_each_by_its_seed_and_number_alone():
    errors = TwinErrors.of(PLANE.instrument, "power")
    drawn = np.array([errors.turns_lost(number, 5) for number in range(1, 4001)])
    off = drawn.any(axis=1)
    assert off.mean() == pytest.approx(0.05, abs=0.01)  # three sigma of 4000
    assert np.abs(drawn).max() == 5
    both = (drawn[off] != 0).all(axis=1).mean()
    assert both == pytest.approx(0.25, abs=0.1)
    assert abs(drawn[off].sum(axis=0)).max() < 0.4 * off.sum()  # either way
    more = np.array([TwinErrors.of(PLANE.instrument, "power=2").turns_lost(n, 5) for n in range(1, 4001)])
    np.testing.assert_array_equal(more[off], drawn[off])
    assert more.any(axis=1).mean() == pytest.approx(0.1, abs=0.015)
    assert not np.any([TwinErrors.of(PLANE.instrument, "all,power=0").turns_lost(n, 5) for n in range(200)])


def test_the_operator_has_no_datum_on_record_and_without_the_term_every_one():
    errors = TwinErrors.of(PLANE.instrument, "power")
    assert not field_hardware(PLANE, UNITS, 0, errors=errors).vouched.any()
    on = field_hardware(PLANE, UNITS, 0, errors=NO_ERRORS)
    assert on.vouched.all()
    assert all(Status.DATUMS_INITIALIZED in b and Status.POSITION_RESTORED not in b for b in bits(on.truth))


def test_the_reports_of_a_field_are_off_by_whole_turns_of_either_axis():
    """`power=20` takes all: each report misses the arm by 1 to 5 turns of alpha, of beta, or of both."""
    on = field_hardware(PLANE, UNITS, 0, errors=NO_ERRORS)
    lost = field_hardware(PLANE, UNITS, 0, errors=TwinErrors.of(PLANE.instrument, "power=20"))
    np.testing.assert_array_equal(lost.truth.truth(), on.truth.truth())  # arms stay where they are
    turns = (reported_deg(lost.truth) - reported_deg(on.truth)) / TURN_DEG
    np.testing.assert_allclose(turns, np.rint(turns), atol=2.0 / COUNTS_PER_DEG / TURN_DEG)
    assert np.rint(turns).any(axis=1).all()
    assert np.abs(turns).max() < 5.5


def test_without_the_term_not_a_bit_is_another():
    def after(errors):
        twin = Twin(PLANE, UNITS, seed=1, threads=1)
        power_up(twin, errors, 0)
        goto(twin, (60.0, 150.0))
        return twin.truth(), reported_deg(twin)

    plain, off = after(NO_ERRORS), after(TwinErrors.of(PLANE.instrument, "all,power=0"))
    np.testing.assert_array_equal(plain, off)


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [("power_share", 1.5, "0 to 1"), ("power_share", True, "0 to 1"), ("power_turns", 6, "1 to 5"),
     ("power_turns", 2.0, "1 to 5"), ("power_share", "some", "0 to 1")],
)  # fmt: skip
def test_a_size_that_cannot_be_is_refused(key, value, told):
    table = PLANE.instrument.model_dump()
    table["twin"] = {"errors": {key: value}}
    with pytest.raises(InputError, match=rf"twin.errors.{key}.*{told}"):
        TwinErrors.of(Instrument.model_validate(table))


def test_a_size_that_is_told_is_used():
    plane = FocalPlane.of("sdssv", n=7)
    table = plane.instrument.model_dump()
    table["twin"] = {"errors": {"power_share": 1.0, "power_turns": 1}}
    errors = TwinErrors.of(Instrument.model_validate(table), "power")
    drawn = np.array([errors.turns_lost(number, 0) for number in range(50)])
    assert drawn.any(axis=1).all()
    assert np.abs(drawn).max() == 1
    assert "100 % of the positioners" in errors.told(plane)["power-up"]
    assert NO_ERRORS.told(plane)["power-up"] == "every datum is on record"
