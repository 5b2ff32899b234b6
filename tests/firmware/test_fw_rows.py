"""The law of move tables against its definition, and against the path that the host has of a table."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiberloom._core import firmware as fw
from fiberloom.drive.desi import executed_path, move_tables
from fiberloom.drive.desi.clock import CREEP_TICKS, CRUISE_TENTHS, PAUSE_TICKS, RAMP_TICKS, TENTHS_PER_DEG
from fiberloom.drive.desi.paths import PATH_ERROR_DEG

CONFIG = np.array([CREEP_TICKS, CRUISE_TENTHS, RAMP_TICKS, PAUSE_TICKS], np.uint32)
STILL, CREEP, UP, CRUISE, DOWN = range(5)
ways = st.tuples(st.floats(-392.0, 392.0), st.floats(-191.0, 191.0))


def wire_rows(table):
    """(n, R, 5) as the law takes tables."""
    return np.concatenate([table.steps, table.cruise, table.pause_ms[..., None]], axis=2).astype(np.int32)


def test_a_creep_is_one_tenth_each_second_tick():
    trace = fw.rows_trace(CONFIG, np.array([[3, -2, 0, 0, 0]], np.int32), 8)
    assert trace[:, 0].tolist() == [0, 1, 1, 2, 2, 3, 3, 3]
    assert trace[:, 1].tolist() == [0, -1, -1, -2, -2, -2, -2, -2]
    assert trace[:, 2].tolist() == [CREEP] * 6 + [STILL] * 2


def test_a_cruise_spins_up_and_down_by_the_published_steps():
    trace = fw.rows_trace(CONFIG, np.array([[-60, 0, 1, 0, 0]], np.int32), 900)
    speed = np.diff(trace[:, 0], prepend=0)
    up = np.repeat(np.arange(1, 34), 12)
    assert (-speed[:852]).tolist() == [*up, *[33] * 60, *up[::-1]]
    assert not speed[852:].any()
    assert trace[-1, 0] == -(2 * 6732 + 60 * 33)
    assert trace[[0, 395, 396, 455, 456, 851, 852], 2].tolist() == [UP, UP, CRUISE, CRUISE, DOWN, DOWN, STILL]


def test_a_pause_waits_between_rows():
    trace = fw.rows_trace(CONFIG, np.array([[1, 0, 0, 0, 2], [1, 0, 0, 0, 0]], np.int32), 45)
    # 2 ticks of creep, 2 ms of 18 ticks, 2 ticks
    assert np.flatnonzero(np.diff(trace[:, 0], prepend=0)).tolist() == [1, 39]


@given(st.lists(st.lists(ways, min_size=2, max_size=2), min_size=1, max_size=5), st.integers(0, 40))
def test_rows_end_where_and_when_the_host_says(units, pause_ms):
    table = move_tables(units, pause_ms, moving=np.ones(len(units), dtype=bool))
    ends = fw.rows_ends(CONFIG, wire_rows(table))
    np.testing.assert_array_equal(ends[..., :2], np.cumsum(table.way_tenths, axis=1))
    np.testing.assert_array_equal(ends[..., 2], np.cumsum(table.ticks, axis=1))


@given(ways, ways)
@settings(max_examples=30)
def test_the_path_of_the_host_is_the_field_to_the_tolerance_it_says(first, second):
    table = move_tables([[first, second]], 1, moving=[True])
    path = executed_path(table)
    ticks = np.arange(1, int(path.tick[0, -1]) + 1)
    trace = fw.rows_trace(CONFIG, wire_rows(table)[0], len(ticks))
    assert np.abs(trace[:, :2] - path.at(ticks)[0]).max() < PATH_ERROR_DEG * TENTHS_PER_DEG


def test_an_ended_table_holds_its_fields_and_an_empty_one_is_done():
    assert fw.rows_trace(CONFIG, np.zeros((2, 5), np.int32), 3).tolist() == [[0, 0, 0, 0]] * 3
    assert fw.rows_ends(CONFIG, np.zeros((1, 2, 5), np.int32)).tolist() == [[[0, 0, 0], [0, 0, 0]]]


@pytest.mark.parametrize("row", [[2**20, 0, 0, 0, 0], [0, 0, 0, 0, 70000]])
def test_rows_that_do_not_fit_are_refused(row):
    with pytest.raises(ValueError, match=r"below 2\^20|65535"):
        fw.rows_trace(CONFIG, np.array([row], np.int32), 1)
