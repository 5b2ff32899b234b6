"""Runs kaiju in its own environment: one job as JSON in, its paths as JSON out. Knows nothing of fiberloom.

    .venv-kaiju/bin/python benchmarks/planning/peer_worker.py JOB OUT

As production runs it: from each end of the reconfiguration to the folded lattice by `pathGenMDP2`, greed 0.7,
phobia 0.6, steps of 0.1 deg; then `getPathPair`, smoothing over 21 steps, simplified to 0.2 deg. The 1 s that
production waits before a motion is left out. Its array is made of the numbers in the job.
"""

import json
import sys
import time
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import MagicMock

import numpy as np

STEP_DEG, SMOOTHED, EPSILON_DEG = 0.1, 21, 0.2
GREED, PHOBIA = 0.7, 0.6
DRAWING = ("matplotlib", "matplotlib.pyplot", "descartes", "shapely", "shapely.geometry", "fitsio", "pandas")
"""What kaiju imports to draw, and to read tables that are not asked for here."""


def main() -> None:
    """One job, or its version."""
    if sys.argv[1:] == ["--version"]:
        print(imported().__version__)
        return
    job, out = (Path(name) for name in sys.argv[1:3])
    out.write_text(json.dumps(done(json.loads(job.read_text()))))


def done(job: dict[str, Any]) -> dict[str, Any]:
    """The paths from both ends to the lattice, and what they cost."""
    kaiju = imported()
    legs = [leg(kaiju, job, ends_deg) for ends_deg in job["ends_deg"]]
    return {"version": kaiju.__version__, "legs": legs}


def imported() -> Any:
    """kaiju, without what it does not need here."""
    for name in DRAWING:
        sys.modules[name] = MagicMock()
    defaults = ModuleType("coordio.defaults")
    defaults.__getattr__ = lambda _: 0.0  # type: ignore[method-assign]  # its nominal lengths: all are given
    sys.modules["coordio"] = MagicMock(defaults=defaults)
    sys.modules["coordio.defaults"] = defaults
    import kaiju.robotGrid

    return kaiju


def leg(kaiju: Any, job: dict[str, Any], ends_deg: list[list[float]]) -> dict[str, Any]:
    """From one end to the lattice."""
    grid = grid_of(kaiju, job)
    for robot, (alpha, beta) in zip(job["robots"], ends_deg, strict=True):
        one = grid.robotDict[robot["id"]]
        one.setAlphaBeta(alpha, beta)
        one.setDestinationAlphaBeta(*job["lattice_deg"])
    if touching := grid.getCollidedRobotList():
        return {"failed": sorted(touching), "reason": "it says that they touch", "plan_cpu_s": 0.0}
    begin = time.process_time()
    grid.pathGenMDP2(GREED, PHOBIA)
    middle = time.process_time()
    found: dict[str, Any] = {"plan_cpu_s": middle - begin, "passes": grid.mdp2iter + 1}
    if grid.didFail:
        failed = sorted(r.id for r in grid.robotDict.values() if r.score() != 0)
        return found | {"failed": failed, "reason": "not in the lattice in time"}
    sent, _ = grid.getPathPair(
        speed=job["speed_deg_s"] / 6.0, smoothPoints=SMOOTHED, pathDelay=0, epsilon=EPSILON_DEG
    )
    found["smooth_cpu_s"] = time.process_time() - middle
    step_s = STEP_DEG / job["speed_deg_s"]
    found["sent"] = {str(number): axes(path) for number, path in sent.items()}
    found["raw"] = {
        str(r.id): raw(zip(r.alphaPath, r.betaPath, strict=True), start, step_s)
        for r, start in zip((grid.robotDict[k["id"]] for k in job["robots"]), ends_deg, strict=True)
    }
    return found | {"failed": []}


def grid_of(kaiju: Any, job: dict[str, Any]) -> Any:
    """An array of robots, fiducials and guide cameras in mm and deg."""
    grid = kaiju.robotGrid.RobotGrid(stepSize=STEP_DEG, epsilon=EPSILON_DEG, seed=job["seed"])
    for robot in job["robots"]:
        points = {f"{name}BetaXY": xy for name, xy in robot["points_mm"].items()}
        grid.addRobot(
            robot["id"], str(robot["id"]), [*robot["centre_mm"], 0.0],
            iHat=[1, 0, 0], jHat=[0, 1, 0], kHat=[0, 0, 1], alphaLen=robot["l_alpha_mm"],
            alphaOffDeg=robot["alpha_off_deg"], betaOffDeg=robot["beta_off_deg"], elementHeight=0.0,
            collisionSegBetaXY=[[x, 0.0] for x in job["segment_mm"]],
            collisionBuffer=job["buffer_mm"], **points,
        )  # fmt: skip
    for k, (x, y, radius) in enumerate(job["fiducials_mm"]):
        grid.addFiducial(k, [x, y, 0.0], radius)
    for k, (x0, y0, x1, y1, radius) in enumerate(job["guide_cameras_mm"]):
        grid.addGFA(k, [[x0, y0, 0.0], [x1, y1, 0.0]], radius)
    grid.initGrid()
    return grid


def axes(path: dict[str, list[tuple[float, float]]]) -> dict[str, list[list[float]]]:
    """Times in s and angles in deg of each axis."""
    return {axis: [[t for _, t in path[axis]], [deg for deg, _ in path[axis]]] for axis in ("alpha", "beta")}


def raw(steps: Any, start_deg: list[float], step_s: float) -> dict[str, list[list[float]]]:
    """Its own path before it is smoothed: only the points where the direction changes."""
    points = np.array([start_deg, *([a[1], b[1]] for a, b in steps)])
    times = np.arange(len(points)) * step_s
    bends = np.abs(np.diff(points, 2, axis=0)).max(axis=1) > 1e-9
    kept = np.concatenate([[True], bends, [True]])
    return {
        name: [times[kept].tolist(), column[kept].tolist()]
        for name, column in zip(("alpha", "beta"), points.T, strict=True)
    }


if __name__ == "__main__":
    main()
