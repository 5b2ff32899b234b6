"""What a positioner has been like lately: sums with forgetting, for `fiberloom.health.monitor`."""

from __future__ import annotations

import numpy as np

from fiberloom.health.charts import Rows
from fiberloom.typing import Flags, Floats

WILD = 10.0
"""[A] Standard deviations beyond which a miss weighs less."""
LATELY = 0.05
"""[A] Weight of the newest move in what a positioner needs of late: twenty moves."""


class ArmFit:
    """Least squares with forgetting: offsets of alpha and beta in deg, beta arm's length in mm."""

    PRIOR = np.diag([1.0 / 0.1**2, 1.0 / 0.1**2, 1.0 / 0.02**2])
    """[A] Offsets of 0.1 deg and 20 um of arm length before anything was seen."""

    def __init__(self, n: int, memory: float) -> None:
        self.memory = memory
        self.information = np.tile(self.PRIOR, (n, 1, 1))
        self.weighed = np.zeros((n, 3))

    def add(self, rows: Rows, design: Floats, off_mm: Floats, variance: Floats) -> None:
        """Add the misses of n positioners (`rows`).

        `design` (n, 2, 3): change of the fibre in mm per deg of alpha, of beta, and per mm of the arm;
        `off_mm` (n, 2): misses; `variance` (n, 2, 2) in mm^2: their covariances. Wild ones weigh less.
        """
        weight = np.linalg.inv(variance)
        left = off_mm - np.einsum("nij,nj->ni", design, self._solve()[0][rows])
        square = np.einsum("ni,nij,nj->n", left, weight, left)
        weight *= np.minimum(1.0, WILD / np.sqrt(np.maximum(square, 1e-12)))[:, None, None]
        gathered = design.transpose(0, 2, 1) @ weight
        kept = self.memory * (self.information[rows] - self.PRIOR) + self.PRIOR
        self.information[rows] = kept + gathered @ design
        self.weighed[rows] = self.memory * self.weighed[rows] + np.einsum("nij,nj->ni", gathered, off_mm)

    def _solve(self) -> tuple[Floats, Floats]:
        """(N, 3) estimates and their standard deviations."""
        covariance = np.linalg.inv(self.information)
        sd = np.sqrt(np.einsum("nii->ni", covariance))
        return np.einsum("nij,nj->ni", covariance, self.weighed), sd

    def offsets_deg(self) -> Floats:
        """(N, 2) estimated offsets of the angles."""
        return self._solve()[0][:, :2]

    def longer_mm(self) -> Floats:
        """(N,) estimated growth of the beta arm."""
        return self._solve()[0][:, 2]

    def solved(self, row: int) -> Floats:
        """(3,) estimates of one positioner."""
        return np.linalg.solve(self.information[row], self.weighed[row])

    def longer(self, limit_mm: float, alarm: float) -> Floats:
        """(N,) evidence over the alarm that an arm's length is beyond the limit."""
        value, sd = self._solve()
        beyond = np.maximum(np.abs(value[:, 2]) - limit_mm, 0.0)
        return 0.5 * (beyond / sd[:, 2]) ** 2 / alarm

    def far(self, limit_deg: Floats) -> Floats:
        """(N,) log likelihood that an angle is off by more than the limit (N,)."""
        value, sd = self._solve()
        beyond = np.maximum(np.abs(value[:, :2]) - limit_deg[:, None], 0.0)
        doubt: Floats = 0.5 * ((beyond / sd[:, :2]) ** 2).max(axis=1)
        return doubt

    def forget(self, rows: Rows) -> None:
        """Begin anew."""
        self.information[rows], self.weighed[rows] = self.PRIOR, 0.0


class Habit:
    """What is usual for one positioner: mean of its first moves, then of its last ones."""

    def __init__(self, n: int, settle: int) -> None:
        self.settle = settle
        self.count = np.zeros((n, 2), dtype=np.int64)
        self.usual, self.lately = np.zeros((n, 2)), np.zeros((n, 2))

    def over(self, value: Floats) -> tuple[Floats, Flags]:
        """How much each value is over its habit, in the unit of the value (torque: Nm), and where that
        is known.
        """
        here = np.isfinite(value)
        learning = here & (self.count < self.settle)
        self.count += here
        self.usual += np.where(learning, (np.nan_to_num(value) - self.usual) / np.maximum(self.count, 1), 0.0)
        known = here & ~learning
        self.lately += np.where(known, LATELY * (np.nan_to_num(value) - self.usual - self.lately), 0.0)
        return np.nan_to_num(value) - self.usual, known

    def rise(self, row: int, axis: int) -> float:
        """Mean excess of late over its habit, in the unit of the values (torque: Nm)."""
        return float(self.lately[row, axis])

    def forget(self, rows: Rows) -> None:
        """Begin anew."""
        self.count[rows], self.usual[rows], self.lately[rows] = 0, 0.0, 0.0


class WayShare:
    """Share of the way that was gone, by axis and direction, of the last ways."""

    MEMORY = 0.95
    """[A] About twenty ways."""

    def __init__(self, n: int) -> None:
        self.asked, self.gone = np.zeros((n, 2, 2)), np.zeros((n, 2, 2))

    def add(self, way: Floats, gain: Floats, where: Flags) -> None:
        """Add moves: the `way` commanded and the `gain` beyond it, (N, 2) in deg, `where` they count.

        Each is weighted by the square of the way, because long ways tell more.
        """
        for direction, going in enumerate((way < 0.0, way >= 0.0)):
            here = where & going
            for total, step in ((self.asked, way * way), (self.gone, way * (way + gain))):
                new = self.MEMORY * total[:, :, direction] + np.where(here, step, 0.0)
                total[:, :, direction] = np.where(here, new, total[:, :, direction])

    def of(self, row: int, axis: int, direction: int) -> float:
        """The share; 1 where nothing is known."""
        asked = self.asked[row, axis, direction]
        return float(self.gone[row, axis, direction] / asked) if asked else 1.0

    def forget(self, rows: Rows) -> None:
        """Begin anew."""
        self.asked[rows], self.gone[rows] = 0.0, 0.0
