"""From places of fibres to angles of motors: which elbow, which turn of theta, and where a hidden fibre is.

A fibre at one place can belong to four poses: two elbows where phi can pass the folded or the stretched arm,
two turns where theta can turn by more than 360 deg. One image does not tell; what motors did between images
does. The likeliest sequence of poses is followed (Viterbi), so a wrong choice is put right by the next move.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fiberloom.drive.piezo.cobras import CobraArms
from fiberloom.drive.piezo.learning import LearningLaw
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import UM_PER_MM

POSES = 4
LEAST_SIGMA_DEG = 1.0
"""No motor is trusted to end nearer to where it should, where poses are told apart."""
FREEDOM = 2.0
"""Of the Student distribution of how far off moves end: some motors scatter much more than most."""
IMPOSSIBLE = 1e6
LINEARISED = 2
"""So often the arm is taken to be linear: at the pose seen, then at the better one."""
SAMPLES, FEWEST_SAMPLES = 400, 4
"""Poses that are drawn to find where a hidden fibre may be, and how many must be behind the dot."""


class _Expected(NamedTuple):
    """Where n cobras are expected before an image."""

    place_deg: Floats
    """(n, 2)."""
    covariance_deg2: Floats
    """(n, 2, 2)."""


class Tracker:
    """Poses of n cobras; tells the law of their motors where these are."""

    def __init__(
        self, arms: CobraArms, law: LearningLaw, dots_mm: Floats | None = None, seed: int = 0
    ) -> None:
        """`arms`; `law`: of their 2 n motors; `dots_mm` (n, 3): x, y, radius; `seed` of what is drawn."""
        self.arms, self.law, self.dots_mm = arms, law, dots_mm
        n = len(arms)
        self.hidden, self.lost = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        self._rng = np.random.default_rng(seed)
        self._poses = np.zeros((n, POSES, 2))
        self._cost = np.full((n, POSES), IMPOSSIBLE)
        self._cross = np.zeros(n)
        """(n,) deg^2, covariances of theta and phi: what an image says of an arm that is nearly straight."""

    @property
    def place_deg(self) -> Floats:
        """(n, 2) where they are believed to be, in deg."""
        assert self.law.place_deg is not None
        return self.law.place_deg.reshape(-1, 2)

    @property
    def sigma_deg(self) -> Floats:
        """(n, 2) standard deviations of that in deg."""
        return np.sqrt(self.law.place_variance.reshape(-1, 2))

    def believe(self, place_deg: Floats, sigma_deg: float | Floats) -> None:
        """They are at `place_deg` (n, 2), known to `sigma_deg`: as after homing."""
        variance = np.broadcast_to(np.square(sigma_deg), place_deg.shape)
        self.law.believe(place_deg.ravel(), variance.ravel())
        self._poses[:] = place_deg[:, None]
        self._cost[:] = IMPOSSIBLE
        self._cost[:, 0] = 0.0
        self._cross[:] = 0.0

    def stand(self, rows: Flags, place_deg: Floats, sigma_deg: float) -> None:
        """Cobras `rows` (n,) are at `place_deg` (n, 2), known to `sigma_deg`, whatever was believed."""
        both = np.repeat(rows, 2)
        self.law.place_deg = np.where(both, place_deg.ravel(), self.place_deg.ravel())
        self.law.place_variance = np.where(both, sigma_deg**2, self.law.place_variance)
        self._poses[rows] = place_deg[rows, None]
        self._cost[rows] = np.where(np.arange(POSES) == 0, 0.0, IMPOSSIBLE)
        self._cross[rows] = 0.0

    def see(self, xy_mm: Floats, camera_um: float | Floats) -> None:
        """An image: fibres at `xy_mm` (n, 2), NaN where not seen, with an error in um per axis."""
        seen = np.asarray(np.isfinite(xy_mm).all(axis=1), dtype=np.bool_)
        sigma = self.law.innovation_sigma_deg().reshape(-1, 2)
        before, best = self._follow(xy_mm, seen, np.maximum(sigma, LEAST_SIGMA_DEG))
        rows = np.arange(len(self.arms))
        pose = self._poses[rows, best]
        assert self.law.place_deg is not None
        self.law.place_deg = before.ravel()
        moved, expected = self.law.has_moved, self._expected()
        error = self.arms.sigma_deg(np.where(seen[:, None], pose, before), camera_um)
        self.law.see(np.where(seen[:, None], pose, np.nan).ravel(), error.ravel())
        if moved:
            self._weigh(expected, np.where(seen[:, None], xy_mm, np.nan), pose, camera_um)
        else:
            self._cross[seen] = 0.0
        # all images so far tell where the likeliest track is, not the last one alone
        self._poses[rows, best] = self.place_deg
        self._look_behind_dots(~seen)

    def _expected(self) -> _Expected:
        """Where they should be now."""
        covariance = np.zeros((len(self.arms), 2, 2))
        covariance[:, (0, 1), (0, 1)] = self.law.innovation_sigma_deg().reshape(-1, 2) ** 2
        covariance[:, 0, 1] = covariance[:, 1, 0] = self._cross
        return _Expected(self.law.expected_deg().reshape(-1, 2).copy(), covariance)

    def _weigh(self, before: _Expected, xy_mm: Floats, pose_deg: Floats, camera_um: float | Floats) -> None:
        """Both angles of each cobra, from where it was expected `before` and from its image.

        One by one the angles of a nearly straight arm are seen badly; the place of the fibre, which both
        make, is seen as well as ever. `xy_mm` (n, 2) of fibres, NaN where not seen; `pose_deg` (n, 2) that
        the image alone says; it errs by `camera_um` per axis.
        """
        expected, prior = before
        seen = np.asarray(np.isfinite(xy_mm).all(axis=1), dtype=np.bool_)
        noise = (np.broadcast_to(camera_um, seen.shape) / UM_PER_MM)[:, None, None] ** 2 * np.eye(2)
        there = pose_deg
        for _ in range(LINEARISED):
            turns = self.arms.jacobian_mm(there) * np.deg2rad(1.0)
            off_mm = xy_mm - self.arms.xy_mm(there) + np.einsum("nij,nj->ni", turns, there - expected)
            spread = prior @ turns.transpose(0, 2, 1)
            share = np.linalg.solve(turns @ spread + noise, spread.transpose(0, 2, 1)).transpose(0, 2, 1)
            there = np.where(seen[:, None], expected + np.einsum("nij,nj->ni", share, off_mm), expected)
        left = np.where(seen[:, None, None], prior - share @ turns @ prior, prior)
        self.law.place_deg = np.clip(there, 0.0, self.arms.range_deg).ravel()
        self.law.place_variance = np.maximum(left[:, (0, 1), (0, 1)], 0.0).ravel()
        self._cross = left[:, 0, 1]

    def _follow(self, xy_mm: Floats, seen: Flags, sigma: Floats) -> tuple[Floats, Ints]:
        """New poses and costs; the pose (n, 2) that the best one came from, and which (n,) is the best."""
        told = (self.law.expected_deg() - self.place_deg.ravel()).reshape(-1, 2)
        expected = np.clip(self._poses + told[:, None], 0.0, self.arms.range_deg[:, None])
        poses, possible = self._candidates(xy_mm, expected, seen)
        off = (poses[:, None] - expected[:, :, None]) / sigma[:, None, None]
        step = 0.5 * (FREEDOM + 1.0) * np.log1p(off**2 / FREEDOM).sum(axis=3)
        total = self._cost[:, :, None] + np.where(possible[:, None], step, IMPOSSIBLE)
        rows, came_from = np.arange(len(poses)), total.argmin(axis=1)
        cost = total.min(axis=1)
        best = cost.argmin(axis=1)
        before = self._poses[rows, came_from[rows, best]]
        self._poses, self._cost = poses, cost - cost.min(axis=1, keepdims=True)
        return before, best

    def _candidates(self, xy_mm: Floats, expected: Floats, seen: Flags) -> tuple[Floats, Flags]:
        """(n, 4, 2) poses at which a fibre is where it was seen, else as expected; and which are possible."""
        found = self.arms.poses_deg(xy_mm)
        possible = np.asarray(np.isfinite(found).all(axis=2), dtype=np.bool_)
        possible[~seen.repeat(POSES).reshape(-1, POSES)] = True
        # each possible pose of a hidden fibre comes from its own
        return np.where(seen[:, None, None], np.nan_to_num(found), expected), possible

    def may_hide(self) -> Flags:
        """(n,) cobras whose fibre may be behind its dot, after what was sent last."""
        hides = np.zeros(len(self.arms), dtype=bool)
        if self.dots_mm is None:
            return hides
        expected = self.law.expected_deg().reshape(-1, 2)
        sigma = self.law.innovation_sigma_deg().reshape(-1, 2)
        for row, dot_mm in enumerate(self.dots_mm):
            hides[row] = len(self._draws_behind(row, dot_mm, expected[row], sigma[row])) >= FEWEST_SAMPLES
        return hides

    def _draws_behind(self, row: int, dot_mm: Floats, place_deg: Floats, sigma_deg: Floats) -> Floats:
        """(k, 2) of SAMPLES drawn poses in deg those with the fibre behind the dot."""
        draws = place_deg + sigma_deg * self._rng.standard_normal((SAMPLES, 2))
        draws = np.clip(draws, 0.0, self.arms.range_deg[row])
        rows: Ints = np.full(SAMPLES, row)
        at = self.arms.segments_mm(draws, rows)[:, 2:]
        behind: Floats = draws[np.hypot(*(at - dot_mm[:2]).T) < dot_mm[2]]
        return behind

    def _look_behind_dots(self, unseen: Flags) -> None:
        """Fibres that are not seen are behind their dot, if they may be there; else they are lost."""
        self.hidden[:], self.lost[:] = False, unseen
        if self.dots_mm is None:
            return
        for row in np.flatnonzero(unseen):
            self._behind(int(row), self.dots_mm[row])

    def _behind(self, row: int, dot_mm: Floats) -> None:
        behind = self._draws_behind(row, dot_mm, self.place_deg[row], self.sigma_deg[row])
        if len(behind) < FEWEST_SAMPLES:
            return
        self.hidden[row], self.lost[row] = True, False
        assert self.law.place_deg is not None
        motors = slice(2 * row, 2 * row + 2)
        self.law.place_deg[motors] = behind.mean(axis=0)
        self.law.place_variance[motors] = behind.var(axis=0) + LEAST_SIGMA_DEG**2
        self._cross[row] = 0.0
        self._poses[row] = behind.mean(axis=0)
        self._cost[row] = np.where(np.arange(POSES) == 0, 0.0, IMPOSSIBLE)
