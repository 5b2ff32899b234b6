"""Law 1: state feedback, and a feedforward that knows the gap; against numpy, and its margins."""

import struct
import zlib

import numpy as np
import pytest

from fiberloom._core import firmware as fw
from fiberloom.calibration.commissioning.gains import control_gains, state_gains
from rig import ACCEPTED, MOTOR_DEG, NAMES, Rig, alpha_params

DT = 1.0 / 2000.0
RAD = 2 * np.pi / 2**20
INERTIA, DRAG = 3.5e-9, 8e-7
GAP = {
    "backlash": 140.0, "backlash_1": 40.0, "backlash_1_phase": 0.3, "backlash_2": 20.0,
    "backlash_2_phase": -2.0, "backlash_3": 10.0, "backlash_3_phase": 1.1, "backlash_teeth": 8.0,
    "backlash_teeth_phase": 2.5,
}  # fmt: skip
ORDERS = {"backlash_1": 1, "backlash_2": 2, "backlash_3": 3, "backlash_teeth": 36}


def known(**changes):
    """Alpha's parameters by name, with the gains of a motor that is commissioned as the default says."""
    row = alpha_params(law=1.0, **control_gains({"inertia": INERTIA, "drag": DRAG}), **{**GAP, **changes})
    return dict(zip(NAMES, row.astype(float), strict=True))


def row_of(p):
    return np.array([p[name] for name in NAMES], np.float32)


def backlash_cnt(p, position_cnt):
    theta = 2 * np.pi * position_cnt / 2**30
    waves = sum(p[n] * np.sin(m * theta + p[f"{n}_phase"]) for n, m in ORDERS.items())
    return max(p["backlash"] + waves, 0.0) * MOTOR_DEG


class Law:
    """Law 1 as docs/firmware.md has it, in double precision."""

    def __init__(self, p, zero_cnt=0):
        self.p, self.zero = p, zero_cnt
        q = 1 - p["observer_pole"]
        self.gain = np.array([1 - (1 - q) ** 3, 1.5 * q**2 * (2 - q) / DT, q**3 / DT**2])
        self.seen, self.gear, self.direction = np.zeros(3), None, 0.0
        self.doubt, self.scale, self.slack = 0.4, 1.0, 0.0

    def gap(self, rotor):
        before = rotor if self.gear is None else self.gear
        width = backlash_cnt(self.p, before + self.zero)
        below = width / 2 if self.gear is None else np.clip(rotor - self.gear, 0, width)
        self.gear = rotor - below
        return below, width - below

    def rotor(self, command, speed, acceleration):
        p, motor = self.p, (command - self.zero) * RAD
        cogging = p["cogging_torque"] * np.sin(2 * motor + p["cogging_phase"])
        friction = p["gap_coulomb_share"] * p["coulomb"] * self.direction
        return cogging + friction + p["gap_drag_share"] * p["drag"] * speed + p["inertia"] * acceleration

    def pushing(self, command, speed):
        """What pushing it takes more, in the direction of the command."""
        p = self.p
        spring = -p["spring_torque"] - p["spring_rate"] * command * RAD
        resists = max(p["coulomb"] + spring * self.direction, 0.0)
        free = p["gap_coulomb_share"] * p["coulomb"]
        return resists - free + (self.scale - p["gap_drag_share"]) * p["drag"] * abs(speed)

    def learn(self, speed, load_Nm):
        p, w0 = self.p, 2000 * np.pi / 30
        pace = np.clip(speed, -w0, w0)
        rate = 1 / (p["drag_learning_time"] * p["drag"] * w0**2)
        self.doubt += (0.05 - self.doubt) * 0.5 * p["drag"] * rate * DT * pace**2
        self.scale = np.clip(self.scale + rate * DT * pace * load_Nm, 0.5, 2.0)

    def step(self, command, measured, speed, acceleration):
        p = self.p
        before, self.direction = self.direction, np.sign(speed) or self.direction
        self.doubt = self.doubt if before == self.direction else max(self.doubt, 0.12)
        gap = self.gap(measured - self.zero)
        ahead = gap[0] if self.direction < 0 else gap[1]
        pushes = ahead - abs(speed) * DT / 2 / RAD <= 2 * MOTOR_DEG
        e = (command - measured) * RAD
        self.seen += self.gain * (e - self.seen[0])
        load_Nm = p["inertia"] * self.seen[2]
        self.learn(speed * pushes, load_Nm)
        gear = self.pushing(command, speed)
        ahead_Nm = self.rotor(command, speed, acceleration) + pushes * gear * self.direction
        self.slack = 0.9 * self.slack if pushes else max(gear, 0.0)
        back_Nm = p["state_k_e"] * self.seen[0] + p["state_k_v"] * self.seen[1] + load_Nm
        full = p["torque_per_volt"] * p["u_dc"]
        voltage = np.clip((ahead_Nm + back_Nm) / full, -1, 1)
        drives = (voltage * full - ahead_Nm + p["drag"] * self.seen[1]) / p["inertia"]
        gained = (self.seen[2] - drives) * DT
        self.seen[0] += (self.seen[1] + gained / 2) * DT
        self.seen[1] += gained
        watched = p["k_p"] * e + load_Nm - self.slack * self.direction
        return [ahead_Nm + back_Nm, ahead_Nm, watched, voltage, load_Nm, gap[0]]


