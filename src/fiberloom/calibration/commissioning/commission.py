"""Units of a bench: what they held, what was found, what they are told, and how that ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.bus.parameters import (
    PARAMETERS_DTYPE,
    AxisParameters,
    ParameterState,
    Written,
    read_parameters,
    write_parameters,
)
from fiberloom.calibration.commissioning.checks import Context, checked
from fiberloom.calibration.commissioning.derive import Derivation, derive
from fiberloom.calibration.commissioning.measured import Quantities
from fiberloom.calibration.commissioning.own import calibrate_itself
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import Care
from fiberloom.units import AXES


@dataclass(frozen=True)
class Before:
    """What positioners held, by number."""

    factory: dict[int, AxisParameters]
    """(2,) records when the bench began."""
    own: dict[int, AxisParameters]
    """After their own calibrations of hall sensors and cogging."""
    trouble: dict[int, str]
    """Why a positioner goes no further; empty where it does."""

    def good(self) -> list[int]:
        """Positioners that go further."""
        return [i for i, reason in self.trouble.items() if not reason]


async def begin(client: Client, plane: FocalPlane) -> Before:
    """Reads the parameters of all positioners of the plane and lets them calibrate themselves."""
    ids = [int(i) for i in plane.positioner_id]
    factory = await read_parameters(client, ids)
    trouble = {i: s.reason for i, s in factory.items()}
    trouble |= await calibrate_itself(client, plane, [i for i in ids if not trouble[i]])
    own = await read_parameters(client, [i for i in ids if not trouble[i]])
    trouble |= {i: s.reason for i, s in own.items()}
    return Before(_values(factory), _values(factory) | _values(own), trouble)


def _values(states: Mapping[int, ParameterState]) -> dict[int, AxisParameters]:
    return {i: s.values for i, s in states.items()}


@dataclass(frozen=True)
class Commissioned:
    """A positioner's commissioning."""

    positioner_id: int
    trouble: str
    """Why nothing could be derived; empty where it could."""
    derivation: Derivation | None
    written: Written | None
    """None: not tried."""

    @property
    def reasons(self) -> list[str]:
        """Every reason why it is not commissioned; empty where it is."""
        if self.derivation is None:
            return [self.trouble]
        if self.derivation.refused:
            return self.derivation.refused
        return [self.written.reason] if self.written is not None and self.written.reason else []

    @property
    def ok(self) -> bool:
        """New parameters in force, read back and saved."""
        return self.written is not None and self.written.ok

    def record(self) -> dict[str, Any]:
        """As a file holds it."""
        findings = self.derivation.findings if self.derivation else ()
        checks = self.derivation.checks if self.derivation else ()
        return {
            "positioner_id": self.positioner_id,
            "commissioned": self.ok,
            "reasons": self.reasons,
            "in_force": self.written.in_force if self.written else "old",
            "parameters": [f.record() for f in findings],
            "checks": [c.record() for c in checks],
        }


def derive_units(before: Before, found: Mapping[int, Quantities], care: Care) -> dict[int, Derivation]:
    """Parameters with their cross-checks, of every positioner that got so far; `care` is the instrument's."""
    return {
        i: checked(
            derive(i, found.get(i, {}), before.factory[i], before.own[i], care),
            Context(found.get(i, {}), before.own[i], own_cogging=True),
        )
        for i in before.good()
    }


async def write_units(
    client: Client, before: Before, derivations: Mapping[int, Derivation]
) -> list[Commissioned]:
    """Writes those that are not refused, reads them back, saves."""
    wanted = {i: d.values(before.own[i]) for i, d in derivations.items() if not d.refused}
    written = await write_parameters(client, wanted) if wanted else {}
    return [
        Commissioned(i, trouble, derivations.get(i), written.get(i)) for i, trouble in before.trouble.items()
    ]


def parameter_file(values: AxisParameters) -> dict[str, dict[str, float]]:
    """(2,) records as a parameter file for flashing has them: by axis and name, SI units."""
    return {
        axis: {name: float(np.float32(row[name])) for name in PARAMETERS_DTYPE.names or ()}
        for axis, row in zip(AXES, values, strict=True)
    }
