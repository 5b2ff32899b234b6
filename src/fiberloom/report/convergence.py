"""Errors of an in-focal-plane calibration by number of configurations, as the paper's Fig. 20."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

_MARKS_UM = [m * 10.0**k for k in range(-2, 3) for m in (1, 2, 5)]


def plot_convergence(
    path: Path, rows: Sequence[Mapping[str, Any]], positioners: int, camera_um: float
) -> None:
    """Draw rms errors (or, without a truth, standard errors) of `convergence` rows, log against log.

    `path`: file to write; `rows`: as `convergence` returns them; `positioners`: their number;
    `camera_um`: noise of the camera, rms.
    """
    figure, axes = plt.subplots(figsize=(8, 5.5), layout="constrained")
    number = [row["configurations"] for row in rows]
    what = "error_um" if rows[0]["error_um"] else "standard_error_um"
    for name, label in (("centre", "centre"), ("l_alpha", "alpha arm"), ("l_beta", "beta arm")):
        values = [row[what][name] for row in rows]
        axes.plot(number, values, marker="o", label=f"{label}, {values[-1]:.2f} µm at {number[-1]}")
    axes.axhline(1.0, color="0.6", linewidth=0.8, linestyle="--")
    axes.text(number[0], 1.04, "1 µm (Kronig 2020, Fig. 20: at about 80)", fontsize=8, color="0.4")
    axes.set(xscale="log", yscale="log", xlabel="configurations", ylabel="rms over positioners [µm]")
    axes.set_xticks(number, [str(n) for n in number])
    axes.minorticks_off()
    low, high = axes.get_ylim()
    marks = [t for t in _MARKS_UM if low <= t <= high]
    axes.set_yticks(marks, [f"{t:g}" for t in marks])
    kind = "error" if what == "error_um" else "standard error"
    axes.set_title(
        f"In-focal-plane calibration of {positioners} positioners, camera {camera_um:g} µm: {kind}"
    )
    axes.legend(fontsize=9)
    figure.savefig(path, dpi=120)
    plt.close(figure)
