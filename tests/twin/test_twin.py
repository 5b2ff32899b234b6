"""The whole twin: firmware in the loop, bytes that repeat, rest that costs nothing."""

import asyncio

import numpy as np
import pytest
from wire import STATUS, commands, counts, goto, start, upload

from fiberloom.bus.identifier import decode, encode
from fiberloom.bus.protocol import Status
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Fault, NoiseCamera, Twin, TwinTransport, draw_units
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.faults.schedule import ScheduledFault
from fiberloom.twin.twin import ADAPTIVE

PLANE = generate(load_instrument("sdssv"), seed=5, n_positioners=20)
UNITS = draw_units(PLANE, seed=11)
IDS = [int(i) for i in PLANE.positioner_id]


def make(**options):
    options = {"seed": 3, "threads": 1, "neighbours": False, "start_deg": (40.0, 120.0)} | options
    return Twin(PLANE, UNITS, **options)


def move_all(twin, duration_s=1.2):
    rng = np.random.default_rng(0)
    for number, (a, b) in zip(IDS, rng.uniform(-5, 5, (len(IDS), 2)), strict=True):
        goto(twin, number, 40 + a, 120 + b)
    return twin.run(duration_s)


def bytes_of(twin, replies):
    return repr(replies).encode() + twin.truth().tobytes()


def test_positioners_go_where_they_are_told():
    twin = make()
    for number in IDS:
        goto(twin, number, 45.0, 112.0)
    twin.run(2.5)
    # a linear ratio and, on alpha, positive contact: delta and B/n of Fig. 10, in deg
    error = twin.truth() - [45.0, 112.0]
    assert np.abs(error).max() < 0.6
    assert np.abs(error).max() > 0.02
    # the motor itself is where it was told to be, to the settle tolerance
    wire = [[UNITS.transmission(i, k, twin.truth()[i, k])[0][0] for k in (0, 1)] for i in range(5)]
    motor_error = (np.array(wire)[:, 1] - 112.0) * 1024
    assert np.abs(motor_error).max() < 3.0  # 0.5 deg of tolerance, and the seat of the gear


def test_replies_come_by_time_then_by_positioner():
    twin = make()
    twin.send([(encode(0, STATUS), b"")])
    replies = twin.run(0.001)
    assert [r[0] for r in commands(replies)] == IDS
    assert {r.time_s for r in replies} == {0.0}
    word = Status(int.from_bytes(replies[0].data, "little"))
    assert Status.DATUM_ALPHA_INITIALIZED | Status.CLOSED_LOOP_BETA in word
    assert twin.run(0.5) == []


@pytest.mark.parametrize("steps", [10, ADAPTIVE])
def test_same_bytes_for_any_number_of_threads(steps):
    runs = set()
    for threads in (1, 2, 5):
        twin = make(threads=threads, neighbours=True, start_deg=None, substeps=steps)
        runs.add(bytes_of(twin, move_all(twin)))
    assert len(runs) == 1


def test_same_bytes_in_slices_of_any_length():
    runs = set()
    for slices in ([0.6], [0.0005] * 3 + [0.1] * 5 + [0.0985], [0.0035, 0.5965]):
        twin = make(neighbours=True, start_deg=None)
        replies = move_all(twin, 0.0)
        for s in slices:
            replies += twin.run(s)
        assert twin.time_s == pytest.approx(0.6)
        runs.add(bytes_of(twin, replies))
    assert len(runs) == 1


def test_same_seed_same_bytes_other_seed_other_bytes():
    first, second, other = make(), make(), make(seed=4)
    runs = [bytes_of(t, move_all(t)) for t in (first, second, other)]
    assert runs[0] == runs[1] != runs[2]


def test_rest_is_skipped_and_nobody_can_tell():
    """A long rest between two moves: the same bytes whether its ticks are run or left out."""
    runs, spent = set(), []
    for skip in (True, False):
        twin = make(skip_resting=skip, neighbours=True)
        replies = move_all(twin, 1.5)
        replies += twin.run(20.0)
        twin.send([(encode(IDS[3], STATUS, 7), b"")])
        replies += move_all(twin, 1.2)
        runs.add(bytes_of(twin, replies))
        spent.append(twin._core.ticks_run)
    assert len(runs) == 1
    assert spent[0] < 0.2 * spent[1]


def test_trajectories_start_together_on_the_broadcast():
    twin = make()
    wire = np.array([[UNITS.transmission(i, k, x)[0][0] for k, x in enumerate((40, 120))] for i in (0, 1)])
    time = np.array([0.0, 1.0, 2.0])
    for row in (0, 1):
        path = wire[row] + np.outer([0, 2, 5], [1.0, -1.0])
        upload(twin, IDS[row], time, *path.T)
    before = twin.truth()
    start(twin)
    twin.run(1.0)
    halfway = twin.truth()[:2] - before[:2]
    twin.run(2.0)
    after = twin.truth()[:2] - before[:2]
    np.testing.assert_allclose(halfway, [[2, -2]] * 2, atol=0.3)  # B/n and the slope of delta
    np.testing.assert_allclose(after, [[5, -5]] * 2, atol=0.6)
    assert (twin.truth()[2:] == before[2:]).all()


def test_fibres_are_where_true_arms_put_them():
    twin = make()
    layout = PLANE.forward(40.0, 120.0)
    off_um = np.linalg.norm(twin.fibre_xy() - layout, axis=1) * 1e3
    assert 0.5 < np.sqrt(np.mean(off_um**2)) < 6.0  # about 1 um in each length and 50 urad in zeros
    with pytest.raises(InputError, match="this plane has"):
        twin.fibre_xy("BOSSA")


