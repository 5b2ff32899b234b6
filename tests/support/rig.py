"""One positioner on a bench: asks it things as a host would, and lets time pass."""

import struct

import numpy as np

from fiberloom._core import firmware as fw

COUNTS_PER_DEG = 2**30 / 360
MOTOR_DEG = 2**20 / 360
TICKS_PER_S = 2000

NAMES = [p[0] for p in fw.AXIS_PARAMS]
# what is a tenth for the smaller beta motor
SCALED = (
    "inertia",
    "drag",
    "coulomb",
    "spring_torque",
    "spring_rate",
    "cogging_torque",
    "torque_per_volt",
)
GAINS = ("k_p", "k_i", "integral_limit", "collision_torque")

ACCEPTED, OUT_OF_RANGE, INVALID_TRAJECTORY, IN_MOTION, NOT_INITIALIZED = range(5)
WRONG_LENGTH, CALIBRATING, MOTOR_NOT_CALIBRATED, COLLISION = 5, 6, 7, 8
INVALID_BROADCAST, INVALID_BOOTLOADER, INVALID, UNKNOWN, DATUM_NOT_CALIBRATED = 10, 11, 12, 13, 14

BIT = {
    "initialized": 0,
    "config_changed": 1,
    "receiving": 4,
    "alpha_received": 5,
    "beta_received": 6,
    "completed": 8,
    "completed_alpha": 9,
    "completed_beta": 10,
    "collision_alpha": 11,
    "collision_beta": 12,
    "closed_alpha": 13,
    "closed_beta": 14,
    "precise_alpha": 15,
    "precise_beta": 16,
    "detect_off_alpha": 17,
    "motor_calibration": 19,
    "motor_alpha": 20,
    "datum_calibration": 22,
    "datum_calibrated_alpha": 23,
    "homing": 25,
    "datum_alpha": 26,
    "datum_beta": 27,
    "cogging_calibration": 30,
    "cogging_alpha": 31,
    "cogging_beta": 32,
    "estimated": 33,
    "restored": 34,
    "saved": 36,
    "hall_off": 39,
    "host_timeout": 41,
    "storage_failed": 42,
}


def params(**changes):
    """Firmware parameters (2, P): defaults for alpha, a tenth of the torques for beta."""
    rows = np.array([[p[4] for p in fw.AXIS_PARAMS]] * 2, dtype=np.float32)
    for name in SCALED + GAINS:
        rows[1, NAMES.index(name)] *= 0.1
    for name, value in changes.items():
        rows[:, NAMES.index(name)] = value
    return rows


def alpha_params(**changes):
    return params(**changes)[0]


class Rig:
    def __init__(self, position_deg=(10.0, 20.0), *, number=5, known=True, noise_cnt=2.0, **changes):
        self.number = number
        self.unit = fw.Positioner(number, params(**changes))
        for name in SCALED:
            self.unit.set_plant(1, name, 0.1 * self.unit.plant(1, name))
        self.unit.hall_noise_cnt = noise_cnt
        self.place(position_deg)
        if known:
            self.unit.declare_position()
        self.uid = 0
        self._unsolicited = []

    def place(self, position_deg):
        for axis, deg in enumerate(position_deg):
            self.unit.set_plant(axis, "theta_rad", np.deg2rad(deg) * 1024)

    def true_deg(self):
        return tuple(np.rad2deg(self.unit.plant(axis, "theta_rad")) / 1024 for axis in (0, 1))

    @property
    def position_deg(self):
        return tuple(p / COUNTS_PER_DEG for p in self.unit.position_cnt)

    def frames(self):
        """Replies since the last call; frames 18 are put aside."""
        out = []
        for identifier, data in self.unit.take_frames():
            sender, command, uid, code = fw.decode_identifier(identifier)
            assert sender == self.number
            if command == 18 and uid == 0:
                self._unsolicited.append((command, data))
            else:
                out.append((command, uid, code, data))
        return out

    @property
    def unsolicited(self):
        """Frames 18 so far."""
        self.frames()
        return self._unsolicited

    def ask(self, command, data=b"", *, to=None):
        """Code and payload of the one reply."""
        self.frames()
        self.uid = self.uid % 63 + 1
        to = self.number if to is None else to
        self.unit.receive(fw.encode_identifier(to, command, self.uid), data)
        replies = self.frames()
        assert len(replies) == 1
        assert replies[0][:2] == (command, self.uid)
        return replies[0][2], replies[0][3]

    def code(self, command, data=b"", **kwargs):
        return self.ask(command, data, **kwargs)[0]

    def status(self, *names):
        """The named bits of the reported status."""
        code, data = self.ask(3)
        assert code == ACCEPTED
        word = struct.unpack("<Q", data)[0]
        bits = tuple(bool(word >> BIT[n] & 1) for n in names)
        return bits[0] if len(bits) == 1 else bits

    def wait(self, limit_s=100.0):
        """Until the axes rest; seconds."""
        ticks = 0
        while not self.unit.status >> BIT["completed"] & 1:
            self.unit.tick(4)
            ticks += 4
            assert ticks < limit_s * TICKS_PER_S, "does not come to rest"
        return ticks / TICKS_PER_S

    def goto(self, alpha_deg, beta_deg):
        return self.code(30, pair(alpha_deg, beta_deg))

    def load(self, alpha, beta):
        """Points (s, deg) of both axes; the code of command 12."""
        assert self.code(10, struct.pack("<II", len(alpha), len(beta))) == ACCEPTED
        for time_s, deg in [*alpha, *beta]:
            assert self.code(11, point(time_s, deg)) == ACCEPTED
        return self.code(12)

    def follow(self, alpha, beta):
        assert self.load(alpha, beta) == ACCEPTED
        assert self.code(14) == ACCEPTED


def pair(alpha_deg, beta_deg):
    return struct.pack("<ii", round(alpha_deg * COUNTS_PER_DEG), round(beta_deg * COUNTS_PER_DEG))


def point(time_s, deg):
    return struct.pack("<ii", int(deg * COUNTS_PER_DEG), round(time_s * TICKS_PER_S))
