"""Where ways apart begin: after a collision, by plan or on the twin, and after a stop on the way."""

from __future__ import annotations

import asyncio
from functools import cache

import numpy as np

from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.field import Field
from fiberloom.instruments import FocalPlane
from fiberloom.planning import Plan, PlanSettings, plan, random_pair, untangle
from fiberloom.planning.crashes import random_crash
from fiberloom.studies.untangling import collide_and_untangle

from ..planning import pairs
from .judge import Case, Judged, judge, proven_off

STOPS = ("stop", "displaced")
"""All stop: where they say they are, or elsewhere, by up to so much, and it is known. In both, the arms are
where they are said to be to within so much."""
REAL = "real"
PER_PLAN = 10
"""Stops on each plan from A to B."""


@cache
def plane_of(array: str) -> FocalPlane:
    """`real`, or `hexagon N`. Raises FileNotFoundError where the real tables are not there."""
    if array != REAL:
        return FocalPlane.of("sdssv", n=int(array.split()[1]))
    layout = pairs.real_layout()
    if layout is None:
        raise FileNotFoundError(f"the real array: there is no {pairs.REAL}")
    return pairs.array_of(str(layout))


@cache
def maps_of(array: str) -> TransmissionMaps:
    """Of the twin's units."""
    return Field.twin(plane_of(array), camera="noise").run.calibrate()


@cache
def plan_of(array: str, seed: int, in_hand_mm: float) -> Plan:
    """From A to B of a seed."""
    plane = plane_of(array)
    settings = PlanSettings(in_hand_mm=in_hand_mm)
    return plan(plane, *random_pair(plane, seed), seed=seed, settings=settings)


def after_stop(case: Case, in_hand_mm: float) -> Judged:
    """Folded from a random moment of a plan."""
    plane = plane_of(case.array)
    made = plan_of(case.array, case.seed // PER_PLAN, in_hand_mm)
    rng = np.random.default_rng([case.seed, 0x570])
    moment = np.array([rng.uniform(0.0, made.duration_s)])
    here = np.array([robot.at(moment)[0] for robot in made.robots])
    displaced, off = rng.uniform(-case.off_deg, case.off_deg, (2, plane.n, 2))
    if case.start == "displaced":
        here = here + displaced
    return judge(plane, untangle(plane, here, seed=case.seed), off, whole=True)


def after_crash(case: Case) -> Judged:
    """Folded from a random field in which one or two moved until they met something."""
    plane = plane_of(case.array)
    crash = random_crash(plane, case.seed, case.start)
    off = np.random.default_rng([case.seed, 0x0FF]).uniform(-case.off_deg, case.off_deg, (plane.n, 2))
    return judge(crash.plane, untangle(crash.plane, crash.start_deg, seed=case.seed), off)


def on_twin(case: Case) -> Judged:
    """The same with a collision on the twin, carried out by the firmware."""
    kind = case.start.removeprefix("twin ")
    plane, maps = plane_of(case.array), maps_of(case.array)
    seen = asyncio.run(collide_and_untangle(plane, maps, case.seed, kind, case.off_deg))
    return Judged(
        len(seen.found[0].overlaps),
        seen.free,
        bool(seen.touches) or kind == "buffer",
        len(seen.new_touches),
        seen.positioners - seen.at_goal - (kind == "immobile"),
        sum(len(found.stages) for found in seen.found),
        sum(found.duration_s for found in seen.found),
        max(found.cpu_s for found in seen.found),
        tuple(off for found in seen.found for off in proven_off(found)),
    )
