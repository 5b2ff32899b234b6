"""Where arms come to rest, without integrating the motion: the statistical twin.

Same units, same hidden parameters as the full physics (`fiberloom.twin.Twin`), and the same camera
may look at it. What decides where an arm comes to rest is kept: the true transmission with its
wear, backlash with the side of the last contact, the errors of the hall sensors against what the
firmware believes of them, the seat of the teeth, the scatter of a landing. What passes on the
way is left out: time, collisions, torque. `tests/twin/test_statistical.py` compares both.

A million standstill positions take one or two seconds, and about an hour by the full physics
(`python benchmarks/statistical.py`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiberloom._core import geometry
from fiberloom.calibration import SweepData, SweepSettings, wire_grid
from fiberloom.errors import InputError
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.twin.gears import NODE_RAD, Gears
from fiberloom.twin.noise import UnitNoise
from fiberloom.twin.units import Units
from fiberloom.typing import Flags, Floats
from fiberloom.units import COUNTS_PER_DEG, GEAR, RAD_PER_DEG, deg_to_rad, rad_to_deg

LANDING_RMS_RAD = 0.065 * RAD_PER_DEG
"""Scatter of the motor at the end of a move beside the errors of its sensors. MEASURED on the full
physics (tests/twin/test_statistical.py); at the output it is 0.1 mdeg, a tenth of the seat."""
SEAT_MEMORY = 0.7788
"""From one node of the gear to the next, as in core/twin/src/plant.cpp."""
NEGATIVE, POSITIVE = -1, 1
_READINGS = 3
"""Steps towards the angle that the sensors read as the goal: the error left is 0.3 motor deg where a
channel has lost a third of its amplitude, nothing where it is sound."""


class StatisticalTwin:
    """N positioners at rest. `fiberloom.twin.NoiseCamera` looks at them as at a `Twin`.

    `stand` is for positioners that always arrive in the same contact: no history, any number of
    moves at once. `move` is for what has one: imprecise moves, slipping, standing still. A unit's
    numbers depend on the seed and its own moves, not on the others that are simulated with it.
    """

    def __init__(
        self, plane: FocalPlane, units: Units, *, seed: int = 0, start_deg: ArrayLike | None = None
    ) -> None:
        if len(units) != len(plane):
            raise InputError(f"twin: {len(units)} units for {len(plane)} positioners; draw them anew")
        n = len(plane)
        self.plane = plane
        self.dark: Flags = np.zeros(n, dtype=bool)
        self.still: Flags = np.zeros((n, 2), dtype=bool)
        """Axes that do not move, whatever they are told."""
        self.follows: Floats = np.ones((n, 2, 2))
        """(N, 2 axes, 2) share of the gear's way that the arm makes, downwards and upwards."""
        self.moves = 0
        self._noise = UnitNoise(seed, 0x57A7, units.number)
        self._approach_rad = GEAR * deg_to_rad([axis.approach_deg for axis in plane.instrument.axes])
        self.set_units(units)
        start = plane.park_deg if start_deg is None else start_deg
        angles = deg_to_rad(np.broadcast_to(np.asarray(start, dtype=np.float64), (n, 2)))
        self._gear_rad = self.gears.gear_of(angles[..., None])[..., 0]
        # the counter was set at the place of the arms at power-up, as the sensors saw it
        # then, once and with their noise
        once = (units.plant["hall_noise"] / units.plant["hall_amplitude_a"]) * self._noise.normal(2)
        self._zero_rad = (hall_error_rad(units, self._gear_rad[..., None])[..., 0] + once)[..., None]
        self._seat_rad, self._slip_rad = np.zeros((n, 2)), np.zeros((n, 2))

    @property
    def time_s(self) -> float:
        """There is no time here: cameras want one."""
        return 0.0

    def set_units(self, units: Units, rows: NDArray[np.intp] | None = None) -> None:
        """These units from now on: wear. The motors do not move, so arms move with their gears.

        `rows`: those whose gears differ from before; all where left out.
        """
        self.units = units
        if rows is None or len(rows) == len(units):
            self.gears = Gears(units)
        else:
            self.gears.put(rows, Gears(units.select(rows)))

    # commands to angles

    def stand(self, wire_deg: ArrayLike, direction: int = NEGATIVE) -> Floats:
        """Output angles in deg at rest for wire positions (N, 2) or (N, 2, M), reached from one side.

        Negative: after the approach against the spring. Every entry is a move of its own; the
        positioners stay where they were.
        """
        if direction not in (NEGATIVE, POSITIVE):
            raise ValueError(f"direction {direction}: -1 for negative contact, +1 for positive")
        given = np.asarray(wire_deg, dtype=np.float64)
        motor = self._landed(_moves(given))
        gear = self.gears.pushed_up(motor) if direction == POSITIVE else motor
        theta = self.gears.output_of(gear) + self._seats(gear)
        return rad_to_deg(theta).reshape(given.shape)

    def move(self, wire_deg: ArrayLike, precise: bool = True) -> Floats:
        """All go to (N, 2) wire positions; NaN stays. Returns the output angles, (N, 2) deg."""
        wire = np.asarray(wire_deg, dtype=np.float64)
        goes = np.isfinite(wire) & ~self.still
        land = self._landed(np.nan_to_num(wire)[..., None])[..., 0]
        fresh = self._seats(land[..., None])[..., 0]
        path = [land + self._approach_rad, land] if precise else [land]
        gear, slip, way = self._gear_rad, self._slip_rad.copy(), np.zeros(land.shape)
        for motor in path:
            before, gear = gear, self.gears.play(gear[..., None], motor[..., None])[..., 0]
            slip += self._lost(before, gear)
            way += np.abs(gear - before)
        kept = SEAT_MEMORY ** (way / (GEAR * NODE_RAD))
        seat = kept * self._seat_rad + np.sqrt(1.0 - kept**2) * fresh
        self._gear_rad = np.where(goes, gear, self._gear_rad)
        self._slip_rad = np.where(goes, slip, self._slip_rad)
        self._seat_rad = np.where(goes, seat, self._seat_rad)
        self.moves += 1
        return self.truth()

    # the truth

    def truth(self) -> Floats:
        """Output angles (N, 2) in deg, inside the hard stops."""
        geared = self.gears.output_of(self._gear_rad[..., None])[..., 0]
        theta = geared + self._seat_rad + self._slip_rad
        return rad_to_deg(np.clip(theta, self.units.plant["stop_min"], self.units.plant["stop_max"]))

    def fibre_xy(self, fibre: str = METROLOGY, theta_deg: ArrayLike | None = None) -> Floats:
        """True position in mm of a fibre: (N, 2) now, or (N, 2, M) at output angles (N, 2, M)."""
        if fibre not in self.plane.points:
            raise InputError(f"fibre '{fibre}': this plane has {', '.join(self.plane.points)}")
        points = self.units.points_mm(self.plane.points[fibre], fibre)
        theta = self.truth() if theta_deg is None else np.asarray(theta_deg, dtype=np.float64)
        flat = _moves(theta)
        count = flat.shape[2]
        angles = np.ascontiguousarray(deg_to_rad(flat).swapaxes(1, 2).reshape(-1, 2))
        rows = np.repeat(np.arange(len(self.plane)), count)
        xy = geometry.forward(self.units.arms[rows], points[rows], angles)
        return xy.reshape(-1, count, 2).swapaxes(1, 2).reshape(theta.shape)

    # details

    def _landed(self, wire_deg: Floats) -> Floats:
        """Motor angles (N, 2, M) in rad at the end of moves, before the motor lets go."""
        target = np.rint(wire_deg * COUNTS_PER_DEG) / COUNTS_PER_DEG * RAD_PER_DEG * GEAR
        scatter = self._noise.normal(*target.shape[1:])
        asked = target + self._zero_rad
        motor = asked
        for _ in range(_READINGS):
            motor = asked - hall_error_rad(self.units, motor)
        landed: Floats = motor + LANDING_RMS_RAD * scatter
        return landed

    def _seats(self, gear_rad: Floats) -> Floats:
        """Output rad by which the teeth come to lie differently: drawn at both nodes, straight between."""
        share = np.mod(gear_rad / (GEAR * NODE_RAD), 1.0)
        first, second = self._noise.normal(2, *gear_rad.shape[1:]).swapaxes(0, 1)
        other = SEAT_MEMORY * first + np.sqrt(1.0 - SEAT_MEMORY**2) * second
        seats: Floats = self.units.plant["seat_rms"][..., None] * (first + share * (other - first))
        return seats

    def _lost(self, before_rad: Floats, after_rad: Floats) -> Floats:
        """(N, 2) what a slipping coupling keeps back of the gear's way."""
        ends = self.gears.output_of(np.stack([before_rad, after_rad], axis=-1))
        way = ends[..., 1] - ends[..., 0]
        return (np.where(way < 0.0, self.follows[..., 0], self.follows[..., 1]) - 1.0) * way


