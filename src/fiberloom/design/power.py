"""Current, power and heat of an array that moves, and the time that a limit on the power costs.

Of a plan in closed loop (Kronig 2020, Eq. 17 and 19; `fiberloom.twin.motors.power`): the torque is friction,
drag, spring against the motion, and inertia; K_M^2 = 1.5 lambda^2/R is torque^2 by watt of copper.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from fiberloom.design.gear import move_s, twin_knows
from fiberloom.errors import InputError
from fiberloom.instruments import AXES, Instrument, generate
from fiberloom.planning.supply import PAUSE_S
from fiberloom.twin import draw_units
from fiberloom.twin.motors.power import power_of_torque
from fiberloom.typing import Floats, Records
from fiberloom.units import GEAR, deg_to_rad

UNITS = 61
"""Whose median motor is taken."""
STEPS = 400
HEAT_J_K = 2.0
"""Assumed: heat capacity of a positioner."""
HEAT_K_W = 30.0
"""Assumed: from a positioner to the plate and the air (an EC 13 housing: 32 K/W)."""
SLOWEST = 0.02
"""Of the speed; no reconfiguration takes so long."""


@dataclass(frozen=True)
class MovePower:
    """One axis that makes one way, from rest to rest."""

    axis: str
    way_deg: float
    time_s: float
    torque_uNm: float
    """On the plateau, back-EMF apart."""
    copper_J: float
    supply_J: float
    peak_W: float
    """From the supply."""
    mean_A: float
    peak_A: float


@dataclass(frozen=True)
class ArrayPower:
    """n positioners that move at once."""

    n: int
    alpha: MovePower
    beta: MovePower
    time_s: float
    """Of the longer way."""
    peak_W: float
    peak_A: float
    move_J: float
    """From the supply for one reconfiguration; all of it becomes heat."""
    warmer_by_move_K: float
    """One positioner by its own move, nothing led away."""
    warmer_K: float
    """One positioner that reconfigures every so often, settled."""


@dataclass(frozen=True)
class Limited:
    """A reconfiguration within a limit on the power of the supply."""

    limit_W: float
    slower_s: float
    """All together, at a lower speed."""
    speed_share: float
    """Of the axes' speeds, for that."""
    waves: int
    """Groups, one after the other at full speed."""
    waves_s: float

    @property
    def time_s(self) -> float:
        """The shorter of the two."""
        return min(self.slower_s, self.waves_s)


def motor(instrument: Instrument, axis: int, seed: int = 0) -> Records:
    """The median motor, gear and spring of an `axis`, 0 or 1, of 61 units of the twin drawn by `seed`.

    Raises
    ------
    InputError
        A motor that the twin does not know.
    """
    own = instrument.axes[axis]
    if not twin_knows(own):
        raise InputError(
            f"{instrument.name}: {AXES[axis]} is a {own.kind} of gear {own.gear:g}; power is known of bldc "
            f"motors of gear {GEAR:g}"
        )
    plane = generate(instrument, seed, n_positioners=min(UNITS, instrument.layout.n_positioners))
    plants = draw_units(plane, seed).plant[:, axis]
    median: Records = plants[0].copy()
    for name in plants.dtype.names or ():
        median[name] = np.median(plants[name])
    return median


def move_power(
    instrument: Instrument, axis: int, plant: Records, way_deg: float, share: float = 1.0
) -> MovePower:
    """An `axis` of an `instrument` with the motor `plant` on its way.

    `way_deg`: from rest to rest; `share`: of the axis' speed, 0 to 1. The spring is against the motion, at
    the middle of the range.
    """
    own = instrument.axes[axis]
    speed_deg_s = share * own.speed_deg_s
    time_s = move_s(way_deg, speed_deg_s, own.acceleration_deg_s2)
    at_s = (np.arange(STEPS) + 0.5) * time_s / STEPS
    ramp = own.acceleration_deg_s2 * np.minimum(at_s, time_s - at_s)
    speed_rad_s = own.gear * deg_to_rad(np.minimum(ramp, speed_deg_s))
    slope = np.where(ramp < speed_deg_s, np.sign(time_s - 2.0 * at_s), 0.0) * own.acceleration_deg_s2
    middle = deg_to_rad(0.5 * sum(own.target_range_deg))
    spring_Nm = abs(float(plant["spring_rate"] * (plant["spring_free"] - middle))) / own.gear
    held_Nm = float(plant["coulomb_motor"] + plant["coulomb_gear"]) + spring_Nm
    viscous = float(plant["viscous_motor"] + plant["viscous_gear"])
    inertia = float(plant["inertia_motor"] + plant["inertia_gear"])
    torque: Floats = held_Nm + viscous * speed_rad_s + inertia * own.gear * deg_to_rad(slope)
    power = power_of_torque(torque, speed_rad_s, plant, time_s / STEPS)
    plateau = held_Nm + viscous * float(speed_rad_s.max())
    return MovePower(
        axis=AXES[axis],
        way_deg=way_deg,
        time_s=time_s,
        torque_uNm=1e6 * plateau,
        copper_J=power.copper_J,
        supply_J=power.supply_J,
        peak_W=float(power.supply_W.max()),
        mean_A=power.current_A[0],
        peak_A=power.current_A[1],
    )


