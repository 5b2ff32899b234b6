"""From bench results to the firmware parameters of one positioner, each with its error and origin.

Pure: quantities and the values that the positioner holds go in, findings and new values come out. A value
that is refused keeps the positioner from being written at all; see `Derivation.refused`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fiberloom.bus.parameters import PARAMETERS, PARAMETERS_BY_NAME, AxisParameters
from fiberloom.calibration.commissioning.backlash import BACKLASH_WAVES
from fiberloom.calibration.commissioning.gains import control_gains
from fiberloom.calibration.commissioning.measured import BACKLASH_WAVE, Quantities
from fiberloom.instruments.model import Care
from fiberloom.units import AXES, GEAR, RAD_PER_DEG

MEASURED, DERIVED, OWN, FACTORY, CHOSEN = "measured", "derived", "self-calibrated", "factory", "chosen"

OWN_CALIBRATION: dict[str, str] = {
    **dict.fromkeys(
        ("hall_offset_a", "hall_offset_b", "hall_amplitude_a", "hall_amplitude_b", "hall_phase"),
        "its own hall calibration (26)",
    ),
    **dict.fromkeys(
        ("coulomb", "spring_torque", "cogging_torque", "cogging_phase"), "its own cogging calibration (47)"
    ),
}
"""What the firmware finds by itself. Nothing outside of it can see the hall sensors; the others the bench
measures better, over more of the range."""

DECADE = 3.0
"""A measured value more than so many times the nominal unit's, or so many times less, is not believed:
units of one kind differ by some ten percent, a wrong weight, axis or unit by more."""


@dataclass(frozen=True)
class _Rule:
    """How a parameter comes from a quantity."""

    quantity: str
    factor: float
    relative_error: float
    """Largest that is taken, standard error over value; of the phase: in rad."""
    how: str
    decades: bool = True


# ten times what the bench reaches with a 0.3 % weight, and below what would fill the watches' margins
_RULES: dict[str, _Rule] = {
    "torque_per_volt": _Rule("torque at full voltage", 1e-6, 0.03, "over u_dc, Eq. 19"),
    "inertia": _Rule("inertia", 1.0, 0.03, "Eq. 12"),
    "drag": _Rule("drag", 1e-6, 0.05, "c_tot: viscous friction and back-EMF, Eq. 8 and 9"),
    "coulomb": _Rule("Coulomb friction", 1e-6, 0.05, "Eq. 11"),
    "spring_torque": _Rule("spring at 0 deg", -1e-6, 0.10, "T_spring of Eq. 11, the firmware's sign"),
    "spring_rate": _Rule("spring rate", -1e-6 / (GEAR * RAD_PER_DEG), 0.15, "its change, per motor rad"),
    "cogging_torque": _Rule("cogging", 1e-6, 0.10, "Eq. 10, two cycles a motor turn"),
    "cogging_phase": _Rule("cogging phase", 1.0, 0.05, "of sin(2 theta + phase)", decades=False),
}
_GAINS = "Eq. 21 to 23 and the poles of law 1, from inertia and drag (gains.py)"
_WAVES = "backlash", *(f"{name}{end}" for name in BACKLASH_WAVES for end in ("", "_phase"))


@dataclass(frozen=True)
class FoundParameter:
    """One parameter of one axis."""

    axis: int
    name: str
    unit: str
    low: float
    high: float
    factory: float
    """What the positioner held before, as a rule the nominal unit's."""
    value: float | None
    """None where refused."""
    standard_error: float | None
    """None where there is no measurement behind it."""
    origin: str
    """MEASURED, DERIVED, OWN, FACTORY or CHOSEN."""
    provenance: str
    reason: str = ""
    """Why it is refused, and what to do; empty where it is not."""

    @property
    def verdict(self) -> str:
        """refused, kept, or good."""
        if self.reason:
            return "refused"
        return "kept" if self.origin in (FACTORY, OWN) else "good"

    def record(self) -> dict[str, Any]:
        """As a file holds it."""
        return {
            "axis": AXES[self.axis], "parameter": self.name, "unit": self.unit, "low": self.low,
            "high": self.high, "factory": self.factory, "value": self.value,
            "standard_error": self.standard_error, "origin": self.origin, "provenance": self.provenance,
            "verdict": self.verdict, "reason": self.reason,
        }  # fmt: skip


