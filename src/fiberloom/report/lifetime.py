"""Figures of a lifetime test: Kronig 2020, Fig. 21, 22, 25 and 26."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from fiberloom.instruments.model import AXES
from fiberloom.report.figures import save
from fiberloom.typing import Floats, Ints

STYLES = {
    "linear": ("tab:blue", "-", "linear ratio"),
    "fixed": ("tab:red", "-", "map of the first cycle"),
    "adaptive_paper": ("tab:orange", "-", "adaptive, Eq. 33 as printed"),
    "adaptive": ("tab:green", "-", "adaptive, improved"),
    "recalibrated": ("tab:purple", "-", "recalibrated each cycle"),
    "recalibrated_fine": ("tab:purple", ":", "recalibrated each cycle, four times the points"),
}


@dataclass(frozen=True)
class LifetimeCurves:
    """What a lifetime test found, by positioner."""

    cycles: Ints
    positioner_id: Ints
    blind_um: dict[str, Floats]
    """(N, cycles) rms of blind moves as measured, by way."""
    arms_mm: Floats
    """(N, cycles, 2) alpha and beta arm as calibrated; `true_arms_mm` as they were."""
    true_arms_mm: Floats
    delta_cycles: list[int]
    delta_angles_deg: Floats
    """(2, points)."""
    delta_deg: dict[str, Floats]
    """(N, delta cycles, 2, points): "true", "recalibrated", "adaptive", "adaptive_paper"."""


def rms(error: Floats, axis: int | None = None) -> Floats:
    """Root mean square of an error in um, over those that have not dropped out; NaN where none is left."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of a mean over no unit
        return np.asarray(np.sqrt(np.nanmean(error**2, axis=axis)))


def plot_lifetime(path: Path, curves: LifetimeCurves) -> None:
    """Blind errors by cycle (Fig. 26), and the lengths of the arms (Fig. 21)."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(13, 5.5), layout="constrained")
    late = slice(len(curves.cycles) // 2, None)
    mean = {way: rms(e, axis=0) for way, e in curves.blind_um.items()}
    for way, (colour, line, label) in STYLES.items():
        left.plot(curves.cycles, mean[way], line, color=colour, linewidth=1.6, label=label)
        for each in curves.blind_um[way][: 4 if len(curves.positioner_id) > 1 else 0]:
            left.plot(curves.cycles, each, line, color=colour, linewidth=0.5, alpha=0.5)
    left.set(xlabel="cycle of 15260 moves", ylabel="error of blind moves, rms [µm]", yscale="log")
    left.grid(True, which="both", alpha=0.3)
    um = {way: float(rms(m[late])) for way, m in mean.items()}
    left.set_title(
        f"Learning holds {um['adaptive']:.1f} µm (as printed {um['adaptive_paper']:.1f}); recalibrating "
        f"{um['recalibrated']:.1f},\nthe first map {um['fixed']:.1f}, a linear ratio {um['linear']:.1f} µm"
    )
    left.set_yticks([1, 2, 5, 10, 20, 50], labels=["1", "2", "5", "10", "20", "50"])
    left.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2)
    _plot_arms(right, curves)
    save(figure, path, 120)
    plt.close(figure)


def _plot_arms(panel: Axes, curves: LifetimeCurves) -> None:
    for row in range(min(2, len(curves.positioner_id))):
        for arm, name in enumerate(AXES):
            first = curves.true_arms_mm[row, 0, arm]
            colour = f"C{2 * row + arm}"
            label = f"{name} arm, positioner {curves.positioner_id[row]}"
            panel.plot(
                curves.cycles, 1e3 * (curves.arms_mm[row, :, arm] - first), ".", color=colour, label=label
            )
            panel.plot(
                curves.cycles, 1e3 * (curves.true_arms_mm[row, :, arm] - first), color=colour, linewidth=0.8
            )
    span = 1e3 * np.ptp(curves.arms_mm, axis=1).max()
    panel.set(
        xlabel="cycle of 15260 moves",
        ylabel="length less that of the first cycle [µm]",
        title=f"Arms as calibrated (dots) and in truth (lines): all within {span:.1f} µm",
    )
    panel.grid(True, alpha=0.3)
    panel.legend(fontsize=8)


def plot_deltas(path: Path, curves: LifetimeCurves) -> None:
    """Change of the beta axis' delta since the first cycle, true and as found (Fig. 22 and 25)."""
    later = [i for i, c in enumerate(curves.delta_cycles) if c != curves.cycles[0]] or [0]
    rows = range(min(2, len(curves.positioner_id)))
    figure, panels = plt.subplots(
        len(later),
        len(rows),
        figsize=(6.5 * len(rows), 2.8 * len(later)),
        squeeze=False,
        sharex=True,
        layout="constrained",
    )
    theta = curves.delta_angles_deg[1]
    for line, place in enumerate(later):
        for column, row in enumerate(rows):
            panel = panels[line, column]
            begun = curves.delta_deg["true"][row, 0, 1]
            for name, (colour, width) in _CURVES.items():
                change = curves.delta_deg[name][row, place, 1] - begun
                panel.plot(theta, change, color=colour, linewidth=width, label=name.replace("_", ", "))
            panel.grid(True, alpha=0.3)
            panel.set_title(
                f"positioner {curves.positioner_id[row]}, cycle {curves.delta_cycles[place]}", fontsize=10
            )
            panel.set_ylabel("change of δ [deg]")
    for panel in panels[-1]:
        panel.set_xlabel("beta [deg]")
    panels[0, 0].legend(fontsize=8)
    figure.suptitle(_delta_title(curves))
    save(figure, path, 120)
    plt.close(figure)


def _delta_title(curves: LifetimeCurves) -> str:
    """Sizes in the last snapshot, where targets are."""
    used = slice(len(curves.delta_angles_deg[1]) // 10, -len(curves.delta_angles_deg[1]) // 10)
    last = {name: delta[:, -1, 1, used] for name, delta in curves.delta_deg.items()}
    off = {k: 1e3 * float(np.sqrt(np.mean((last[k] - last["true"]) ** 2))) for k in _CURVES if k != "true"}
    change = np.abs(curves.delta_deg["true"][:, -1, 1] - curves.delta_deg["true"][:, 0, 1]).max()
    first, final = curves.delta_cycles[0], curves.delta_cycles[-1]
    return (
        f"δ of beta less its true course in cycle {first}: wear changes it by {change:.2f} deg at most.\n"
        f"In cycle {final} maps are off by {off['adaptive']:.0f} mdeg rms (adaptive), "
        f"{off['adaptive_paper']:.0f} (as printed), {off['recalibrated']:.0f} (recalibrated)"
    )


_CURVES = {
    "adaptive_paper": ("tab:orange", 0.8),
    "recalibrated": ("tab:purple", 0.8),
    "adaptive": ("tab:green", 1.0),
    "true": ("black", 1.2),
}