@dataclass(frozen=True)
class PowerSettings:
    """What moves, and how often.

    Raises
    ------
    InputError
        Numbers out of range.
    """

    n: int | None = None
    """Positioners at once; None: all."""
    way_deg: tuple[float, float] | None = None
    """Of alpha and beta; None: their whole ranges."""
    every_s: float = 900.0
    """From one reconfiguration to the next."""
    rest_W: float = 0.0
    """Of the electronics of one positioner, which is not published."""
    share: float = 1.0
    """Of the axes' speeds, 0 to 1."""

    def __post_init__(self) -> None:
        ways = self.way_deg or (1.0, 1.0)
        numbers = (*ways, self.every_s, self.rest_W)
        short = min(*ways, self.every_s) <= 0.0 or self.rest_W < 0.0 or not np.isfinite(numbers).all()
        if (self.n is not None and self.n < 1) or short:
            raise InputError(
                f"power: {'all' if self.n is None else self.n} positioners, ways {ways[0]:g} and {ways[1]:g} "
                f"deg every {self.every_s:g} s, {self.rest_W:g} W at rest: must be finite and above 0 "
                "(rest: 0 or more)"
            )


ALL_AT_ONCE = PowerSettings()


def array_power(instrument: Instrument, settings: PowerSettings = ALL_AT_ONCE, seed: int = 0) -> ArrayPower:
    """Positioners of an `instrument` that move at once; `settings`: how many, how far; `seed` of the units.

    Raises
    ------
    InputError
        A motor that the twin does not know.
    """
    plants = [motor(instrument, axis, seed) for axis in (0, 1)]
    return _array(instrument, plants, settings)


def _array(instrument: Instrument, plants: list[Records], settings: PowerSettings) -> ArrayPower:
    n = instrument.layout.n_positioners if settings.n is None else settings.n
    ranges = [axis.target_range_deg[1] - axis.target_range_deg[0] for axis in instrument.axes]
    ways = settings.way_deg or ranges
    alpha, beta = (move_power(instrument, k, plants[k], ways[k], settings.share) for k in (0, 1))
    one_J = alpha.supply_J + beta.supply_J
    return ArrayPower(
        n=n,
        alpha=alpha,
        beta=beta,
        time_s=max(alpha.time_s, beta.time_s),
        peak_W=n * (alpha.peak_W + beta.peak_W + settings.rest_W),
        peak_A=n * (alpha.peak_A + beta.peak_A),
        move_J=n * one_J,
        warmer_by_move_K=one_J / HEAT_J_K,
        warmer_K=HEAT_K_W * (one_J / settings.every_s + settings.rest_W),
    )


def limited(
    instrument: Instrument, limit_W: float, settings: PowerSettings = ALL_AT_ONCE, seed: int = 0
) -> Limited:
    """Positioners of an `instrument` within `limit_W` for their motors, all slower or in waves.

    `settings`: how many, how far; `seed` of the units. Electronics at rest do not count.

    Raises
    ------
    InputError
        A limit that not even one positioner keeps, or all at 2 % of the speed: with the one that would.
    """
    motors = replace(settings, rest_W=0.0)
    plants = [motor(instrument, axis, seed) for axis in (0, 1)]
    full = _array(instrument, plants, motors)
    one_W = full.peak_W / full.n
    if not limit_W >= one_W:
        raise InputError(f"--limit {limit_W:g}: {_too_little(one_W)}")

    def over_W(share: float) -> float:
        return _array(instrument, plants, replace(motors, share=share)).peak_W - limit_W

    share = 1.0 if over_W(1.0) <= 0.0 else 0.0
    if share == 0.0 and over_W(SLOWEST) < 0.0:
        share = float(brentq(over_W, SLOWEST, 1.0, xtol=1e-6))
    slower_s = _array(instrument, plants, replace(motors, share=share)).time_s if share else math.inf
    waves = math.ceil(full.n / math.floor(limit_W / one_W))
    return Limited(limit_W, slower_s, share, waves, waves * full.time_s + (waves - 1) * PAUSE_S)


def _too_little(one_W: float) -> str:
    """What to give; rounded up, so that it will do."""
    return f"one positioner takes {math.ceil(1e4 * one_W) / 1e4:.4f} W; give at least that"


def within_power(instrument: Instrument, limit_W: float, seed: int = 0) -> Instrument:
    """The `instrument` with a `[care]` by which its plans keep `limit_W` for all motors; `seed` of the units.

    A motor counts with the peak of its ramp, by which the median motor of the units goes; the current is of
    one positioner at both ends of its speed.

    Raises
    ------
    InputError
        A motor that the twin does not know, or a limit that not even one positioner keeps.
    """
    plants = [motor(instrument, axis, seed) for axis in (0, 1)]
    volt = float(plants[0]["supply"])
    full = _array(instrument, plants, PowerSettings(1))
    if not limit_W >= full.peak_W:
        raise InputError(_too_little(full.peak_W))
    slow = _array(instrument, plants, PowerSettings(1, share=SLOWEST))
    friction = (slow.alpha.peak_A, slow.beta.peak_A)
    added = (full.alpha.peak_A - friction[0], full.beta.peak_A - friction[1])
    limits = {"supply_A": limit_W / volt, "motor_friction_A": friction, "motor_speed_A": added}
    return instrument.model_copy(update={"care": instrument.care.model_copy(update=limits)})


def care_lines(instrument: Instrument, limit_W: float, seed: int = 0) -> list[str]:
    """Lines of `[care]` with which plans keep `limit_W`: current of a motor that turns, and what speed adds.

    `instrument`: whose motors; `seed` of the units.
    """
    care = within_power(instrument, limit_W, seed).care
    friction, added = care.motor_friction_A, care.motor_speed_A
    return [
        "[care]",
        f"supply_A = {care.supply_A:.3f}",
        f"motor_friction_A = [{friction[0]:.6f}, {friction[1]:.6f}]",
        f"motor_speed_A = [{added[0]:.6f}, {added[1]:.6f}]",
    ]
