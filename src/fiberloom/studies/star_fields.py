"""Science fibres calibrated on the twin's stars: fields are observed, dithered and fitted, one by one.

After each field the offsets found so far are applied: the next stars fall nearer to the middles of their
fibres, where what scales all offsets alike (seeing, core, dithers) does no harm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fiberloom.calibration.fibres.combine import combine
from fiberloom.calibration.fibres.dithered import DitheredField, hexagon
from fiberloom.calibration.fibres.estimate import FieldOffsets, estimate
from fiberloom.calibration.fibres.frame import radius_of
from fiberloom.calibration.fibres.model import FieldSettings
from fiberloom.calibration.fibres.offsets import FibreOffsets
from fiberloom.calibration.fibres.rows import combined_row, field_row
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.operation.results import Observation
from fiberloom.targets import TargetList
from fiberloom.targets.generate import random_targets
from fiberloom.twin.sky.sky import Believed, Sky, SkyConditions
from fiberloom.typing import Flags
from fiberloom.units import rad_to_deg

STARS_PER_FIBRE = 4
"""So dense that nearly every fibre gets one."""

Observe = Callable[[TargetList, FibreOffsets | None, str], Observation]
"""Puts fibres on stars with the offsets known so far; the text names the field."""


@dataclass(frozen=True)
class StarFields:
    """What is observed."""

    fields: int = 3
    """Of each fibre."""
    n_dithers: int = 13
    step_um: float = 45.0
    seed: int = 0
    """Of stars and sky."""
    settings: FieldSettings = field(default_factory=FieldSettings)
    conditions: SkyConditions = field(default_factory=SkyConditions)


@dataclass(frozen=True)
class CalibratedOnStars:
    """Offsets, and how they came."""

    offsets: FibreOffsets
    rows: list[dict[str, Any]]
    """One for each field, and one for a field observed with everything found."""
    recorded: list[DitheredField]
    reasons: dict[str, int]
    """Why fibres have no offset: how many."""


def calibrate_on_stars(
    plane: FocalPlane, fibres: list[str], observe: Observe, asked: StarFields
) -> CalibratedOnStars:
    """Observes fields of stars and finds the offsets of science fibres.

    Parameters
    ----------
    plane : FocalPlane
        The layout, to which offsets are found.
    fibres : list of str
        Science fibres, each with fields of its own.
    observe : callable
        Puts fibres on stars.
    asked : StarFields
        How many fields, dithers (um) and the sky.

    Returns
    -------
    CalibratedOnStars
        Offsets, and errors in um field by field.
    """
    found: list[FieldOffsets] = []
    recorded: list[DitheredField] = []
    rows: list[dict[str, Any]] = []
    offsets: FibreOffsets | None = None
    for number, fibre in enumerate(np.repeat(fibres, asked.fields).tolist()):
        name = f"field {number + 1} ({fibre})"
        seen = observe(stars(plane, fibre, asked.seed + number), offsets, name)
        recorded.append(dithered(seen, plane, fibre, number, asked))
        found.append(estimate(recorded[-1], asked.settings))
        offsets = FibreOffsets.of(combine(found, radius_mm=radius_of(plane)), plane)
        rows.append(field_row(name, found[-1]) | _errors(seen, fibre))
    assert offsets is not None
    for k, fibre in enumerate(fibres):
        seen = observe(stars(plane, fibre, asked.seed + 1000 + k), offsets, f"check ({fibre})")
        rows.append(combined_row(f"combined ({fibre})", offsets, fibre) | _errors(seen, fibre))
    said = offsets.reason[~offsets.ok].tolist()
    return CalibratedOnStars(offsets, rows, recorded, {r: said.count(r) for r in sorted(set(said))})


def stars(plane: FocalPlane, fibre: str, seed: int) -> TargetList:
    """Stars all over the field for one fibre; `plane`: the layout; `seed`: of their places."""
    found = random_targets(plane, STARS_PER_FIBRE * plane.n, seed)
    names = np.full(len(found.target_id), fibre)
    return TargetList(
        found.target_id, found.x_mm, found.y_mm, np.ones(len(names)), names, found.positioner_id
    )


def dithered(
    seen: Observation, plane: FocalPlane, fibre: str, number: int, asked: StarFields
) -> DitheredField:
    """What the twin's sky gives of an observed field.

    `seen`: the observation, on a twin; `plane`: the layout without offsets; `fibre`: the one on stars;
    `number`: of the field, for the sky; `asked`: dithers in um, and the conditions.
    """
    rows = np.flatnonzero(_on_star(seen, fibre))
    true_mm = seen.final.true_mm
    assert true_mm is not None
    sky = Sky(asked.seed, number, asked.conditions)
    dithers_um = hexagon(asked.step_um, asked.n_dithers)
    return sky.expose(believed(seen, plane, fibre, rows), true_mm[rows], dithers_um, asked.settings.core_um)


def believed(seen: Observation, plane: FocalPlane, fibre: str, rows: Any) -> Believed:
    """Where the host has science fibres: the metrology fibre as seen, then the layout along the arm.

    `seen`: the observation; `plane`: the layout without offsets; `fibre`: its name; `rows`: positioners.
    """
    host, angles = seen.plane, seen.assignment
    arm_deg = rad_to_deg(host.alpha_off_rad + host.beta_off_rad) + angles.alpha_deg + angles.beta_deg
    z = (plane.points[fibre] - plane.points[METROLOGY])[rows] @ [1.0, 1.0j]
    z = z * np.exp(1j * np.deg2rad(arm_deg[rows]))
    return Believed(
        name=f"field {fibre}",
        positioner_id=plane.positioner_id[rows],
        fibre=np.full(len(rows), fibre),
        star_mm=seen.target_mm()[rows],
        fibre_mm=seen.final.measurement.xy_mm[rows] + np.column_stack([z.real, z.imag]),
        arm_deg=arm_deg[rows],
    )


def _on_star(seen: Observation, fibre: str) -> Flags:
    """Positioners that are healthy, were seen, and have a star on this fibre."""
    final, assignment = seen.final, seen.assignment
    flags: Flags = seen.counted(final) & final.measurement.seen & (assignment.target >= 0)
    flags &= np.asarray(assignment.fibre) == fibre
    return flags


def _errors(seen: Observation, fibre: str) -> dict[str, Any]:
    """Of the science fibres as they stood, um."""
    on_star = _on_star(seen, fibre)
    true_um, guided_um = seen.true_error_um(seen.final), seen.guided_error_um(seen.final)
    unknown = np.full(len(on_star), np.nan)
    error = (unknown if true_um is None else true_um)[on_star]
    guided = (unknown if guided_um is None else guided_um)[on_star]
    return {
        "true_rms_um": float(np.sqrt((error**2).mean())),
        "guided_rms_um": float(np.sqrt((guided**2).mean())),
        "true_p95_um": float(np.percentile(error, 95)),
        "n_within": int((error <= seen.requirement_um).sum()),
        "n_guided_within": int((guided <= seen.requirement_um).sum()),
    }