def test_camera_noise_is_the_two_dimensional_rms():
    twin = make()
    camera = NoiseCamera(twin, rms_um=0.669, seed=1)
    images = np.array([camera.measure().xy_mm for _ in range(150)])
    noise = np.linalg.norm(images - twin.fibre_xy(), axis=-1) * 1e3
    # 3000 samples of chi-square with two degrees: 1 percent of rms
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(0.669, rel=0.05)
    twin.inject(Fault("dark", IDS[4]))
    image = camera.measure()
    assert image.seen.sum() == len(IDS) - 1
    assert np.isnan(image.x_mm[4])


def test_transport_waits_in_virtual_time():
    twin = make()

    async def talk():
        transport = TwinTransport(twin)
        assert await transport.receive(0.25) == []
        assert transport.time_s == pytest.approx(0.25, abs=6e-4)
        await transport.send([(encode(IDS[2], STATUS, 5), b"")])
        frames = await transport.receive(5.0)
        return frames, transport.time_s

    frames, time_s = asyncio.run(talk())
    assert [decode(f.id) for f in frames] == [(IDS[2], STATUS, 5, 0)]
    assert frames[0].time_s == pytest.approx(0.25, abs=6e-4)
    assert time_s < 0.26


def test_a_wait_ends_with_the_slice_of_the_first_reply():
    """A slice after the other within the core; and a time without a reply ends when it is over."""
    one_by_one, at_once = make(), make()
    for twin in (one_by_one, at_once):
        twin.run(0.0005)
        twin.send([(encode(IDS[2], STATUS, 5), b"")])
    replies = []
    while not replies:
        replies = one_by_one.run(0.005)
    assert at_once.run_until_reply(0.005, 100) == replies
    assert at_once.time_s == one_by_one.time_s < 0.02
    assert at_once.run_until_reply(0.005, 100) == []
    assert at_once.time_s == pytest.approx(one_by_one.time_s + 0.5)


def test_a_long_wait_misses_no_fault_and_nobody_who_wants_to_send():
    twin, due_s = make(), 1.2031
    schedule = [ScheduledFault("mute", IDS[3], start_s=due_s)]
    begun_s, asked = [], []
    inject = twin.inject
    twin.inject = lambda fault: (begun_s.append(twin.time_s), inject(fault))
    transport = TwinTransport(twin, faults=FaultClock(twin, schedule, 0))

    async def other():
        while twin.time_s < 2.0:
            asked.append(twin.time_s)
            await asyncio.sleep(0)

    async def talk():
        task = asyncio.ensure_future(other())
        await transport.receive(2.5)
        await task

    asyncio.run(talk())
    assert len(begun_s) == 1
    assert due_s <= begun_s[0] < due_s + 0.005 + 1e-9
    assert np.diff(asked).max() < 0.0601  # twelve slices
    assert np.diff(asked)[:3].max() < 0.0051


def test_arms_give_way_to_an_outside_torque():
    """Kronig 2020, Fig. 13: 11.8 mNm on alpha and 1.4 mNm on beta, stiffness 337 and 25 mNm/deg."""
    twin = make()
    for axis, torque_mNm, stiffness in ((0, 11.8, 337.0), (1, 1.4, 25.0)):
        bent = []
        for sign in (1, -1):
            twin.set_external_torque(0, axis, sign * torque_mNm * 1e-3)
            twin.run(0.1)
            bent.append(twin.truth()[0, axis])
        twin.set_external_torque(0, axis, 0.0)
        assert 2 * torque_mNm / (bent[0] - bent[1]) == pytest.approx(stiffness, rel=0.16)  # 3 x 5 %


def test_scope_sees_every_tick():
    twin = make()
    with twin.scope(1, 0) as scope:
        goto(twin, IDS[1], 44.0, 120.0)
        twin.run(0.5)
        samples = scope.take()
    assert len(samples) == 1000
    np.testing.assert_allclose(np.diff(samples["time_s"]), 5e-4, rtol=1e-9)
    assert ((samples["hall_a_cnt"] > 0) & (samples["hall_a_cnt"] < 4095)).all()
    assert samples["speed_rad_s"].max() == pytest.approx(209.0, abs=25.0)  # 2000 rpm
    twin.run(0.1)
    assert len(scope.take()) == 0


def test_position_counts_are_the_motor_over_the_nominal_gear():
    twin = make()
    twin.send([(encode(IDS[0], 32, 1), b"")])
    reply = twin.run(0.001)[0]
    for axis in (0, 1):
        value = int.from_bytes(reply.data[4 * axis : 4 * axis + 4], "little", signed=True)
        wire = UNITS.transmission(0, axis, twin.truth()[0, axis])[0][0]
        assert value == pytest.approx(counts(wire), abs=counts(1.5 / 1024))  # hall: 1.5 motor deg


@pytest.mark.parametrize("bad", [-1.0, float("nan"), 1e9])
def test_bad_durations(bad):
    with pytest.raises(InputError, match="cannot run"):
        make().run(bad)


def test_units_must_fit_the_plane():
    with pytest.raises(InputError, match="19 units for 20"):
        Twin(PLANE, UNITS.select(np.arange(19)))
    with pytest.raises(InputError, match="beyond the hard stops"):
        make(start_deg=(400.0, 10.0))
