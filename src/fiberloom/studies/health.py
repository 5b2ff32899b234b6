"""How soon `fiberloom.health.monitor` finds what ails positioners, and how often it is wrong.

Years of operation on the statistical twin: field after field by blind move and corrections, through maps
calibrated at the beginning, with wear, and with ailments that begin some day. The monitor sees
what operation sees. `health_trial` is an experiment for `fiberloom.studies.campaign`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fiberloom.errors import InputError
from fiberloom.health.monitor import Ailment, HealthMonitor, ObservedMove, State
from fiberloom.studies.lifetime import LifetimeSettings, calibrate
from fiberloom.studies.years import Visit, Years
from fiberloom.twin.bench import bench_units
from fiberloom.twin.faults.ailments import NEVER, STALL_PER_INERTIA, AilmentModel, draw_ailments
from fiberloom.twin.noise import UnitNoise
from fiberloom.twin.statistical import StatisticalTwin
from fiberloom.twin.wear import WearModel
from fiberloom.typing import Array, Floats
from fiberloom.units import MM_PER_UM

EFFORT_SD = 0.03
"""Scatter of the mean torque of a move over the torque of a stall. ASSUMED."""
AXES_APART_DEG = 16.0
"""Targets keep beta this far from stretched and folded."""


@dataclass(frozen=True)
class TrialSettings:
    """What a trial does."""

    instrument: str = "sdssv"
    fields: int = 8000
    """A year: 24 000 moves."""
    corrections: int = 2
    look_every: int = 4
    """Fields between two looks at the findings: what an operator reads."""
    ailments: AilmentModel = field(default_factory=AilmentModel)
    wear: WearModel = field(default_factory=WearModel)

    def __post_init__(self) -> None:
        for name in ("fields", "look_every"):
            if getattr(self, name) < 1:
                raise InputError(f"health trial: {name} = {getattr(self, name)}, must be at least 1")


def health_trial(units: range, seed: int, settings: TrialSettings) -> dict[str, Array]:
    """Rows, one for each unit; all numbers are counts of moves.

    `truth` the ailment, "" for the healthy; `onset` move at which that began (-1: never), `suspected`,
    `found` moves of the first finding of that state or worse since then (-1: none), `named` the first
    certain name and `last` the last one; `false` number of certain findings before anything was wrong,
    `healthy_moves` the moves in which that could have happened.
    """
    return _Trial(units, seed, settings).run()


class _Trial:
    def __init__(self, units: range, seed: int, settings: TrialSettings) -> None:
        self.settings = settings
        layout, new = bench_units(settings.instrument, seed, units)
        ailments = draw_ailments(new, seed, settings.ailments)
        self.years = Years(layout, new, seed, wear=settings.wear, ailments=ailments)
        self.onset = ailments.table["onset"]
        self.draw = UnitNoise(seed, 0x4EA1, new.number)
        self.sigma_mm = layout.instrument.metrology.noise_rms_um * MM_PER_UM / np.sqrt(2.0)
        self.maps, self.plane, _ = calibrate(
            StatisticalTwin(layout, new, seed=seed), LifetimeSettings(settings.instrument), self._seen
        )
        self.monitor = HealthMonitor(self.plane)
        n = len(new)
        self.believed = np.zeros((n, 2))
        self.known = {int(p): row for row, p in enumerate(self.plane.positioner_id)}
        self.rows: dict[str, Array] = {
            "truth": np.where(self.onset == NEVER, "", ailments.table["kind"]).astype("U16"),
            "suspected": np.full(n, -1),
            "found": np.full(n, -1),
            "false": np.zeros(n, dtype=np.int64),
            "named": np.zeros(n, "U16"),
            "last": np.zeros(n, "U16"),
            "false_name": np.zeros(n, "U16"),
        }

    def run(self) -> dict[str, Array]:
        """All fields."""
        for k in range(self.settings.fields):
            self._field()
            if k % self.settings.look_every == 0:
                self._look()
        total = self.years.move
        self.rows["onset"] = np.where(self.onset >= total, -1, self.onset)
        self.rows["truth"] = np.where(self.onset >= total, "", self.rows["truth"])
        self.rows["healthy_moves"] = np.minimum(self.onset, total)
        return self.rows

    def _seen(self, xy_mm: Floats) -> Floats:
        seen: Floats = xy_mm + self.sigma_mm * self.draw.normal(*xy_mm.shape[1:])
        return seen

    def _field(self) -> None:
        goal = self._goal()
        wanted = goal
        for _ in range(1 + self.settings.corrections):
            visit = self._go(wanted)
            off_mm = visit.measured_mm - self.plane.forward(*goal.T)
            step = np.linalg.solve(self.plane.jacobian(*goal.T), off_mm[:, :, None])[:, :, 0]
            small = np.isfinite(step) & (np.abs(step).max(axis=1, keepdims=True) < 1.0)
            wanted = self.believed - np.where(small, step, 0.0)

    def _go(self, wanted_deg: Floats) -> Visit:
        before = self.believed.copy()
        visit = self.years.visit(self.maps.to_wire(wanted_deg))
        self.believed = np.where(visit.done[:, None], wanted_deg, before)
        asked = np.ones(len(self.plane), dtype=bool)
        self.monitor.update(
            ObservedMove(
                before_deg=before,
                believed_deg=self.believed.copy(),
                seen_mm=visit.measured_mm,
                asked=asked,
                arrived=visit.done,
                collided=~visit.done,
                effort=self._effort(visit),
            )
        )
        return visit

    def _effort(self, visit: Visit) -> Floats:
        plant = self.years.twin.units.plant
        stall = STALL_PER_INERTIA * (plant["inertia_motor"] + plant["inertia_gear"])
        effort: Floats = visit.torque_Nm / stall + EFFORT_SD * self.draw.normal(2)
        return effort

    def _goal(self) -> Floats:
        low, high = self.plane.limits_deg.T + np.array([[2.0, AXES_APART_DEG], [-2.0, -AXES_APART_DEG]])
        angles: Floats = low + (high - low) * self.draw.uniform(2)
        return angles

    def _look(self) -> None:
        move = self.years.move - 1
        for finding in self.monitor.findings():
            row = self.known[finding.positioner_id]
            if move < self.onset[row]:
                self._false(row, finding.state, finding.ailment)
                continue
            self._first("suspected", row, move)
            if finding.state != State.SUSPECT:
                if self.rows["found"][row] < 0:
                    self.rows["named"][row] = finding.ailment
                self._first("found", row, move)
                self.rows["last"][row] = finding.ailment

    def _false(self, row: int, state: State, ailment: Ailment) -> None:
        """An operator looks, finds nothing, and begins anew."""
        if state != State.SUSPECT:
            self.rows["false"][row] += 1
            self.rows["false_name"][row] = ailment
            self.monitor.forget(int(self.plane.positioner_id[row]))

    def _first(self, name: str, row: int, move: int) -> None:
        if self.rows[name][row] < 0:
            self.rows[name][row] = move
