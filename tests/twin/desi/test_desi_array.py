"""The twin's array through its frames: where arms go, what controllers say, what stops and faults do."""

import numpy as np
import pytest

from fiberloom.drive.desi import DesiCommand, DesiFrame, checksum, encode_row, move_tables
from fiberloom.drive.desi.frames import POSITIONERS, rows_of, table_frames
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.desi import PERFECT_ARMS, PUBLISHED_FAULTS, DesiTwin, draw_desi_units
from fiberloom.twin.desi.motion import TURN_DEG

START = (10.0, 150.0)


@pytest.fixture(scope="module")
def plane():
    return generate(load_instrument("desi"), seed=0, n_positioners=37)


def loaded(twin, tables):
    ids = twin.plane.positioner_id.tolist()
    return twin.send([f for row, k in enumerate(ids) for f in table_frames(k, rows_of(tables, row))])


def run(twin, ways, now=b"\x01"):
    tables = move_tables(ways)
    loaded(twin, tables)
    twin.send([DesiFrame.of(POSITIONERS, DesiCommand.RUN, now)])
    twin.run(float(tables.duration_s.max()))
    return twin.truth()


def test_a_table_goes_where_the_gear_lets_it(plane):
    twin = DesiTwin(plane, seed=3, start_deg=START)
    before = twin.truth()
    rng = np.random.default_rng(0)
    ways = np.column_stack([rng.uniform(-120, 120, 37), rng.uniform(-100, 20, 37)])
    after = run(twin, ways)
    gears = twin.units.gears
    gear = gears.gear_deg(before[:, None])
    want = gears.output_deg(gear + ways[:, None])[:, 0]
    # a tenth of a motor degree, and 0.02 deg of scatter
    assert np.abs(after - want).max() < 4.5 * 0.02
    assert 0.3 < (after - before - ways).std() < 0.9


def test_the_backlash_is_closed_whatever_way_a_move_comes(plane):
    ends = []
    for first in (40.0, -40.0):
        units = draw_desi_units(plane, 3)
        twin = DesiTwin(plane, units, seed=3, start_deg=START, contacts=False)
        run(twin, np.column_stack([np.full(37, first), np.full(37, -30.0)]))
        ends.append(run(twin, np.column_stack([np.full(37, -first), np.full(37, 30.0)])))
    assert np.abs(ends[0] - ends[1]).max() < 6 * 0.02


def test_controllers_answer_with_the_checksum_of_what_they_hold(plane):
    twin = DesiTwin(plane, seed=0, start_deg=START, contacts=False)
    tables = move_tables(np.tile([20.0, -5.0], (37, 1)))
    replies = loaded(twin, tables)
    want = checksum([encode_row(row) for row in rows_of(tables, 0)])
    assert [int.from_bytes(r.data, "big") for r in replies] == [want] * 37
    assert sorted(r.can_id for r in replies) == sorted(plane.positioner_id.tolist())


def status(twin, can_id):
    return twin.send([DesiFrame.of(can_id, DesiCommand.MOVE_STATUS)])[0].data[0]


def test_status_says_moving_until_the_table_has_ended(plane):
    twin = DesiTwin(plane, seed=0, start_deg=START, contacts=False)
    one = int(plane.positioner_id[0])
    tables = move_tables(np.tile([20.0, -5.0], (37, 1)))
    loaded(twin, tables)
    assert status(twin, one) == 0
    twin.send([DesiFrame.of(POSITIONERS, DesiCommand.RUN, b"\x00")])
    assert status(twin, one) == 0  # waits for the signal
    twin.sync()
    assert status(twin, one) == 1
    twin.run(float(tables.duration_s[0]) / 2)
    assert status(twin, one) == 1
    twin.run(float(tables.duration_s[0]) / 2 + 1e-6)
    assert status(twin, one) == 0


