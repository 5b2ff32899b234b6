"""The non-linear transmission of one positioner as the paper's Fig. 10 shows it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fiberloom.calibration.transmission.maps import NEGATIVE, POSITIVE, TransmissionMaps
from fiberloom.instruments.model import AXES
from fiberloom.report.figures import figure_with, save
from fiberloom.timing import part


@part("figures")
def plot_transmission(path: Path, maps: TransmissionMaps, row: int) -> None:
    """Draw delta+ and delta- and the backlash of both axes of one positioner."""
    figure, panels = figure_with((12, 7), 2, 2, sharex="row")
    one = maps.select([row])
    for axis, name in enumerate(AXES):
        low, high = one.output_deg[0, axis, :, [0, -1]].T
        theta_deg = np.linspace(low.max(), high.min(), 2000)
        for direction, label in ((NEGATIVE, "negative contact"), (POSITIVE, "positive contact")):
            delta = one.delta_deg(theta_deg, direction)[0, axis]
            panels[0, axis].plot(theta_deg, delta, linewidth=0.9, label=label)
        backlash = one.backlash_motor_deg(theta_deg)[0, axis]
        panels[1, axis].plot(theta_deg, backlash, linewidth=0.9, color="0.3")
        panels[0, axis].set(title=name, ylabel="δ [deg]", xlabel="θ [deg]")
        panels[0, axis].legend(fontsize=8)
        low, high = backlash.min(), backlash.max()
        panels[1, axis].set(
            ylabel="backlash [motor deg]",
            xlabel="θ [deg]",
            title=f"backlash {low:.0f} to {high:.0f} motor deg",
        )
    figure.suptitle(
        f"Positioner {maps.positioner_id[row]}: deviation from a linear gear of "
        f"{maps.provenance.gear:g}, as calibrated"
    )
    save(figure, path)
