"""Random pairs A to B on generated and real arrays, and what our planner makes of one."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from fiberloom.instruments import FocalPlane, generate, instrument_names, load_instrument, read_layout
from fiberloom.planning import MotionLimits, Plan, PlanSettings, Verification, plan, random_pair, verify
from fiberloom.typing import Floats

INSTRUMENT = load_instrument("sdssv")
ROOT = Path(__file__).parents[2]
REAL = "shared/data/sdssv/apo_2024.04.01"
ANY = MotionLimits(speed_deg_s=1e9, acceleration_deg_s2=1e12)
"""Only the bodies are looked at: kaiju limits no acceleration."""


@dataclass(frozen=True)
class Made:
    """One plan of ours and what it took."""

    plan: Plan
    found: Verification
    plan_cpu_s: float
    """All threads; what `plan` verifies itself is in it."""
    verify_cpu_s: float


def real_layout() -> Path | None:
    """The calibration tables of Apache Point beside the checkout; they are not part of the project."""
    places = [parent / REAL for parent in (ROOT, ROOT.parent, ROOT.parent.parent)]
    return next((place for place in places if place.is_dir()), None)


def array_of(name: str) -> FocalPlane:
    """`hexagon N`, `PRESET N` of another instrument, or a folder of tables."""
    first, _, number = name.partition(" ")
    if first == "hexagon":
        return generate(INSTRUMENT, 0, int(number))
    if first in instrument_names() and number.isdigit():
        return generate(load_instrument(first), 0, int(number))
    return read_layout(Path(name), INSTRUMENT)


def ends_of(plane: FocalPlane, seed: int, buffer_mm: float) -> tuple[Floats, Floats]:
    """Start and goal (N, 2) in deg of a seed: all free, with 0.2 mm to spare."""
    return random_pair(plane, seed, collision_buffer_mm=buffer_mm)


def made_of(plane: FocalPlane, ends_deg: tuple[Floats, Floats], buffer_mm: float, seed: int) -> Made:
    """Plans and verifies; the verifier's time is given apart."""
    settings = PlanSettings(collision_buffer_mm=buffer_mm)
    begin = time.process_time()
    made = plan(plane, *ends_deg, seed=seed, settings=settings)
    middle = time.process_time()
    found = verify(plane, made, start_deg=ends_deg[0], goal_deg=ends_deg[1])
    return Made(made, found, middle - begin, time.process_time() - middle)


def clear(plane: FocalPlane, made: Plan) -> Verification:
    """The verifier's answer about bodies alone."""
    return verify(plane, made, limits=ANY)


def speed_deg_s(plane: FocalPlane) -> float:
    """The speed that plans use, both ours and the peer's."""
    return PlanSettings().of(plane).speed_deg_s or 0.0
