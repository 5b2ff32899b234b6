"""A motor without a sensor on a rotating field: BLDC motors of DESI, steppers of others.

The rotor with N_r pole pairs follows the electrical angle of the field,

    J w' = T_h sin(field - N_r theta) - T_d sin(4 N_r theta + psi) - c w - T_c sign(w) - T_load.

`integrate` is the reference; `rest_rad`, `keeps_up` and `locked_rad` are closed forms of what it comes to.
Angles in rad, of the motor's shaft where not said to be electrical; SI. A microstepped motor of step 1/mu has
the field (pi / 2) k / mu after k microsteps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.typing import Flags, Floats

TURN_RAD = 2.0 * np.pi


@dataclass(frozen=True)
class FieldMotor:
    """One motor, or M with arrays (M,) in place of numbers. The defaults are a 4 mm motor of DESI."""

    pole_pairs: float | Floats = 1.0
    hold_Nm: float | Floats = 40e-6
    """[A] Largest torque of the field: T_h."""
    friction_Nm: float | Floats = 20e-6
    """[D] Of motor and gear at the shaft: T_c; at rest the lag is 30 motor deg at most."""
    damping_Nms: float | Floats = 4e-9
    """[A] c: a tenth of the torque at 9900 rpm."""
    inertia_kg_m2: float | Floats = 1.3e-10
    """[A] Rotor and gear at the shaft."""
    detent_Nm: float | Floats = 0.0
    detent_rad: float | Floats = 0.0
    """psi."""


@dataclass(frozen=True)
class RotorPath:
    """What an integration gives: T moments of M motors, and the energies of each, J."""

    angle_rad: Floats
    """(T, M)."""
    speed_rad_s: Floats
    """(M,) at the end."""
    field_J: Floats
    """(M,) work of the field's turning."""
    stored_J: Floats
    """(M,) kinetic energy and that of field and detent, gained."""
    lost_J: Floats
    """(M,) into friction and damping, and against the load."""


def integrate(
    motor: FieldMotor,
    field_rad: Floats,
    step_s: float,
    *,
    angle_rad: Floats,
    speed_rad_s: Floats | float = 0.0,
    load_Nm: float | Floats = 0.0,
) -> RotorPath:
    """The rotors of M motors along fields.

    Parameters
    ----------
    motor : FieldMotor
        One for all or M.
    field_rad : (T, M) float
        Electrical angle of the field at the end of each step.
    step_s : float
        Short against the period of the rotor in the field.
    angle_rad, speed_rad_s : (M,) float
        At the start; the field starts where it is first.
    load_Nm : float or (M,)
        Outside torque at the shaft against positive angles.

    Returns
    -------
    RotorPath
        Friction stops a rotor and holds it, it never drives it backwards.
    """
    theta = np.array(angle_rad, dtype=np.float64)
    w = np.broadcast_to(np.asarray(speed_rad_s, dtype=np.float64), theta.shape).copy()
    before = field_rad[0]
    stored, worked, lost = _stored_J(motor, before, theta, w), np.zeros_like(theta), np.zeros_like(theta)
    out = np.empty(field_rad.shape)
    slowed = 1.0 + step_s * motor.damping_Nms / motor.inertia_kg_m2
    brake = step_s * motor.friction_Nm / motor.inertia_kg_m2
    for k, field in enumerate(field_rad):
        # the field turns, then the rotor moves in it: a symplectic step
        worked += _field_J(motor, field, theta) - _field_J(motor, before, theta)
        push = _torque_Nm(motor, field, theta) - load_Nm
        free = (w + step_s * push / motor.inertia_kg_m2) / slowed
        w = np.sign(free) * np.maximum(np.abs(free) - brake, 0.0)
        theta = theta + step_s * w
        lost += step_s * (motor.damping_Nms * w**2 + motor.friction_Nm * np.abs(w) + load_Nm * w)
        out[k], before = theta, field
    return RotorPath(out, w, worked, _stored_J(motor, before, theta, w) - stored, lost)


def _torque_Nm(motor: FieldMotor, field: Floats, theta: Floats) -> Floats:
    electrical = motor.pole_pairs * theta
    torque: Floats = motor.hold_Nm * np.sin(field - electrical) - motor.detent_Nm * np.sin(
        4.0 * electrical + motor.detent_rad
    )
    return torque


def _field_J(motor: FieldMotor, field: Floats, theta: Floats) -> Floats:
    energy: Floats = -motor.hold_Nm / motor.pole_pairs * np.cos(field - motor.pole_pairs * theta)
    return energy


def _stored_J(motor: FieldMotor, field: Floats, theta: Floats, w: Floats) -> Floats:
    detent = -motor.detent_Nm / (4.0 * motor.pole_pairs)
    energy: Floats = (
        0.5 * motor.inertia_kg_m2 * w**2
        + _field_J(motor, field, theta)
        + detent * np.cos(4.0 * motor.pole_pairs * theta + motor.detent_rad)
    )
    return energy


def lag_rad(
    motor: FieldMotor, field_rad: Floats, direction: Floats | float, load_Nm: Floats | float = 0.0
) -> Floats:
    """Electrical angle in rad by which a rotor at rest is behind `field_rad`, after it came slowly in a
    `direction` (1 or -1) against a load; NaN where the field cannot hold that.

    T_h sin(lag) = T_c direction + T_load + T_d sin(4 N_r theta + psi).
    """
    lag = np.zeros(np.broadcast(field_rad, direction, load_Nm).shape)
    needed = motor.friction_Nm * direction + load_Nm
    with np.errstate(invalid="ignore"):
        for _ in range(40):  # a contraction for detents below a quarter of the field
            detent = motor.detent_Nm * np.sin(4.0 * (field_rad - lag) + motor.detent_rad)
            lag = np.arcsin((needed + detent) / motor.hold_Nm)
    return lag


def rest_rad(
    motor: FieldMotor, field_rad: Floats, direction: Floats | float, load_Nm: Floats | float = 0.0
) -> Floats:
    """Shaft angle in rad at rest: the field's `field_rad` less the lag, as `lag_rad` has it."""
    at: Floats = (field_rad - lag_rad(motor, field_rad, direction, load_Nm)) / motor.pole_pairs
    return at


def keeps_up(
    motor: FieldMotor,
    speed_rad_s: Floats | float,
    acceleration_rad_s2: Floats | float,
    load_Nm: Floats | float = 0.0,
) -> Flags:
    """Whether the field can carry the rotor: its torque exceeds what friction, damping, load, inertia take.

    `speed_rad_s` and `acceleration_rad_s2` of the shaft; `load_Nm` against positive angles. Where not, the
    rotor is pulled out and loses whole turns of the field.
    """
    needed = (
        motor.inertia_kg_m2 * acceleration_rad_s2
        + motor.damping_Nms * speed_rad_s
        + motor.friction_Nm * np.sign(speed_rad_s)
        + load_Nm
    )
    return np.asarray(np.abs(needed) < motor.hold_Nm)


def locked_rad(motor: FieldMotor, field_rad: Floats, angle_rad: Floats) -> Floats:
    """The shaft angle in rad, without lag, at which a rotor that was held at `angle_rad` locks to the field.

    The nearest of those that are a whole number of electrical turns apart.
    """
    turns = np.rint((motor.pole_pairs * angle_rad - field_rad) / TURN_RAD)
    out: Floats = (field_rad + TURN_RAD * turns) / motor.pole_pairs
    return out
