"""Rows against the published clock: by hand, and for any way."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.drive.desi import executed_path, move_tables
from fiberloom.drive.desi.clock import (
    APPROACH_STEPS,
    CRUISE_TENTHS,
    SPIN_TENTHS,
    TENTHS_PER_DEG,
    TICK_HZ,
    tenths_of,
)
from fiberloom.drive.desi.paths import PATH_ERROR_DEG
from fiberloom.drive.desi.tables import MoveTables, row_ticks
from fiberloom.errors import InputError

ways = st.tuples(st.floats(-392.0, 392.0), st.floats(-191.0, 191.0))
legs = st.lists(ways, min_size=1, max_size=3)


def test_the_published_figures():
    assert APPROACH_STEPS == 10121
    assert SPIN_TENTHS == 6732  # 673.2 motor deg
    assert round(TENTHS_PER_DEG / 10, 3) == 337.359


def test_a_correction_of_half_a_degree_by_hand():
    table = move_tables([[0.5, -0.5]])
    # 0.5 deg are 1686.8 tenths; both overshoot against their final direction and creep back
    assert table.steps[0].tolist() == [[1687, -1687], [10121, -10121], [-10121, 10121]]
    assert not table.cruise.any()
    assert table.ticks[0].tolist() == [2 * 1687, 2 * 10121, 2 * 10121]
    assert table.duration_s[0] == pytest.approx(0.187 + 2 * 1.125, abs=2e-3)


@pytest.mark.parametrize(("way_deg", "cruises"), [(4.52, False), (4.53, True), (-4.52, False), (-4.53, True)])
def test_cruise_only_above_4_52_deg(way_deg, cruises):
    assert move_tables([[way_deg, 0.0]]).cruise[0, 0].tolist() == [cruises, False]


def test_a_cruise_by_hand():
    table = move_tables([[100.0, 0.0]])
    tenths = round(100.0 * TENTHS_PER_DEG)  # 337359
    ticks = round((tenths - 2 * 6732) / 33)
    rest = tenths - 2 * 6732 - 33 * ticks
    assert abs(rest) <= 16
    assert table.steps[0, :, 0].tolist() == [ticks, 10121, -10121 + rest]
    assert table.ticks[0, 0] == 2 * 33 * 12 + ticks
    # 176 deg/s: 100 deg in 0.568 s and two ramps that cost half their 22 ms each
    assert table.ticks[0, 0] / TICK_HZ == pytest.approx(100.0 / 176.07 + 0.022, abs=1e-3)


@given(st.lists(legs, min_size=1, max_size=4))
def test_every_table_ends_where_it_shall_and_from_the_right_side(units):
    most = max(map(len, units))
    wanted = np.zeros((len(units), most, 2))
    for k, unit in enumerate(units):
        wanted[k, : len(unit)] = unit
    table = move_tables(wanted, moving=np.ones(len(units), dtype=bool))
    total = tenths_of(wanted.sum(axis=1))
    assert np.abs(table.way_tenths.sum(axis=1) - total).max() <= 1  # sums of floats
    last = table.steps[:, -1]
    assert np.all(last[:, 0] < 0)
    assert np.all(last[:, 1] > 0)
    assert not table.cruise[:, -1].any()


@given(legs)
def test_the_path_goes_where_the_rows_go(unit):
    table = move_tables([unit], pause_ms=7, moving=[True])
    path = executed_path(table)
    assert np.all(np.diff(path.tick[0]) >= 0)
    assert path.tick[0, -1] == table.ticks[0].sum()
    ends = np.cumsum(table.ticks[0])
    np.testing.assert_array_equal(path.at(ends)[0], np.cumsum(table.way_tenths[0], axis=0))


def field_tick_by_tick(steps, cruise):
    """One motor's row, from the definition: tenths after every tick."""
    if not cruise:
        return np.repeat(np.arange(abs(steps) + 1), 2)[1:-1] * np.sign(steps)
    up = np.repeat(np.arange(1, CRUISE_TENTHS + 1), 12)
    speeds = np.concatenate([up, np.full(abs(steps), CRUISE_TENTHS), up[::-1]])
    return np.sign(steps) * np.cumsum(speeds)


@given(st.floats(-392.0, 392.0).filter(lambda way: abs(way) > 0.01))
def test_the_path_is_the_field_to_the_tolerance_it_says(way_deg):
    table = move_tables([[way_deg, 0.0]])
    steps, cruise = int(table.steps[0, 0, 0]), bool(table.cruise[0, 0, 0])
    field = field_tick_by_tick(steps, cruise)
    at = executed_path(table).at(np.arange(1, len(field) + 1))[0, :, 0]
    assert np.abs(at - field).max() / TENTHS_PER_DEG < PATH_ERROR_DEG
    assert at[-1] == pytest.approx(field[-1])


def test_who_does_not_move_has_no_table():
    table = move_tables([[0.0, 0.0], [1.0, 0.0]])
    assert table.rows.tolist() == [0, 3]
    assert table.duration_s[0] == 0.0


def test_pauses_wait():
    short, long = move_tables([[1.0, 1.0]]), move_tables([[1.0, 1.0]], pause_ms=250)
    assert long.duration_s[0] - short.duration_s[0] == pytest.approx(0.25)


def test_ticks_of_ways():
    assert row_ticks([0, 1687, 337359]).tolist() == [0, 3374, 792 + round((337359 - 13464) / 33)]


@pytest.mark.parametrize(
    ("steps", "cruise", "pause", "told"),
    [(2**20, False, 0, "1048575 steps"), (0, True, 0, "no direction"), (5, False, 70000, "65535 ms")],
)
def test_rows_that_no_motor_can_run_are_refused(steps, cruise, pause, told):
    with pytest.raises(InputError, match=f"unit 0, row 0.*{told}"):
        MoveTables(np.array([[[steps, 0]]]), np.array([[[cruise, False]]]), np.array([[pause]]))


def test_ways_that_are_no_numbers_are_refused():
    with pytest.raises(InputError, match="finite"):
        move_tables([[np.nan, 0.0]])


@pytest.mark.parametrize("shape", [(1, 1, 3), (1, 2)])
def test_rows_of_other_than_two_motors_are_refused(shape):
    with pytest.raises(InputError, match=r"\(N, R, 2\) twice"):
        MoveTables(np.ones(shape, dtype=int), np.zeros(shape, dtype=bool), np.zeros(shape[:2], dtype=int))
