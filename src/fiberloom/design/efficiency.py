"""Share of targets that are observed and of fibres that are used, against the density of the targets.

By the project's own assignment and bodies, on an endless lattice (the inner units of a patch without edge
effects) or on the whole array.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching
from scipy.spatial import cKDTree

from fiberloom.assignment import AssignSettings, assign
from fiberloom.assignment.candidates import Candidates, find_candidates
from fiberloom.assignment.choose import pack
from fiberloom.design.coverage import broken_plane
from fiberloom.design.lattice import Lattice
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane, Instrument, generate
from fiberloom.targets import TargetList
from fiberloom.targets.target_list import FREE
from fiberloom.typing import Flags, Floats, Ints

Rule = Literal["random", "free", "tips", "arms", "assigned"]
RULES: tuple[Rule, ...] = ("random", "free", "tips", "arms", "assigned")
"""random: one unit after the other takes any target that it reaches, collisions do not count; free: most
targets, collisions do not count; tips: no two fibres nearer than the exclusion; arms: no two bodies overlap
at rest; assigned: as `fiberloom assign`, with its margin, and approaches and ways to park that are free."""
RINGS = 8
CLUSTER = 8.0
"""Mean number of targets of a cluster; its standard deviation per coordinate is `CLUSTER_PITCH` pitches."""
CLUSTER_PITCH = 0.5
MOST_TARGETS = 200_000


@dataclass(frozen=True)
class ObservedPart:
    """What is observed: a plane, the units that count, the places whose targets count."""

    plane: FocalPlane
    counted: Flags
    """(N,) units whose surroundings are those of an endless lattice."""
    middle_mm: Floats
    """(2,) of the field."""
    counted_radius_mm: float
    """Targets within it count."""
    field_radius_mm: float
    """Targets are drawn within it."""


@dataclass(frozen=True)
class Efficiency:
    """Of one density and rule; shares from 0 to 1, means over fields with their standard errors."""

    density: float
    """Targets in the annulus that one unit reaches."""
    per_fibre: float
    """Targets per working unit."""
    rule: Rule
    exposures: int
    used: float
    """Share of the fibres with a target, mean of all exposures."""
    used_error: float
    observed: float
    """Share of the targets that were observed in any exposure."""
    observed_error: float


def endless(instrument: Instrument, rings: int = RINGS) -> FocalPlane:
    """A hexagonal patch of equal units of an `instrument`, `rings` around the central one; no obstacles."""
    data = instrument.model_dump(exclude_none=True)
    layout = {name: data["layout"][name] for name in ("pitch_mm", "orientation_deg")}
    data["layout"] = layout | {"rings": rings, "n_positioners": 3 * rings * (rings + 1) + 1}
    data["scatter"] = {}
    data["bodies"]["keep_outs"] = ()
    return generate(Instrument.model_validate(data), 0)


def inner_part(plane: FocalPlane, fibre: str) -> ObservedPart:
    """The units of an endless patch, `plane`, that are two reaches of a `fibre` from its edge; the innermost
    seven at least."""
    reach_mm = Lattice.of(plane.instrument, fibre).reach_mm
    far_mm = np.linalg.norm(plane.centres_mm, axis=1)
    edge_mm = 0.5 * math.sqrt(3.0) * float(far_mm.max())
    inner_mm = max(edge_mm - 2.0 * reach_mm, 1.01 * plane.instrument.layout.pitch_mm)
    return ObservedPart(plane, far_mm <= inner_mm, np.zeros(2), inner_mm, float(far_mm.max()) + reach_mm)


def whole_array(plane: FocalPlane, fibre: str) -> ObservedPart:
    """Every unit of a `plane`, and every target between the outermost centres; `fibre`: that is used."""
    middle = 0.5 * (plane.centres_mm.min(axis=0) + plane.centres_mm.max(axis=0))
    far_mm = float(np.linalg.norm(plane.centres_mm - middle, axis=1).max())
    reach_mm = Lattice.of(plane.instrument, fibre).reach_mm
    return ObservedPart(plane, np.ones(plane.n, dtype=bool), middle, far_mm, far_mm + reach_mm)


@dataclass(frozen=True)
class EfficiencySettings:
    """How fields are drawn and observed.

    Raises
    ------
    InputError
        Numbers or a share out of range.
    """

    rules: Sequence[Rule] = RULES[1:]
    exposures: int = 1
    """Of one field; targets observed before are left out."""
    fields: int = 10
    """Drawn for each density; the same for all rules."""
    clustered: bool = False
    broken: float = 0.0
    """Share of the units, 0 to 1."""
    exclusion_mm: float | None = None
    """Between two fibres; None: two collision buffers."""
    seed: int = 0

    def __post_init__(self) -> None:
        if self.exposures < 1 or self.fields < 2:
            raise InputError(
                f"efficiency: {self.exposures} exposures and {self.fields} fields: 1 and 2 at least"
            )
        if not 0.0 <= self.broken < 1.0:
            raise InputError(f"efficiency: broken {self.broken:g}: a share of the units, 0 or more, below 1")

    def exclusion_of(self, plane: FocalPlane) -> float:
        """mm between two fibres of a `plane`."""
        return 2.0 * plane.collision_buffer_mm if self.exclusion_mm is None else self.exclusion_mm


def efficiency(
    where: ObservedPart,
    fibre: str,
    densities: Sequence[float],
    settings: EfficiencySettings,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> list[Efficiency]:
    """Shares for each density and rule; the same fields for all rules.

    `where`: plane and what counts; `fibre` that targets ask for; `densities`: targets in the annulus that one
    unit reaches; `settings`: rules, exposures, fields; `progress` is told the fields done and their number.

    Raises
    ------
    InputError
        A density that is not above 0, or more targets than 200000.
    """
    _refuse(where, fibre, densities)
    found = []
    for k, density in enumerate(densities):
        shares = np.empty((len(settings.rules), settings.fields, 2))
        for field in range(settings.fields):
            rng = np.random.default_rng([settings.seed, k, field])
            shares[:, field] = _field(where, fibre, density, settings, rng)
            progress(k * settings.fields + field + 1, len(densities) * settings.fields)
        per_fibre = density / Lattice.of(where.plane.instrument, fibre).mean / (1.0 - settings.broken)
        found += [
            _mean(density, per_fibre, rule, settings.exposures, of_rule)
            for rule, of_rule in zip(settings.rules, shares, strict=True)
        ]
    return found


def _field(
    where: ObservedPart, fibre: str, density: float, settings: EfficiencySettings, rng: np.random.Generator
) -> Floats:
    """(rules, 2) shares in one field."""
    if settings.broken > 0.0:
        n = round(settings.broken * where.plane.n)
        where = replace(where, plane=broken_plane(where.plane, n, int(rng.integers(2**31))))
    xy_mm = _draw(where, _per_mm2(where, fibre, density), settings.clustered, rng)
    return np.array([_observe(where, fibre, xy_mm, rule, settings, rng) for rule in settings.rules])


def of_list(
    where: ObservedPart, fibre: str, targets: TargetList, settings: EfficiencySettings
) -> list[Efficiency]:
    """The same of a list of `targets` in mm: one field, no standard errors (NaN).

    `where`, `fibre`, `settings`: as of `efficiency`; InputError for an empty list.
    """
    if not len(targets):
        raise InputError("efficiency: the list of targets is empty")
    per_fibre = len(targets) / where.plane.n
    density = per_fibre * Lattice.of(where.plane.instrument, fibre).mean
    found = []
    for rule in settings.rules:
        rng = np.random.default_rng(settings.seed)
        share = _observe(where, fibre, targets.xy_mm, rule, settings, rng)
        found.append(_mean(density, per_fibre, rule, settings.exposures, np.array([share])))
    return found


def _refuse(where: ObservedPart, fibre: str, densities: Sequence[float]) -> None:
    for density in densities:
        if not 0.0 < density < math.inf:
            raise InputError(f"efficiency: density {density:g}: must be above 0 targets per annulus")
        n = _per_mm2(where, fibre, density) * math.pi * where.field_radius_mm**2
        if n > MOST_TARGETS:
            raise InputError(f"efficiency: density {density:g} is {n:.0f} targets, {MOST_TARGETS} at most")


def _per_mm2(where: ObservedPart, fibre: str, density: float) -> float:
    lattice = Lattice.of(where.plane.instrument, fibre)
    return density / (math.pi * (lattice.reach_mm**2 - lattice.hole_mm**2))


def _mean(density: float, per_fibre: float, rule: Rule, exposures: int, shares: Floats) -> Efficiency:
    means = [_mean_of(column[np.isfinite(column)]) for column in shares.T]
    (used, used_error), (observed, observed_error) = means
    return Efficiency(density, per_fibre, rule, exposures, used, used_error, observed, observed_error)


def _mean_of(share: Floats) -> tuple[float, float]:
    """Mean of the fields that have targets at all, and its standard error; NaN: none, or too few."""
    mean = float(share.mean()) if len(share) else math.nan
    return mean, float(share.std(ddof=1)) / math.sqrt(len(share)) if len(share) > 1 else math.nan


def _draw(where: ObservedPart, per_mm2: float, clustered: bool, rng: np.random.Generator) -> Floats:
    """(n, 2) mm, Poisson over the field; or in clusters whose centres are."""
    spread_mm = CLUSTER_PITCH * where.plane.instrument.layout.pitch_mm if clustered else 0.0
    radius_mm = where.field_radius_mm + 3.0 * spread_mm
    mean = per_mm2 * math.pi * radius_mm**2 / (CLUSTER if clustered else 1.0)
    n = int(rng.poisson(mean))
    far_mm, turn = radius_mm * np.sqrt(rng.random(n)), 2.0 * np.pi * rng.random(n)
    xy_mm = np.column_stack([far_mm * np.cos(turn), far_mm * np.sin(turn)])
    if clustered:
        xy_mm = np.repeat(xy_mm, rng.poisson(CLUSTER, n), axis=0)
        xy_mm = xy_mm + spread_mm * rng.standard_normal(xy_mm.shape)
    inside: Floats = where.middle_mm + xy_mm[np.hypot(*xy_mm.T) <= where.field_radius_mm]
    return inside


# observing


def _observe(
    where: ObservedPart,
    fibre: str,
    xy_mm: Floats,
    rule: Rule,
    settings: EfficiencySettings,
    rng: np.random.Generator,
) -> tuple[float, float]:
    """Share of the fibres that are used, mean of the exposures, and of the targets that are observed."""
    plane = where.plane
    left = np.ones(len(xy_mm), dtype=bool)
    units = where.counted & ~plane.offline
    used = 0.0
    for _ in range(settings.exposures):
        rows = np.flatnonzero(left)
        taken = _taken(plane, _targets(xy_mm[rows], fibre), rule, settings.exclusion_of(plane), rng)
        used += float((taken[units] >= 0).mean()) / settings.exposures
        left[rows[taken[taken >= 0]]] = False
    here = np.linalg.norm(xy_mm - where.middle_mm, axis=1) <= where.counted_radius_mm
    return used, float((~left[here]).mean()) if here.any() else math.nan


def _targets(xy_mm: Floats, fibre: str) -> TargetList:
    n = len(xy_mm)
    return TargetList(
        target_id=np.arange(n).astype(np.str_),
        x_mm=xy_mm[:, 0],
        y_mm=xy_mm[:, 1],
        priority=np.ones(n),
        fibre=np.full(n, fibre),
        positioner_id=np.full(n, FREE),
    )


def _taken(
    plane: FocalPlane, targets: TargetList, rule: Rule, exclusion_mm: float, rng: np.random.Generator
) -> Ints:
    """(N,) row of the target of each unit; -1: none."""
    if not len(targets):
        return np.full(plane.n, -1)
    if rule in ("random", "free", "tips"):
        found = find_candidates(plane, targets)
        found = found.select(~plane.offline[found.positioner])
        if rule == "random":
            return _at_random(plane.n, len(targets), found, rng)
        if rule == "free":
            return _matched(plane.n, len(targets), found, rng)
        return _packed(plane.n, targets, found, exclusion_mm, rng)
    seed = int(rng.integers(2**31))
    if rule == "assigned":
        return assign(plane, targets, seed=seed).target
    return assign(plane, targets, seed=seed, approach_deg=0.0, settings=AssignSettings(margin_mm=0.0)).target


def _at_random(n: int, n_targets: int, found: Candidates, rng: np.random.Generator) -> Ints:
    """One unit after the other, in any order, takes any of the targets that are left in its reach."""
    order = rng.permutation(len(found.positioner))
    order = order[np.argsort(rng.permutation(n)[found.positioner[order]], kind="stable")]
    out, free = np.full(n, -1), np.ones(n_targets, dtype=bool)
    for unit, target in zip(found.positioner[order].tolist(), found.target[order].tolist(), strict=True):
        if out[unit] < 0 and free[target]:
            out[unit], free[target] = target, False
    return out


def _matched(n: int, n_targets: int, found: Candidates, rng: np.random.Generator) -> Ints:
    """Most targets, arms in the way or not; of equal choices one at random."""
    units, sky = rng.permutation(n), rng.permutation(n_targets)
    rows = np.argsort(units)[found.positioner]
    columns = np.argsort(sky)[found.target]
    graph = csr_array((np.ones(len(rows)), (rows, columns)), shape=(n, n_targets))
    matched = maximum_bipartite_matching(graph, perm_type="column")
    out = np.full(n, -1)
    out[units] = np.where(matched >= 0, sky[matched], -1)
    return out


def _packed(
    n: int, targets: TargetList, found: Candidates, exclusion_mm: float, rng: np.random.Generator
) -> Ints:
    """Most targets, no two nearer than the exclusion."""
    once = np.unique(np.column_stack([found.positioner, found.target]), axis=0)
    positioner, target = once.T
    near = cKDTree(targets.xy_mm).query_pairs(exclusion_mm, output_type="ndarray")
    level = np.zeros(len(target), dtype=np.int64)
    chosen, _ = pack(positioner, target, level, _pairs(positioner, target, near), rng)
    out = np.full(n, -1)
    out[positioner[chosen]] = target[chosen]
    return out


def _pairs(positioner: Ints, target: Ints, near: Ints) -> tuple[Ints, Ints]:
    """Candidates of two units whose targets are too near; the unit of the first comes first."""
    order = np.argsort(target, kind="stable")
    begin = np.searchsorted(target[order], near)
    end = np.searchsorted(target[order], near, side="right")
    found = [np.zeros((0, 2), dtype=np.int64)]
    for (a, b), (c, d) in zip(begin, end, strict=True):
        one, other = order[a:c], order[b:d]
        pairs = np.stack(np.meshgrid(one, other), axis=-1).reshape(-1, 2)
        found.append(pairs[positioner[pairs[:, 0]] != positioner[pairs[:, 1]]])
    first, second = np.concatenate(found).T
    swap = positioner[first] > positioner[second]
    return np.where(swap, second, first), np.where(swap, first, second)
