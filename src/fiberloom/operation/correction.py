"""From an image to the next command. Kronig 2020, Eq. 24 and 25, and better.

Plain (Eq. 25, from the first correction on): shift the command by what the last image says,

    r_cmd(i+1) = r_cmd(i) + (r_target - r_meas(i))

which settles at the camera's noise s in truth, and at sqrt(2) s as measured. Filtered: the error of
a positioner is nearly the same after every small move, so all images so far are weighed (Eq. 31 over
the moves). The state is the offset of the two arm angles from the reported ones, and by how much the fibre
is off besides, with their covariance: a Kalman filter. An arm that is some um longer than it is known to be
is off by that wherever its angles are; where it is nearly stretched or folded (beta near 0 or 180 deg) no
small offset of an angle moves the fibre so, and a filter of angles alone would not correct it.

What the map of a gear does not know ripples: over the way of a correction the offset of an angle changes in
proportion to the way. So this slope is in the state too, one number for each axis: a correction that went too
far tells it, and the next one goes as far as it should.

The filter's noise is that of the camera and that of one arrival, both 2-D rms. An arrival's scatter
is new after every move: it adds to the image's noise, not to the offset. After k images the fibre
is then off by sqrt((s^2 + q^2)/k + q^2): 0.37 um for k = 5, s = 0.669 um, q = 0.2 um.

The camera sees the metrology fibre, and the science fibre goes on target. Where angles change to make up for
what the fibre is off, the way from the one to the other turns along: by 11 um for a degree of SDSS-V. So the
science fibre is aimed, and the goal of the metrology fibre follows.

How noisy the camera is, its images tell themselves: from the second one on each fibre's place is predicted,
and hundreds of predictions miss by as much as the noise is. The filter goes through all images again with
the noise with which half of its predictions miss by less than they should.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from fiberloom.instruments import FocalPlane
from fiberloom.metrology.noise import CorrectionNoise
from fiberloom.typing import Flags, Floats
from fiberloom.units import MM_PER_UM, rad_to_deg

# An innovation whose square, in units of its covariance, is above this is no noise: it occurs once in
# 2e5 of two Gaussian numbers. The offset has changed (a slip, a collision): the filter begins anew.
_SURPRISE = 25.0
# The median of such a square: of a chi square with two degrees of freedom.
_MEDIAN = 2.0 * np.log(2.0)
# The camera's variance, over what is said of it: at least and at most. Fewer predictions than this tell none.
_FACTORS, _TRIED, _FEWEST = (0.05, 400.0), 10, 20
# Predictions count for it where the noise of the image is at least this share of what is expected of the way.
_MOSTLY_NOISE = 4.0
# Over such a way the slope of a gear becomes another: a quarter of a period of order 204.
_SLOPE_HOLDS_DEG = 0.4
# A degree that an arm turns is dear as a miss of 3 um; steps of Gauss and Newton.
_DEAR_MM2_DEG2, _AIMS = (3.0 * MM_PER_UM) ** 2, 3
# A command for the plain update keeps this far inside the reach of the arms.
_INSIDE_MM = 1e-6


def plain_update(commanded_mm: Floats, target_mm: Floats, measured_mm: Floats) -> Floats:
    """Eq. 25: the next command (N, 2) in mm of the focal plane, from (N, 2) positions in mm."""
    return commanded_mm + (target_mm - measured_mm)


def whole_steps(here_deg: Floats, wanted_deg: Floats, step_deg: Floats) -> Floats:
    """Angles (N, 2) in deg that a drive can reach in whole steps from where it is.

    `here_deg` and `wanted_deg`: (N, 2) angles now and wanted; `step_deg`: (2,) size of a step of each
    axis at the output, 0 for a continuous drive. A way shorter than half a step is not sent.
    """
    size_deg = np.where(step_deg > 0.0, step_deg, 1.0)
    stepped = here_deg + size_deg * np.rint((wanted_deg - here_deg) / size_deg)
    return np.where(step_deg > 0.0, stepped, wanted_deg)


@dataclass(frozen=True)
class Seen:
    """One image of n positioners."""

    rows: NDArray[np.intp]
    """(n,) which."""
    believed_deg: Floats
    """(n, 2) angles as reported."""
    measured_mm: Floats
    """(n, 2)."""
    noise_mm2: Floats
    """(n, 2, 2) as the camera tells it."""
    way_deg: Floats
    """(n, 2) from the image before; 0 of the first one."""


@dataclass(frozen=True)
class Offsets:
    """Estimated offset of what is true from what is reported and known: k numbers of each positioner.

    In the loop six: the angles alpha and beta in deg, what the fibre is off besides, x and y in mm, and the
    slope of each angle's offset over the angle, deg/deg.
    """

    mean: Floats
    """(N, k) deg, mm and deg/deg."""
    covariance: Floats
    """(N, k, k) products of the units of `mean`: deg^2, deg mm, mm^2, deg, mm, 1."""

    @property
    def angles_deg(self) -> Floats:
        """(N, 2) alpha and beta."""
        return self.mean[:, :2]

    @property
    def place_mm(self) -> Floats:
        """(N, 2) what the fibre is off besides."""
        return self.mean[:, 2:4]

    @property
    def slope(self) -> Floats:
        """(N, 2) of the offsets of alpha and beta over these angles."""
        return self.mean[:, 4:]


def predict(offsets: Offsets, way_deg: Floats, drift: Floats) -> Offsets:
    """Offsets of N positioners after one more move.

    `way_deg`: (N, 2) that the arms went: the angles' offsets have changed by their slope times it; `drift`:
    (N, 6, 6) by which all is less known, deg^2, mm^2 and (deg/deg)^2.
    """
    after = np.broadcast_to(np.eye(6), (len(way_deg), 6, 6)).copy()
    after[:, [0, 1], [4, 5]] = way_deg
    mean = np.einsum("nij,nj->ni", after, offsets.mean)
    return Offsets(mean, after @ offsets.covariance @ after.transpose(0, 2, 1) + drift)


def weigh(
    offsets: Offsets, innovation_mm: Floats, jacobian: Floats, noise_mm2: float | Floats
) -> tuple[Offsets, Floats]:
    """The Kalman update of the offsets of N positioners by measured positions.

    `offsets`: the estimate before, k numbers of each; `innovation_mm`: (N, 2) measured less expected
    positions, finite; `jacobian`: (N, 2, k) mm/deg and mm/mm, positions by these; `noise_mm2`: the variance
    per coordinate, above 0, or the covariances (N, 2, 2). Returns the offsets after, mixed units as in
    `Offsets`, and (N,) the square of each innovation in units of its own covariance, 2 on average.
    """
    p, h = offsets.covariance, jacobian
    noise = noise_mm2 * np.eye(2) if np.ndim(noise_mm2) == 0 else noise_mm2
    ph = p @ h.transpose(0, 2, 1)
    inverse = np.linalg.inv(h @ ph + noise)
    gain = ph @ inverse
    surprise = np.einsum("ni,nij,nj->n", innovation_mm, inverse, innovation_mm)
    keep = np.eye(p.shape[-1]) - gain @ h
    # Joseph's form: stays positive definite whatever the rounding
    covariance = keep @ p @ keep.transpose(0, 2, 1) + gain @ noise @ gain.transpose(0, 2, 1)
    mean = offsets.mean + np.einsum("nij,nj->ni", gain, innovation_mm)
    return Offsets(mean, covariance), surprise


class Corrections(Protocol):
    """From an image to the next command, for N positioners."""

    metrology_goal_mm: Floats
    """(N, 2) where the camera is to see the metrology fibres."""
    rests: Flags
    """(N,) that another move would bring no nearer."""
    camera_factor: float
    """Of the variance that the camera tells, as images show; a ratio."""

    def follow(self, goal_deg: Floats) -> None:
        """Other goals (N, 2) in deg, near the old ones: the targets have gone there."""
        ...

    def update(
        self, believed_deg: Floats, measured_mm: Floats, active: Flags, noise_mm2: Floats | None = None
    ) -> Floats:
        """The angles (N, 2) in deg to command next.

        `believed_deg`, `measured_mm`, `active`, `noise_mm2`: as of `CorrectionLoop.update`.
        """
        ...


class SeenAims:
    """For drives that believe what an image shows: they are told the goal again.

    Their own filter has the image, and knows how motors err.
    """

    def __init__(self, plane: FocalPlane, goal_deg: Floats) -> None:
        """`plane`: layout of N positioners; `goal_deg`: (N, 2) angles that bring the fibres on target."""
        self.goal_deg = goal_deg
        self.metrology_goal_mm = plane.forward(goal_deg[:, 0], goal_deg[:, 1])
        self.rests: Flags = np.zeros(plane.n, dtype=bool)
        self.camera_factor = 1.0
        self._plane = plane

    def follow(self, goal_deg: Floats) -> None:
        """Other goals (N, 2) in deg."""
        self.goal_deg = goal_deg
        self.metrology_goal_mm = self._plane.forward(goal_deg[:, 0], goal_deg[:, 1])

    def update(
        self, believed_deg: Floats, measured_mm: Floats, active: Flags, noise_mm2: Floats | None = None
    ) -> Floats:
        """The goals (N, 2) in deg, whatever the image: the drive has its own filter of it.

        `believed_deg`, `measured_mm`, `active`, `noise_mm2`: as of `CorrectionLoop.update`.
        """
        return self.goal_deg


class CorrectionLoop:
    """Corrects the arms of a whole field towards their goals, image by image."""

    def __init__(
        self,
        plane: FocalPlane,
        goal_deg: Floats,
        *,
        fibre: NDArray[np.str_] | None = None,
        filtered: bool = True,
        noise: CorrectionNoise | None = None,
        sigma_deg: Floats | None = None,
    ) -> None:
        """`plane`: layout of N positioners; `goal_deg`: (N, 2) angles that bring the fibres on target.

        `fibre`: (N,) names of the fibres that go on target, "" or None: that which the camera sees.
        `filtered`: the Kalman filter, else Eq. 25; `noise`: of camera and arrivals, um rms, by default
        that of the plane; `sigma_deg`: (N, 2) standard errors of the maps at the goals, by default from
        `noise.blind_um`.
        """
        self.plane, self.goal_deg, self.filtered = plane, goal_deg, filtered
        self.noise = noise or CorrectionNoise.of(plane)
        self._fibre = np.full(plane.n, "") if fibre is None else np.asarray(fibre)
        every = np.arange(plane.n)
        self.target_mm = self._of_fibre(plane.forward, goal_deg, every)
        """(N, 2) where the fibres shall be."""
        self.metrology_goal_mm = plane.forward(goal_deg[:, 0], goal_deg[:, 1])
        """(N, 2) where the camera is to see the metrology fibres then, by all that is known so far."""
        self._aim_deg: Floats = goal_deg.astype(np.float64)
        """(N, 2) true angles that bring the fibres on target, with what they are off besides."""
        spread = self._spread(self.noise.blind_um)
        if sigma_deg is not None:
            spread = sigma_deg[:, :, None] ** 2 * np.eye(2)
        self._begun = Offsets(np.zeros((plane.n, 6)), self._whole(spread))
        self._images: list[Seen] = []
        self._last_deg = np.full((plane.n, 2), np.nan)
        """(N, 2) angles that each positioner reported at its last image; NaN before the first."""
        self.offsets = self._begun
        self.rests: Flags = np.zeros(plane.n, dtype=bool)
        """(N,) whose fibre is so near to its target by all images that another arrival, which scatters, would
        bring it no nearer."""
        self.camera_factor = 1.0
        """By how much the variance of the camera is larger than it tells, as its images show; a ratio."""

    def follow(self, goal_deg: Floats) -> None:
        """Other goals (N, 2) in deg, near the old ones: what images have told of the arms stays."""
        every = np.arange(self.plane.n)
        moved_mm = self.plane.forward(*goal_deg.T) - self.plane.forward(*self.goal_deg.T)
        self._aim_deg = self._aim_deg + (goal_deg - self.goal_deg)
        self.metrology_goal_mm = self.metrology_goal_mm + moved_mm
        self.goal_deg = goal_deg
        self.target_mm = self._of_fibre(self.plane.forward, goal_deg, every)

    def update(
        self,
        believed_deg: Floats,
        measured_mm: Floats,
        active: Flags,
        noise_mm2: Floats | None = None,
    ) -> Floats:
        """The angles (N, 2) in deg to command next, from the last image; within the hard stops.

        `believed_deg`: (N, 2) angles that the positioners report, or were commanded, by their maps;
        `measured_mm`: (N, 2) metrology fibres in the image, NaN where not seen; `active`: (N,) the
        positioners to correct. Those that are not active or not seen keep their estimate and get their
        goal by it. `noise_mm2`: (N, 2, 2) of each position, new in every image; None: the camera's mean
        for all.
        """
        rows = np.flatnonzero(active & np.isfinite(measured_mm).all(axis=1))
        self.rests[:] = False
        if self.filtered:
            self._learn(rows, believed_deg, measured_mm, noise_mm2)
            self._take_aim(rows)
        wanted = self._commands()
        if self.filtered:
            self.rests[rows] = self._good_enough(self._images[-1], wanted[rows])
        else:
            wanted[rows] = self._plain(rows, believed_deg, measured_mm)
        return self._inside(wanted)

    def _commands(self) -> Floats:
        """(N, 2) angles to command, for the arms to come to the true angles that are aimed at."""
        offset_deg = self.offsets.angles_deg
        here_deg = np.where(np.isfinite(self._last_deg), self._last_deg, self._aim_deg - offset_deg)
        return here_deg + (self._aim_deg - offset_deg - here_deg) / (1.0 + self.offsets.slope)

    def _take_aim(self, rows: NDArray[np.intp]) -> None:
        """Where what the fibre is off besides its angles is made up for by them.

        Least squares of the miss, in which a degree of each angle is dear: where an arm is stretched or
        folded it does not go far for little.
        """
        last_deg, place_mm = self._aim_deg[rows], self.offsets.place_mm[rows]
        aim_deg = last_deg.copy()
        for _ in range(_AIMS):
            h = self._of_fibre(self.plane.jacobian, aim_deg, rows)
            miss_mm = self._of_fibre(self.plane.forward, aim_deg, rows) + place_mm - self.target_mm[rows]
            slope = np.einsum("nki,nk->ni", h, miss_mm) + _DEAR_MM2_DEG2 * (aim_deg - last_deg)
            bend = h.transpose(0, 2, 1) @ h + _DEAR_MM2_DEG2 * np.eye(2)
            aim_deg -= np.linalg.solve(bend, slope[..., None])[..., 0]
        self._aim_deg[rows] = aim_deg
        seen_mm = self.plane.forward(aim_deg[:, 0], aim_deg[:, 1], index=rows)
        self.metrology_goal_mm[rows] = seen_mm + place_mm

    def _of_fibre(self, what: Callable[..., Floats], true_deg: Floats, rows: NDArray[np.intp]) -> Floats:
        """Place or Jacobian of the fibre of each positioner in `rows` (n,) that goes on target."""
        out = what(true_deg[:, 0], true_deg[:, 1], index=rows)
        names = self._fibre[rows]
        for name in np.unique(names[names != ""]).tolist():
            at = np.flatnonzero(names == name)
            out[at] = what(true_deg[at, 0], true_deg[at, 1], name, index=rows[at])
        return out

    def _good_enough(self, seen: Seen, wanted_deg: Floats) -> Flags:
        """(n,) of an image whose squared miss is expected to be no larger where they stay.

        Where they stay the arrival that was seen remains, as far as the image tells it apart from its own
        noise; where they go, to `wanted_deg` (n, 2), there is a new one.
        """
        rows, arrival_mm2 = seen.rows, 0.5 * (self.noise.repeatability_um * MM_PER_UM) ** 2
        offset_deg, place_mm = self.offsets.angles_deg[rows], self.offsets.place_mm[rows]
        here_deg = seen.believed_deg + offset_deg
        noise = self.camera_factor * seen.noise_mm2 + max(arrival_mm2, 1e-18) * np.eye(2)
        share = arrival_mm2 * np.linalg.inv(noise)
        left_mm = seen.measured_mm - self.plane.forward(here_deg[:, 0], here_deg[:, 1], index=rows) - place_mm
        arrived_mm = np.einsum("nij,nj->ni", share, left_mm)
        target_mm = self.target_mm[rows] - place_mm
        stay_mm = self._of_fibre(self.plane.forward, here_deg, rows) + arrived_mm - target_mm
        stay_mm2 = (stay_mm**2).sum(axis=1)
        stay_mm2 += arrival_mm2 * (2.0 - np.einsum("nii->n", share))
        way_deg = wanted_deg - seen.believed_deg
        there_deg = wanted_deg + offset_deg + self.offsets.slope[rows] * way_deg
        go_mm2 = ((self._of_fibre(self.plane.forward, there_deg, rows) - target_mm) ** 2).sum(axis=1)
        go_mm2 += 2.0 * arrival_mm2 + _DEAR_MM2_DEG2 * (way_deg**2).sum(axis=1)
        return np.asarray(stay_mm2 <= go_mm2, dtype=np.bool_)

    def _learn(
        self, rows: NDArray[np.intp], believed_deg: Floats, measured_mm: Floats, noise_mm2: Floats | None
    ) -> None:
        told = np.broadcast_to(0.5 * (self.noise.camera_um * MM_PER_UM) ** 2 * np.eye(2), (len(rows), 2, 2))
        way_deg = np.nan_to_num(believed_deg[rows] - self._last_deg[rows])
        noise = told if noise_mm2 is None else noise_mm2[rows]
        self._images.append(Seen(rows, believed_deg[rows], measured_mm[rows], noise, way_deg))
        self._last_deg[rows] = believed_deg[rows]
        self.camera_factor = self._found_factor()
        self.offsets = self._filtered(self.camera_factor)[0]

    def _found_factor(self) -> float:
        """With which the median prediction misses by what it should; 1 where too few predictions tell."""

        def too_far(log_factor: float) -> float:
            square = self._filtered(float(np.exp(log_factor)))[1]
            return float(np.median(square)) - _MEDIAN if len(square) >= _FEWEST else 0.0

        if too_far(0.0) == 0.0:
            return 1.0
        # the least that will do: with a much noisier camera nothing is learnt, and predictions miss again
        tried = np.log(np.geomspace(*_FACTORS, _TRIED))
        if too_far(float(tried[0])) <= 0.0:
            return _FACTORS[0]
        for low, high in pairwise(tried.tolist()):
            if too_far(high) <= 0.0:
                return float(np.exp(brentq(too_far, low, high, xtol=0.02)))
        return _FACTORS[1]

    def _filtered(self, factor: float) -> tuple[Offsets, Floats]:
        """The offsets after all images, and the squared misses of predictions that tell of the noise."""
        offsets = Offsets(self._begun.mean.copy(), self._begun.covariance.copy())
        told: list[Floats] = [np.empty(0)]
        before = np.zeros(self.plane.n, dtype=bool)
        for seen in self._images:
            square = self._take(offsets, seen, factor)
            told.append(square[before[seen.rows] & self._tells(seen)])
            before[seen.rows] = True
        return offsets, np.concatenate(told)

    def _tells(self, seen: Seen) -> Flags:
        """(n,) whether what a prediction misses by is the camera's noise, not the slope of a gear."""
        lever_mm = self._lever_mm()[seen.rows] * np.deg2rad(1.0)
        by_way = ((self.noise.slope * seen.way_deg * lever_mm) ** 2).sum(axis=1)
        drift = (self.noise.drift_um * MM_PER_UM) ** 2
        tells: Flags = np.einsum("nii->n", seen.noise_mm2) > _MOSTLY_NOISE * (by_way + drift)
        return tells

    def _take(self, offsets: Offsets, seen: Seen, factor: float) -> Floats:
        """Weighs an image into the `offsets`; (n,) squares of what it is off the prediction."""
        rows = seen.rows
        # above zero, so that a camera without noise gives no division by zero
        arrival_um2 = max(0.5 * self.noise.repeatability_um**2, 1e-12)
        noise_mm2 = factor * seen.noise_mm2 + arrival_um2 * MM_PER_UM**2 * np.eye(2)
        kept = Offsets(offsets.mean[rows], offsets.covariance[rows])
        before = predict(kept, seen.way_deg, self._drift(seen))
        after, surprise = self._weigh(before, seen, noise_mm2)
        shaken = surprise > _SURPRISE
        if shaken.any():
            fresh = before.covariance.copy()
            fresh[shaken] = self._whole(self._spread(self.noise.blind_um)[rows][shaken])
            after, _ = self._weigh(Offsets(before.mean, fresh), seen, noise_mm2)
        offsets.mean[rows] = after.mean
        offsets.covariance[rows] = after.covariance
        return surprise

    def _drift(self, seen: Seen) -> Floats:
        """(n, 6, 6) by which the offsets are less known than at the image before."""
        drift = np.zeros((len(seen.rows), 6, 6))
        drift[:, :2, :2] = self._spread(self.noise.drift_um)[seen.rows]
        # the slope is another at the end of the way, and has been so over a part of it
        changed = self.noise.slope * np.minimum(1.0, np.abs(seen.way_deg) / _SLOPE_HOLDS_DEG)
        drift[:, [0, 1], [0, 1]] += (changed * seen.way_deg) ** 2 / 3.0
        drift[:, [4, 5], [4, 5]] = changed**2
        return drift

    def _weigh(self, before: Offsets, seen: Seen, noise_mm2: Floats) -> tuple[Offsets, Floats]:
        at = seen.believed_deg + before.angles_deg
        expected = self.plane.forward(at[:, 0], at[:, 1], index=seen.rows) + before.place_mm
        by_angles = self.plane.jacobian(at[:, 0], at[:, 1], index=seen.rows)
        by_place = np.broadcast_to(np.eye(2), by_angles.shape)
        by_slope = np.zeros(by_angles.shape)  # what it has done since the image before is in the offset
        jacobian = np.concatenate([by_angles, by_place, by_slope], axis=2)
        return weigh(before, seen.measured_mm - expected, jacobian, noise_mm2)

    def _plain(self, rows: NDArray[np.intp], believed_deg: Floats, measured_mm: Floats) -> Floats:
        alpha_deg, beta_deg = believed_deg[rows].T
        here = self.plane.forward(alpha_deg, beta_deg, index=rows)
        command = plain_update(here, self.metrology_goal_mm[rows], measured_mm[rows])
        found = self.plane.inverse(self._within_reach(command, rows), index=rows, near_deg=believed_deg[rows])
        angles = np.column_stack([found.alpha_deg, found.beta_deg])
        # the same turn as before, and no move where the limits do not allow one
        angles[:, 0] += 360.0 * np.rint((believed_deg[rows, 0] - angles[:, 0]) / 360.0)
        return np.where(found.reachable[:, None], angles, believed_deg[rows])

    def _within_reach(self, xy_mm: Floats, rows: NDArray[np.intp]) -> Floats:
        """Positions (n, 2) within the length of the arms: with its noise a command may lie outside."""
        l_alpha, l_beta = self._levers()[:, rows]
        out = xy_mm - self.plane.centres_mm[rows]
        reach = np.hypot(*out.T)
        low, high = np.abs(l_alpha - l_beta) + _INSIDE_MM, l_alpha + l_beta - _INSIDE_MM
        reached: Floats = self.plane.centres_mm[rows] + out * (np.clip(reach, low, high) / reach)[:, None]
        return reached

    def _levers(self) -> Floats:
        """(2, N) mm: alpha arm, and beta axis to the metrology fibre."""
        return np.stack([self.plane.l_alpha_mm, self.plane.l_beta_mm])

    def _spread(self, rms_um: float) -> Floats:
        """(N, 2, 2) deg^2 of angles that scatter the fibre by this rms, half by each axis."""
        sigma_deg = rad_to_deg(rms_um * MM_PER_UM / np.sqrt(2.0) / self._lever_mm())
        return sigma_deg[:, :, None] ** 2 * np.eye(2)

    def _whole(self, spread_deg2: Floats) -> Floats:
        """(n, 6, 6) covariance of angles (n, 2, 2), of what the fibre is off besides, and of slopes."""
        whole = np.zeros((len(spread_deg2), 6, 6))
        whole[:, :2, :2] = spread_deg2
        whole[:, 2:4, 2:4] = 0.5 * (self.noise.place_um * MM_PER_UM) ** 2 * np.eye(2)
        whole[:, 4:, 4:] = self.noise.slope**2 * np.eye(2)
        return whole

    def _lever_mm(self) -> Floats:
        """(N, 2) by which the fibre moves with each axis, mm a radian."""
        l_alpha, l_beta = self._levers()
        return np.stack([np.hypot(l_alpha, l_beta), l_beta], axis=1)

    def _inside(self, angles_deg: Floats) -> Floats:
        """Short of the hard stops, with room for the approach."""
        low, high = np.moveaxis(self.plane.stops_of(), -1, 0)
        approach = np.array([axis.approach_deg for axis in self.plane.instrument.axes])
        return np.clip(angles_deg, low - np.minimum(approach, 0.0), high - np.maximum(approach, 0.0))
