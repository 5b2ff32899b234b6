"""The peer, kaiju: asked in its own environment, its paths as plans of ours.

kaiju has no way from A to B: it goes from A to the folded lattice and from there to B. Both ways are planned
towards the lattice, as in production; the second is carried out backwards.
"""

from __future__ import annotations

import json
import math
import os
import resource
import signal
import subprocess
import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.planning import Plan, Trajectory
from fiberloom.typing import Floats
from fiberloom.units import rad_to_deg

ROOT = Path(__file__).parents[2]
PYTHON = ROOT / ".venv-kaiju" / "bin" / "python"
WORKER = Path(__file__).with_name("peer_worker.py")
POINTS = {"met": METROLOGY, "boss": "BOSS", "ap": "APOGEE"}
_KILLED_S = 5
"""Beyond its limit."""
_HANGS = 20
"""Times as much real time as processor time: other work takes cores, and one that waits takes no time."""
DECIMALS_S = 9
"""Times that differ by less are the same."""
Axes = dict[str, list[list[float]]]
"""Of one robot: for alpha and beta times in s and angles in deg."""


@dataclass(frozen=True)
class Answer:
    """What came of one reconfiguration by the peer."""

    failed: dict[int, str]
    """Positioners that do not arrive."""
    plan_cpu_s: float
    """Paths, both ways."""
    smooth_cpu_s: float
    """Smoothing and thinning, both ways."""
    sent: Plan | None
    """What would be sent to the positioners; None where somebody does not arrive."""
    raw: Plan | None
    """Before smoothing."""
    version: str = ""


def why_not(python: Path = PYTHON) -> str:
    """Why there is no peer to compare with; empty where there is one."""
    reason = python.parents[1] / "why-not.txt"
    if reason.is_file():
        return reason.read_text().strip()
    if not python.is_file():
        return f"{python.parents[1].name} is not there; `make kaiju` builds it"
    found = subprocess.run([python, WORKER, "--version"], capture_output=True, text=True, check=False)
    said = found.stderr.strip().splitlines() or [f"python ends with {found.returncode}"]
    return said[-1] if found.returncode else ""


def job_of(
    plane: FocalPlane, ends_deg: tuple[Floats, Floats], buffer_mm: float, speed_deg_s: float, seed: int
) -> dict[str, Any]:
    """What the worker needs, in mm and deg: bodies, speed, start and goal."""
    points = {short: np.nan_to_num(plane.points[name]) for short, name in POINTS.items()}
    robots = [
        {
            "id": int(number),
            "centre_mm": list(arm[:2]),
            "l_alpha_mm": arm[2],
            "alpha_off_deg": rad_to_deg(arm[3]),
            "beta_off_deg": rad_to_deg(arm[4]),
            "points_mm": {short: xy[row].tolist() for short, xy in points.items()},
        }
        for row, (number, arm) in enumerate(zip(plane.positioner_id, plane.arms.tolist(), strict=True))
    ]
    return {
        "robots": robots,
        "segment_mm": list(plane.beta_segment_mm),
        "buffer_mm": buffer_mm,
        "fiducials_mm": plane.fiducials.tolist(),
        "guide_cameras_mm": plane.guide_cameras.tolist(),
        "lattice_deg": list(plane.instrument.positioner.park_deg),
        "speed_deg_s": speed_deg_s,
        "ends_deg": [np.asarray(end).tolist() for end in ends_deg],
        "seed": seed,
    }


def asked(plane: FocalPlane, job: dict[str, Any], limit_s: float, python: Path = PYTHON) -> Answer:
    """One reconfiguration; where it takes more than `limit_s` of processor time, whole s, nobody arrives."""
    with tempfile.TemporaryDirectory() as folder:
        names = [Path(folder) / name for name in ("job.json", "out.json")]
        names[0].write_text(json.dumps(job))
        words = [str(python), str(WORKER), *map(str, names)]
        alone = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": ""}
        limit_s = math.ceil(limit_s)
        limits = partial(resource.setrlimit, resource.RLIMIT_CPU, (limit_s, limit_s + _KILLED_S))
        try:
            done = subprocess.run(
                words, env=alone, capture_output=True, text=True, check=False,
                preexec_fn=limits, timeout=_HANGS * limit_s,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return _none(plane, f"not ready after {_HANGS * limit_s} s of real time")
        if done.returncode == -signal.SIGXCPU:
            return _none(plane, f"not ready after {limit_s} CPU s", float(limit_s))
        if done.returncode:  # its memory grows with positioners and time: some GB for thousands
            said = done.stderr.strip().splitlines()[-1:]
            return _none(plane, f"ended with {done.returncode} {' '.join(said)}".strip())
        return answer_of(plane, json.loads(names[1].read_text()), job["buffer_mm"])


def _none(plane: FocalPlane, reason: str, cpu_s: float = 0.0) -> Answer:
    """Nobody arrives."""
    return Answer(dict.fromkeys(plane.positioner_id.tolist(), reason), cpu_s, 0.0, None, None)


def answer_of(plane: FocalPlane, out: dict[str, Any], buffer_mm: float) -> Answer:
    """The worker's JSON, as plans."""
    legs = out["legs"]
    failed = {int(p): leg["reason"] for leg in legs for p in leg["failed"]}
    cpu = [sum(leg.get(key, 0.0) for leg in legs) for key in ("plan_cpu_s", "smooth_cpu_s")]
    if failed:
        return Answer(failed, *cpu, None, None, out["version"])
    sent, raw = (as_plan(plane, [leg[key] for leg in legs], buffer_mm) for key in ("sent", "raw"))
    return Answer({}, *cpu, sent, raw, out["version"])


def as_plan(plane: FocalPlane, legs: list[dict[str, Axes]], buffer_mm: float) -> Plan:
    """Forth along the first leg, back along the second: one trajectory per positioner."""
    end_s = sum(max(axis[0][-1] for path in leg.values() for axis in path.values()) for leg in legs)
    robots = []
    for number in map(int, plane.positioner_id):
        forth, back = (leg[str(number)] for leg in legs)
        ways = [_there_and_back(forth[axis], back[axis], end_s) for axis in ("alpha", "beta")]
        time_s = np.unique(np.concatenate([way[0] for way in ways]))
        robots.append(Trajectory(number, time_s, *(np.interp(time_s, *way) for way in ways)))
    return Plan(plane.instrument.name, buffer_mm, tuple(robots))


def _there_and_back(forth: list[list[float]], back: list[list[float]], end_s: float) -> tuple[Floats, Floats]:
    """Times and angles of one axis. It waits in the lattice where it is there early."""
    there, home = (np.array(way, dtype=np.float64) for way in (forth, back))
    time_s = np.round(np.concatenate([there[0], end_s - home[0][::-1]]), DECIMALS_S)
    angle_deg = np.concatenate([there[1], home[1][::-1]])
    keep = np.concatenate([[True], np.diff(time_s) > 0.0])
    return time_s[keep], angle_deg[keep]