@dataclass(frozen=True)
class CrossCheck:
    """A rule that several values must keep together."""

    name: str
    value: float | None
    """None: not measured."""
    low: float | None
    high: float | None
    unit: str
    remedy: str
    """What to do where it fails."""

    @property
    def reason(self) -> str:
        """Why the positioner is refused; empty where it is not."""
        if self.value is None or self._inside(self.value):
            return ""
        wanted = " and ".join(
            f"at {word} {limit:.4g}"
            for word, limit in (("least", self.low), ("most", self.high))
            if limit is not None
        )
        return f"{self.name}: {self.value:.4g} {self.unit}, must be {wanted}; {self.remedy}"

    def _inside(self, value: float) -> bool:
        return (self.low is None or value >= self.low) and (self.high is None or value <= self.high)

    def record(self) -> dict[str, Any]:
        """As a file holds it."""
        verdict = "not measured" if self.value is None else "fail" if self.reason else "pass"
        return {
            "check": self.name, "value": self.value, "low": self.low, "high": self.high, "unit": self.unit,
            "verdict": verdict,
        }  # fmt: skip


@dataclass(frozen=True)
class Derivation:
    """All parameters of a positioner, and whether they may be written."""

    positioner_id: int
    findings: tuple[FoundParameter, ...]
    checks: tuple[CrossCheck, ...] = ()
    others: tuple[str, ...] = ()
    """Why something that no parameter follows from (arms, stiffness, maps) could not be measured."""

    @property
    def refused(self) -> list[str]:
        """Every reason why nothing is written; empty when it may be."""
        own = [f"{AXES[f.axis]} {f.name}: {f.reason}" for f in self.findings if f.reason]
        return own + [c.reason for c in self.checks if c.reason] + list(self.others)

    def of(self, axis: int, name: str) -> FoundParameter:
        """The finding of a parameter."""
        return next(f for f in self.findings if f.axis == axis and f.name == name)

    def values(self, now: AxisParameters) -> AxisParameters:
        """(2,) records: what the positioner holds with what was found. Only where nothing is refused."""
        out = np.array(now)
        for f in self.findings:
            if f.value is None:
                raise ValueError(f"{f.name} was refused: {f.reason}")
            out[f.axis][f.name] = f.value
        return out


def derive(
    positioner_id: int,
    found: Quantities,
    factory: AxisParameters,
    own: AxisParameters | None = None,
    care: Care | None = None,
) -> Derivation:
    """Parameters of both axes from what the bench found and what the positioner holds.

    `positioner_id`: its number on the bus. `found`: quantities by name, in the units of their Estimates.
    `factory`: (2,) records of PARAMETERS_DTYPE, SI. `own`: the same after its own calibrations; None: it has
    done none. `care`: of the instrument, whose host watch is written; None: what it holds is kept.
    Cross-checks are not in it: `checks.checked` adds them.
    """
    now = factory if own is None else own
    findings = [f for axis in range(2) for f in _of_axis(axis, found, factory[axis], now[axis])]
    if care is not None:
        findings = [_chosen(f, care) for f in findings]
    return Derivation(positioner_id, tuple(findings))


def _chosen(finding: FoundParameter, care: Care) -> FoundParameter:
    """The host watch is no property of a unit: the instrument's file says it."""
    if finding.name != "host_timeout_ms":
        return finding
    value = 1e3 * care.host_timeout_s
    told = replace(finding, value=value, origin=CHOSEN, provenance="the instrument's care.host_timeout_s")
    if finding.low <= value <= finding.high:
        return told
    return _refused(told, f"care.host_timeout_s is {care.host_timeout_s:g}: at most {finding.high / 1e3:g}")


def _of_axis(axis: int, found: Quantities, factory: np.void, now: np.void) -> Iterator[FoundParameter]:
    blanks = {p.name: _kept(axis, p.name, float(factory[p.name]), float(now[p.name])) for p in PARAMETERS}
    made = {name: _measured(blanks[name], found, float(now["u_dc"])) for name in _RULES}
    made |= {f.name: f for f in _gains(blanks, made["inertia"], made["drag"])}
    made |= {f.name: f for f in _backlash(blanks, found)}
    yield from (blanks | made).values()


def _kept(axis: int, name: str, factory: float, now: float) -> FoundParameter:
    p = PARAMETERS_BY_NAME[name]
    own = OWN_CALIBRATION.get(name, "") if now != factory else ""
    return FoundParameter(
        axis, name, p.unit, p.low, p.high, factory, now, None, OWN if own else FACTORY,
        own or "factory default, not measured",
    )  # fmt: skip


