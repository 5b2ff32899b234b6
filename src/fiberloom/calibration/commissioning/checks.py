"""Rules that the parameters of an axis must keep together, and with what else the bench found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from fiberloom.bus.parameters import AxisParameters
from fiberloom.calibration.commissioning.derive import FACTORY, CrossCheck, Derivation
from fiberloom.calibration.commissioning.measured import BACKLASH, PUSHED_DRAG, Quantities
from fiberloom.units import AXES, GEAR, RAD_PER_DEG

RAD_S_PER_RPM = np.pi / 30.0
COLLISION_DEG = (90.0, 180.0)
"""Motor degrees, Eq. 23: in open loop a rotor that follows lags by up to 90, and at 180 turns back."""
RESERVE = 0.2
"""Of the motor's torque, that must be left at the speed and acceleration of a go-to."""
MODEL_ERROR_SHARE = 0.23
"""Of contact_torque: legal moves need 50 of its 65 uNm (docs/firmware.md), three standard errors of the
model may take the rest."""
OWN_FRICTION_SHARE, OWN_PHASE_RAD = 0.15, 0.1
"""By how much the positioner's own cogging calibration (47) may differ: it reaches 4 % and a mrad. The phase
differs from unit to unit by any angle: results of another unit do not pass."""
FALL_BACK_DEG = 90.0
"""Motor degrees by which a rotor at rest may fall back inside its backlash (docs/calibration.md)."""
BEND_DEG = 0.6
"""Of the arm, when the torque reaches contact_torque: the nominal axes give by 0.20 and 0.27."""


@dataclass(frozen=True)
class Context:
    """What the checks need beside the findings."""

    found: Quantities
    own: AxisParameters
    """(2,) what the positioner held after its own calibrations; its torques by its old torque per volt."""
    own_cogging: bool = False
    """It has just done its own cogging calibration."""


def checked(derivation: Derivation, context: Context) -> Derivation:
    """With its cross-checks, and what else was refused; axes of which a parameter was refused have none."""
    checks = [c for axis in range(2) for c in _of_axis(derivation, axis, context)]
    used = {f.provenance.split(" (")[0] for f in derivation.findings}
    others = [f"{q.name}: {q.reason}" for q in context.found.values() if q.reason and q.name not in used]
    return replace(derivation, checks=tuple(checks), others=tuple(others))


def _of_axis(derivation: Derivation, axis: int, context: Context) -> Iterator[CrossCheck]:
    mine = [f for f in derivation.findings if f.axis == axis]
    if any(f.value is None for f in mine):
        return
    value = {f.name: float(f.value or 0.0) for f in mine}
    error = {f.name: f.standard_error or 0.0 for f in mine}
    name = AXES[axis]
    yield _collision(name, value)
    yield _reserve(name, value)
    yield _model_error(name, value, error)
    yield _two_drags(name, context.found)
    if context.own_cogging and derivation.of(axis, "coulomb").origin != FACTORY:
        yield from _own_calibration(name, value, context.own[axis])
    yield _approach(name, value, context.found)
    yield _bend(name, value, context.found)


def _collision(name: str, v: Mapping[str, float]) -> CrossCheck:
    deg = (v["collision_torque"] - v["integral_limit"]) / max(v["k_p"], 1e-30) / RAD_PER_DEG
    what = f"{name} smallest tracking error that is a collision (Eq. 23)"
    remedy = "collision_torque, integral_limit and k_p must belong together"
    return CrossCheck(what, deg, *COLLISION_DEG, "motor deg", remedy)


def _reserve(name: str, v: Mapping[str, float]) -> CrossCheck:
    needed = (
        v["coulomb"] + abs(v["spring_torque"]) + v["cogging_torque"]
        + v["drag"] * v["speed_default"] * RAD_S_PER_RPM + v["inertia"] * v["acceleration"]
    )  # fmt: skip
    share = 1.0 - needed / (v["torque_per_volt"] * v["u_dc"])
    what = f"{name} torque left at {v['speed_default']:g} rpm"
    return CrossCheck(what, share, RESERVE, None, "of the full one", "look for friction, or check the supply")


def _model_error(name: str, v: Mapping[str, float], e: Mapping[str, float]) -> CrossCheck:
    speed = v["speed_default"] * RAD_S_PER_RPM
    sigma = np.sqrt(
        e["coulomb"] ** 2 + e["spring_torque"] ** 2 + e["cogging_torque"] ** 2
        + (v["cogging_torque"] * e["cogging_phase"]) ** 2 + (e["drag"] * speed) ** 2
    )  # fmt: skip
    share = 3.0 * float(sigma) / max(v["contact_torque"], 1e-30)
    return CrossCheck(f"{name} three standard errors of the model", share, None, MODEL_ERROR_SHARE,
                      "of contact_torque", "measure friction longer, or with a weight")  # fmt: skip


def _two_drags(name: str, found: Quantities) -> CrossCheck:
    """Friction's runs and the pushes of the inertia see the same drag."""
    both = [found.get(f"{name} drag"), found.get(PUSHED_DRAG.format(name))]
    off = None
    if all(q is not None and q.value is not None and q.standard_error is not None for q in both):
        (a, b), (s, t) = [[getattr(q, key) for q in both] for key in ("value", "standard_error")]
        off = abs(a - b) / float(np.hypot(s, t))
    return CrossCheck(f"{name} drag by runs and by pushes differ", off, None, 4.0, "standard errors",
                      "measure friction and inertia again, at one temperature")  # fmt: skip


def _own_calibration(name: str, v: Mapping[str, float], own: AxisParameters) -> Iterator[CrossCheck]:
    scale = v["torque_per_volt"] * v["u_dc"] / (float(own["torque_per_volt"]) * float(own["u_dc"]))
    ratio = float(own["coulomb"]) * scale / max(v["coulomb"], 1e-30)
    remedy = "are the results those of this unit? measure friction again"
    yield CrossCheck(f"{name} Coulomb friction of its own calibration (47)", ratio, 1.0 - OWN_FRICTION_SHARE,
                     1.0 + OWN_FRICTION_SHARE, "of the bench's", remedy)  # fmt: skip
    off = float(np.angle(np.exp(1j * (float(own["cogging_phase"]) - v["cogging_phase"]))))
    yield CrossCheck(f"{name} cogging phase off that of its own calibration (47)", abs(off), None,
                     OWN_PHASE_RAD, "rad", remedy)  # fmt: skip


def _approach(name: str, v: Mapping[str, float], found: Quantities) -> CrossCheck:
    backlash = found.get(BACKLASH.format(name))
    value = backlash.value if backlash is not None else None
    left = None if value is None else v["approach"] - value
    return CrossCheck(f"{name} approach beyond the largest backlash", left, FALL_BACK_DEG, None, "motor deg",
                      "the gear's backlash is too large for the approach: refuse the unit")  # fmt: skip


def _bend(name: str, v: Mapping[str, float], found: Quantities) -> CrossCheck:
    stiffness = found.get(f"{name} stiffness")
    value = stiffness.value if stiffness is not None else None
    bend = None if not value else v["contact_torque"] * GEAR * 1e3 / value
    remedy = "the gear is too soft for the watch to protect a neighbour: refuse the unit"
    return CrossCheck(f"{name} arm gives way at contact_torque by", bend, None, BEND_DEG, "deg", remedy)
