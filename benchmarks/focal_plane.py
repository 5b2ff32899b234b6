"""Errors of the in-focal-plane calibration by number of configurations (Kronig 2020, Fig. 20).

A study of fit and design alone: 500 positioners, configurations that all can stand in (chosen by the
design, and at random), angles off by what maps of 200 points leave, a camera of 0.669 um. The same
with everything in it is `fiberloom calibrate focal-plane`.
"""

import argparse
import dataclasses
import json
from pathlib import Path

import numpy as np

from fiberloom.calibration.focal_plane.design import LEAST_BEND_DEG, Design, candidates
from fiberloom.calibration.focal_plane.fit import FitSettings, fit_focal_plane, layout_parameters
from fiberloom.instruments import generate, load_instrument
from fiberloom.planning.placing import place_by_worth

NUMBERS = (6, 10, 20, 40, 80)
SAFETY_MM = 0.5
MOUNTED_MM, MOUNTED_RAD = 0.05, np.deg2rad(0.2)


def configurations(plane, designed, seed):
    """(N, 80, 2) deg, one after the other."""
    wide = plane.with_collision_buffer(plane.collision_buffer_mm + SAFETY_MM)
    design, rng, out = Design(plane), np.random.default_rng(seed), []
    for k in range(max(NUMBERS)):
        options = candidates(wide, rng)
        worth = design.worth(options) if designed else rng.random(options.shape[:2])
        out.append(place_by_worth(wide, options, worth, k))
        design.add(out[-1], np.ones(plane.n, dtype=bool))
    return np.stack(out, axis=1)


def measured(plane, theta, settings, rng):
    """Positions (N, S, 2) of positioners mounted at `plane`."""
    real = theta + rng.normal(size=theta.shape) * settings.angles_deg
    xy = [plane.forward(real[:, k, 0], real[:, k, 1]) for k in range(theta.shape[1])]
    noise = rng.normal(0.0, settings.camera_um * 1e-3 / np.sqrt(2.0), theta.shape)
    return np.stack(xy, axis=1) + noise


def study(n, seed):
    """Rows of the table."""
    plane, settings = generate(load_instrument("sdssv"), seed, n_positioners=n), FitSettings()
    rng = np.random.default_rng([seed, 1])
    sigmas = np.array([MOUNTED_MM] * 3 + [MOUNTED_RAD] * 2)
    truth = dataclasses.replace(plane, arms=plane.arms + rng.normal(size=plane.arms.shape) * sigmas)
    rows = []
    for kind in ("designed", "random"):
        theta = configurations(plane, kind == "designed", seed)
        xy = measured(truth, theta, settings, rng)
        for number in NUMBERS:
            fit = fit_focal_plane(plane, theta[:, :number], xy[:, :number], settings)
            error = (fit.parameters - layout_parameters(truth))[:, :4]
            rows.append({"configurations": number, "kind": kind} | summary(error, fit.sigma[:, :4]))
    return rows


def summary(error_mm, sigma_mm):
    """rms and worst of one fit."""
    rms = 1e3 * np.sqrt((error_mm**2).mean(axis=0))
    return {
        "centre_um": float(np.hypot(*rms[:2])),
        "l_alpha_um": float(rms[2]),
        "l_beta_um": float(rms[3]),
        "worst_um": 1e3 * float(np.abs(error_mm).max()),
        "pull_rms": float(np.sqrt(((error_mm / sigma_mm) ** 2).mean())),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--positioners", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    rows = study(asked.positioners, asked.seed)
    print(f"{asked.positioners} positioners, beta above {LEAST_BEND_DEG:g} deg, arms {SAFETY_MM} mm thicker")
    print("configurations  kind      centre  l_alpha  l_beta   worst  [um]   pull rms")
    for r in rows:
        print(
            f"{r['configurations']:14d}  {r['kind']:8s}  {r['centre_um']:6.2f}  {r['l_alpha_um']:7.2f}"
            f"  {r['l_beta_um']:6.2f}  {r['worst_um']:6.2f}         {r['pull_rms']:.2f}"
        )
    if asked.out:
        asked.out.parent.mkdir(parents=True, exist_ok=True)
        asked.out.write_text(json.dumps({"seed": asked.seed, "rows": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