def _measured(blank: FoundParameter, found: Quantities, u_dc: float) -> FoundParameter:
    rule = _RULES[blank.name]
    quantity = found.get(f"{AXES[blank.axis]} {rule.quantity}")
    if quantity is None:
        return blank
    where = f"{quantity.name} ({rule.how}): {quantity.source}"
    if quantity.value is None or quantity.standard_error is None:
        lost = replace(blank, origin=MEASURED, provenance=where)
        return _refused(lost, f"{quantity.reason}; measure again")
    factor = rule.factor / (u_dc if blank.name == "torque_per_volt" else 1.0)
    value, error = quantity.value * factor, abs(quantity.standard_error * factor)
    finding = replace(blank, origin=MEASURED, provenance=where, value=value, standard_error=error)
    reason = _fault(finding, value, error, rule)
    return _refused(finding, reason) if reason else finding


def _refused(finding: FoundParameter, reason: str) -> FoundParameter:
    return replace(finding, value=None, reason=reason)


def _fault(finding: FoundParameter, value: float, error: float, rule: _Rule) -> str:
    """Why a measured value is not taken: range, error, distance from the nominal unit; empty where it is."""
    told = f"{value:.4g} +- {error:.2g} {finding.unit}"
    if not (np.isfinite(value) and finding.low <= value <= finding.high):
        return (
            f"{told} is outside of {finding.low:g} to {finding.high:g}; check the unit's wiring and "
            f"measure {rule.quantity} again"
        )
    in_rad = finding.unit == "rad"
    if not error <= 1.000001 * rule.relative_error * (1.0 if in_rad else abs(value)):
        most = f"{rule.relative_error:g} rad" if in_rad else f"{100 * rule.relative_error:g} %"
        return f"{told}: a standard error of {most} at most is taken; measure longer, or with a better weight"
    ratio = abs(value / finding.factory) if finding.factory else 1.0
    if rule.decades and not 1.0 / DECADE <= ratio <= DECADE:
        return (
            f"{told} is {ratio:.3g} times the nominal unit's {finding.factory:.4g}; "
            f"{1 / DECADE:.2g} to {DECADE:g} times is believed: is it the right unit, axis, weight?"
        )
    return ""


def _backlash(blanks: Mapping[str, FoundParameter], found: Quantities) -> Iterator[FoundParameter]:
    """What the maps tell of it; nothing where there are none. A map states no errors."""
    for name in _WAVES:
        quantity = found.get(BACKLASH_WAVE.format(AXES[blanks[name].axis], name))
        if quantity is None or quantity.value is None:
            continue
        finding = replace(
            blanks[name],
            origin=MEASURED,
            provenance=f"transmission maps: {quantity.source}",
            value=quantity.value,
        )
        yield _in_range(finding, quantity.value)


def _gains(
    blanks: Mapping[str, FoundParameter], inertia: FoundParameter, drag: FoundParameter
) -> Iterator[FoundParameter]:
    """Derived from a measured inertia and the drag; the factory's where the inertia was not measured."""
    if inertia.origin == FACTORY:
        return
    known = {f.name: f.factory if f.value is None else f.value for f in (inertia, drag)}
    errors = _gain_errors(known, {f.name: f.standard_error or 0.0 for f in (inertia, drag)})
    for name, value in control_gains(known).items():
        finding = replace(
            blanks[name], origin=DERIVED, provenance=_GAINS, value=value, standard_error=errors[name]
        )  # fmt: skip
        if inertia.value is None:
            yield _refused(finding, "the inertia that it follows from was refused")
        else:
            yield _in_range(finding, value)


def _gain_errors(known: Mapping[str, float], errors: Mapping[str, float]) -> dict[str, float | None]:
    """Standard errors of the gains from those of inertia and drag; None for what follows from neither."""
    at = control_gains(known)
    moved = [control_gains({**known, name: known[name] + error}) for name, error in errors.items()]
    found = {name: math.hypot(*(m[name] - value for m in moved)) for name, value in at.items()}
    return {name: error or None for name, error in found.items()}


def _in_range(finding: FoundParameter, value: float) -> FoundParameter:
    if finding.low <= value <= finding.high:
        return finding
    limits = f"{finding.low:g} to {finding.high:g}"
    return _refused(finding, f"{value:.4g} {finding.unit} is outside of {limits}")