def test_a_stop_leaves_arms_where_they_are(plane):
    twin = DesiTwin(plane, seed=0, start_deg=START, contacts=False)
    tables = move_tables(np.tile([-2.0, 2.0], (37, 1)))  # where the play is closed
    loaded(twin, tables)
    twin.send([DesiFrame.of(POSITIONERS, DesiCommand.RUN, b"\x01")])
    twin.run(0.5)
    here = twin.truth()
    twin.send([DesiFrame.of(POSITIONERS, DesiCommand.STOP)])
    np.testing.assert_allclose(twin.truth(), here, atol=1e-9)
    twin.run(5.0)
    np.testing.assert_allclose(twin.truth(), here, atol=1e-9)
    # half a second of 2.668 deg/s, and a gear that is straight to a tenth
    assert np.abs(here - START - np.array([-1.33, 1.33])).max() < 0.2


def test_an_incomplete_table_does_not_run(plane):
    twin = DesiTwin(plane, seed=0, start_deg=START, contacts=False)
    one = int(plane.positioner_id[0])
    twin.send(table_frames(one, rows_of(move_tables([[5.0, 0.0]]), 0))[:2])
    before = twin.truth()
    twin.send([DesiFrame.of(one, DesiCommand.RUN, b"\x01")])
    twin.run(5.0)
    np.testing.assert_array_equal(twin.truth(), before)


def test_units_that_hear_nothing_for_a_minute_are_in_standby(plane):
    twin = DesiTwin(plane, seed=0, start_deg=START, contacts=False)
    twin.run(61.0)
    before = twin.truth()
    run(twin, np.tile([20.0, -5.0], (37, 1)))
    np.testing.assert_array_equal(twin.truth(), before)
    twin.send([DesiFrame.of(POSITIONERS, DesiCommand.RESET)])
    after = run(twin, np.tile([20.0, -5.0], (37, 1)))
    assert np.all(np.abs(after - before)[:, 0] > 15.0)


def test_beyond_a_stop_whole_motor_turns_are_lost(plane):
    twin = DesiTwin(plane, draw_desi_units(plane, 0, PERFECT_ARMS), seed=0, contacts=False)
    low = plane.hard_stops_deg[0, 0]
    for way in (-300.0, -100.0):
        run(twin, np.tile([way, 0.0], (37, 1)))
    stood = twin._state.rotor_deg[:, 0]
    assert np.all(stood >= low - TURN_DEG)
    lost = (stood - (twin_start_rotor(plane) - 400.0)) / TURN_DEG
    assert np.all(lost > 100)
    # the counts of the tables are whole tenths of a motor degree
    assert np.abs(lost - np.rint(lost)).max() < 0.01


def twin_start_rotor(plane):
    return DesiTwin(plane, draw_desi_units(plane, 0, PERFECT_ARMS), seed=0, contacts=False)._state.rotor_deg[
        :, 0
    ]


def test_broken_units_do_what_is_published():
    plane = generate(load_instrument("desi"), seed=0, n_positioners=3000)
    units = draw_desi_units(plane, 0, PUBLISHED_FAULTS)
    assert 0.06 < units.stuck.mean() < 0.095
    assert 0.05 < units.linear[:, 0].mean() < 0.08
    assert 0.03 < units.linear[:, 1].mean() < 0.06
    twin = DesiTwin(plane, units, seed=1, start_deg=START, contacts=False)
    before = twin.truth()
    moved = np.abs(run(twin, np.tile([30.0, -40.0], (3000, 1))) - before)
    assert moved[units.stuck].max() < 1e-12
    phi = units.linear[:, 1] & ~units.stuck
    still = moved[phi, 1] < 1.0
    assert 0.08 < still.mean() < 0.25
    assert 0.6 < np.median(moved[phi, 1][~still]) / 40.0 < 0.9


def test_a_camera_sees_the_array(plane):
    twin = DesiTwin(plane, seed=0, start_deg=START, contacts=False)
    image = NoiseCamera(twin, 3.0, seed=1).measure()
    off = np.hypot(image.x_mm - twin.fibre_xy()[:, 0], image.y_mm - twin.fibre_xy()[:, 1])
    assert 0.0 < off.max() < 0.02


def test_units_of_another_plane_are_refused(plane):
    other = generate(load_instrument("desi"), seed=0, n_positioners=7)
    with pytest.raises(InputError, match="7 units for 37 positioners"):
        DesiTwin(plane, draw_desi_units(other, 0))