def sweeps(twin: StatisticalTwin, settings: SweepSettings, look: object = None) -> SweepData:
    """What `measure_sweeps` would see of this twin, without the moves: Kronig 2020, Eq. 6 and 7."""
    wire = wire_grid(twin.plane, settings)
    n, k = len(twin.plane), settings.n_points
    xy = np.empty((2, 2, k, n, 2))
    for axis, rest in enumerate((settings.beta_lever_deg, settings.alpha_rest_deg)):
        resting = twin.stand(np.full((n, 2), rest))
        for side, direction in enumerate((NEGATIVE, POSITIVE)):
            theta = twin.stand(np.broadcast_to(wire[axis], (n, 2, k)), direction)
            theta[:, 1 - axis] = resting[:, 1 - axis, None]
            true = twin.fibre_xy(METROLOGY, theta)
            images = [look(true) if callable(look) else true for _ in range(settings.images)]
            xy[axis, side] = np.mean(images, axis=0).transpose(2, 0, 1)
    return SweepData(wire, xy, [""] * n)


def hall_error_rad(units: Units, motor_rad: Floats) -> Floats:
    """What the firmware reads too much, motor rad, at motor angles (N, 2, M).

    The sensors' true offsets, amplitudes and phase against those in its parameters (fl_hall.h).
    """
    true, known = units.plant[..., None], units.firmware[..., None]
    a = true["hall_offset_a"] + true["hall_amplitude_a"] * np.sin(motor_rad)
    b = true["hall_offset_b"] + true["hall_amplitude_b"] * np.cos(motor_rad + true["hall_phase"])
    sine = (a - known["hall_offset_a"]) / known["hall_amplitude_a"]
    shifted = (b - known["hall_offset_b"]) / known["hall_amplitude_b"]
    cosine = shifted / np.cos(known["hall_phase"]) + sine * np.tan(known["hall_phase"])
    error: Floats = np.angle((cosine + 1j * sine) * np.exp(-1j * motor_rad))
    return error


def _moves(angles: Floats) -> Floats:
    """(N, 2, M) of (N, 2) or (N, 2, M)."""
    return angles.reshape(*angles.shape[:2], -1)