def wandering(ticks, seed):
    """A command with reversals and stops, and a rotor that follows it badly: rows for fw.regulator."""
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.choice([-200.0, -20.0, 0.0, 5.0, 60.0, 210.0], ticks // 100), 100)
    speed = np.convolve(speed, np.ones(32) / 32, "same")
    command = np.rint(np.cumsum(speed) * DT / RAD) + 7_000_000
    off = np.convolve(rng.normal(0, 60 * MOTOR_DEG, ticks), np.ones(40) / 40, "same")
    return np.stack([command, np.rint(command - off), speed, np.gradient(speed) / DT], axis=1)


@pytest.mark.parametrize("zero_cnt", [0, -123_456_789])
def test_the_law_is_the_same_in_numpy(zero_cnt):
    p = known()
    rows = wandering(3000, seed=4)
    found = np.array(fw.regulator(row_of(p), rows, zero_cnt))
    law = Law(p, zero_cnt)
    expected = np.array([law.step(*row) for row in rows])
    full = p["torque_per_volt"] * p["u_dc"]
    assert (np.abs(expected[:, 3]) == 1.0).any()  # it saturates
    for column, scale in ((0, full), (1, full), (2, full), (3, 1.0), (4, full)):
        assert np.abs(found[:, column] - expected[:, column]).max() < 2e-4 * scale, column
    # float32 waves of 10^5 counts, cut to whole ones
    assert np.abs(found[:, 5] - expected[:, 5]).max() <= 2.0


def test_the_feedforward_of_the_gear_begins_where_the_teeth_meet_and_ends_where_they_part():
    """At creep speed up, down and up again; friction alone, no waves."""
    p = known(**dict.fromkeys(GAP, 0.0) | {"backlash": 140.0}, cogging_torque=0.0, spring_torque=0.0,
              spring_rate=0.0, drag_learning_time=0.0)  # fmt: skip
    leg = np.arange(0.0, 300.0, 0.05) * MOTOR_DEG
    way = np.rint(np.concatenate([leg, leg[::-1], leg]))
    speed = np.repeat([1.0, -1.0, 1.0], len(leg))
    rows = np.stack([way, way, speed, 0 * way], axis=1)
    out = np.array(fw.regulator(row_of(p), rows))
    pushes = np.abs(out[:, 1]) > 0.5 * p["coulomb"]
    deg = way / MOTOR_DEG
    up, down, again = pushes.reshape(3, -1)
    first = deg[: len(leg)]
    # unknown at first: in the middle of the gap. Later from where it turned, 2 degrees early.
    assert first[up][0] == pytest.approx(70.0 - 2.0, abs=0.1)
    assert first[::-1][down][0] == pytest.approx(300.0 - 140.0 + 2.0, abs=0.1)
    assert first[again][0] == pytest.approx(140.0 - 2.0, abs=0.1)
    for part in (up, down, again):
        assert part[np.argmax(part) :].all()
    free = np.abs(out[: len(leg)][~up, 1])
    assert free.max() < 0.06 * p["coulomb"] + p["drag"]


def test_without_a_known_backlash_the_teeth_always_touch():
    p = known(**dict.fromkeys(GAP, 0.0))
    out = np.array(fw.regulator(row_of(p), wandering(2000, seed=1)))
    assert (out[:, 5] == 0.0).all()


def plant_of(inertia, drag):
    """(e, e') after a tick under a torque of the motor held for it."""
    decay = np.exp(-drag * DT / inertia)
    reach = inertia / drag * (1 - decay)
    return np.array([[1, reach], [0, decay]]), -np.array([(DT - reach) / drag, (1 - decay) / drag])


def controller():
    """The law as a linear system from e to its torque: A, b, c, d; taken from the compiled law's own answers
    would be the same, as test_the_law_is_the_same_in_numpy shows."""
    gains = state_gains(INERTIA, DRAG)
    q = 1 - gains["observer_pole"]
    correct = np.array([1 - (1 - q) ** 3, 1.5 * q**2 * (2 - q) / DT, q**3 / DT**2])
    feedback = np.array([gains["state_k_e"], gains["state_k_v"], INERTIA])
    gained = DT * (np.array([0, 0, 1.0]) - (feedback + np.array([0, DRAG, 0])) / INERTIA)
    predict = np.eye(3)
    predict[0] += DT * np.array([0, 1.0, 0]) + DT / 2 * gained
    predict[1] += gained
    rest = np.eye(3) - np.outer(correct, [1, 0, 0])
    return predict @ rest, predict @ correct, feedback @ rest, float(feedback @ correct)


def loop(inertia, drag):
    """The spectral radius closed, and the open loop at the motor's torque over frequency (rad/s)."""
    a, b = plant_of(inertia, drag)
    ac, bc, cc, d = controller()
    closed = np.block([[a + d * np.outer(b, [1, 0]), np.outer(b, cc)], [np.outer(bc, [1, 0]), ac]])
    rad_s = np.geomspace(1.0, 0.999 * np.pi / DT, 4000)
    gain = []
    for z in np.exp(1j * rad_s * DT):
        motor = np.linalg.solve(z * np.eye(2) - a, b)[0]
        law = cc @ np.linalg.solve(z * np.eye(3) - ac, bc) + d
        gain.append(-motor * law)
    return np.abs(np.linalg.eigvals(closed)).max(), rad_s, np.array(gain)


@pytest.mark.parametrize("inertia", [0.8, 1.0, 1.2])
@pytest.mark.parametrize("drag", [0.81, 1.0, 1.38])  # grease half and twice as stiff
def test_the_loop_is_stable_with_margin(inertia, drag):
    radius, rad_s, gain = loop(inertia * INERTIA, drag * DRAG)
    assert radius < 0.9  # an error falls to a tenth in 11 ms
    assert np.abs(1 / (1 + gain)).max() < 1.9  # so at least 30 deg and a factor of 2.1 either way
    crossing = np.flatnonzero((np.abs(gain[:-1]) > 1) & (np.abs(gain[1:]) <= 1))
    lag_s = [np.mod(np.angle(gain[k]) + np.pi, 2 * np.pi) / rad_s[k] for k in crossing]
    assert min(lag_s) > 1.2 * DT


def test_the_poles_are_where_they_were_placed():
    radius, _, _ = loop(INERTIA, DRAG)
    assert radius == pytest.approx(np.exp(-600 * DT), abs=0.1)
    a, b = plant_of(INERTIA, DRAG)
    gains = state_gains(INERTIA, DRAG)
    poles = np.linalg.eigvals(a + np.outer(b, [gains["state_k_e"], gains["state_k_v"]]))
    assert np.abs(poles - np.exp(-600 * DT)).max() < 1e-5


@pytest.mark.parametrize("deg", [100.3, 103.0, 97.0, 130.0])
def test_a_move_ends_where_it_should(deg):
    unit = Rig(position_deg=(100.0, 100.0), law=1.0)
    assert unit.goto(deg, 100.0) == ACCEPTED
    unit.wait()
    assert not unit.status("collision_alpha")
    # to half a motor degree, and against the way by no more than the sensors' noise
    past = (unit.true_deg()[0] - deg) * 1024 * np.sign(deg - 100.0)
    assert -0.25 < past < 0.5


def test_the_law_is_chosen_over_the_bus_and_takes_effect_with_the_commit():
    unit = Rig(position_deg=(100.0, 100.0), drag_learning_time=0.0)
    unit.unit.set_plant(0, "drag", 1.2 * unit.unit.plant(0, "drag"))  # grease that the firmware does not know
    moved = [worst_error(unit, 101.0)]
    set_law(unit, 1.0)
    moved.append(worst_error(unit, 102.0))
    set_law(unit, 0.0)
    moved.append(worst_error(unit, 103.0))
    assert moved[1] < 0.1 * min(moved[0], moved[2])


@pytest.mark.parametrize(("law", "within_ms"), [(0.0, 16.0), (1.0, 2.5)])
def test_a_rotor_that_is_held_at_full_speed_is_found(law, within_ms):
    """12 motor degrees a ms: the load that law 1 estimates is there in 2 ms; law 0 waits for 120 (Eq. 23)."""
    gains = {
        n: v for n, v in control_gains({"inertia": INERTIA, "drag": DRAG}).items() if n != "contact_torque"
    }
    unit = Rig(position_deg=(100.0, 100.0), law=law, **{**gains, "touch_torque": 0.0})
    assert unit.goto(130.0, 100.0) == ACCEPTED
    unit.unit.tick(2000)
    unit.unit.set_plant(0, "blocked", 1.0)
    ticks = 0
    while not unit.unsolicited:
        unit.unit.tick(1)
        ticks += 1
    assert 1.0 < ticks / 2 <= within_ms
    assert unit.status("collision_alpha")


def set_law(unit, law):
    """Both axes, by 231 to 234; the checksum is that of all values in force with these two changed."""
    table, _ = struct.unpack("<II", unit.ask(230)[1])
    assert unit.code(231, struct.pack("<I", table)) == ACCEPTED
    index = NAMES.index("law")
    values = np.array([[value(unit, 235 + k, i) for i in range(len(NAMES))] for k in (0, 1)], "<f4")
    values[:, index] = law
    for k in (0, 1):
        assert unit.code(232 + k, struct.pack("<Bf", index, law)) == ACCEPTED
    assert unit.code(234, struct.pack("<I", zlib.crc32(values.tobytes()))) == ACCEPTED
    assert [value(unit, 235 + k, index) for k in (0, 1)] == [law, law]


def value(unit, command, index):
    """A parameter as 235 or 236 tells it."""
    return struct.unpack("<Bf", unit.ask(command, bytes([index]))[1])[1]


def worst_error(unit, deg):
    """Of alpha's motor along a go-to, motor degrees."""
    assert unit.goto(deg, 100.0) == ACCEPTED
    worst = 0.0
    while not unit.status("completed"):
        worst = max(worst, np.abs(unit.unit.run(20, 0)[:, 1]).max())
    return worst
