"""A map of each unit's gears, learnt from nightly images: what was believed against what was seen.

The error of a gear is a sum of waves over the internal angle, with unknown amplitudes; a Kalman filter of
each unit holds these, and what its centre and arms are off the layout. All measurements of all nights count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.drive.desi.maps.air import NO_STILL_POINTS, Air, StillPoints, air_of
from fiberloom.drive.desi.maps.orders import ORDERS
from fiberloom.drive.desi.places import angles_near
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats, Ints

ARM_TERMS = 4
"""Centre x, y and both lengths, mm."""
LEAST_SINE = 0.1
"""Of phi, from which on a place tells both angles."""


@dataclass(frozen=True)
class MapBasis:
    """Which waves a map has, and how large they may be."""

    orders: Floats
    """Cycles for a turn of the arm."""
    sigma_deg: Floats
    """Of the amplitude of each before anything was seen."""
    offset_deg: float = 0.5
    """[A] Of the zero of an axis."""
    scatter_deg: float = 0.02
    """Fresh with each move."""
    centre_mm: float = 0.003
    length_mm: float = 0.005
    """[A] Of the layout."""

    @property
    def terms(self) -> int:
        """Of one axis: zero, sines, cosines."""
        return 1 + 2 * len(self.orders)

    def at(self, angle_deg: Floats) -> Floats:
        """(N, 2, terms) the waves at internal angles (N, 2) in deg; dimensionless."""
        turned = np.deg2rad(angle_deg)[..., None] * self.orders
        one = np.ones((*angle_deg.shape, 1))
        return np.concatenate([one, np.sin(turned), np.cos(turned)], axis=-1)

    def variance(self) -> Floats:
        """(2 terms + ARM_TERMS,) of all unknowns of a unit before anything was seen, deg^2 and mm^2."""
        axis = np.concatenate([[self.offset_deg], self.sigma_deg, self.sigma_deg]) ** 2
        arms = np.array([self.centre_mm, self.centre_mm, self.length_mm, self.length_mm]) ** 2
        return np.concatenate([axis, axis, arms])


PLANETARY = MapBasis(np.asarray(ORDERS[:6], dtype=np.float64), np.array([0.4, 0.4, 0.4, 0.15, 0.15, 0.15]))
"""[A] Waves of the last stage and of the one before, by their teeth; within a stage none is preferred."""
SMOOTH = MapBasis(0.45 * np.arange(1.0, 11.0), np.full(10, 0.2), scatter_deg=0.05)
"""[A] A smooth function over 800 deg down to 80 deg that knows nothing of teeth; what is faster is
scatter."""


class LearnedMaps:
    """Maps of N units: angles that are believed, and what is known of the gears.

    The believed angle is what was added up. It stays true to the motor, as long as that loses no turn; so the
    map is of a place, and nothing is set back. A unit that is seen where its map cannot have it gets a new
    believed angle: turns were lost, or its motor is degraded.
    """

    GATE_SIGMA = 6.0
    """Seen farther off than so many sigma: not a matter of the map."""

    def __init__(self, plane: FocalPlane, believed_deg: Floats, basis: MapBasis = PLANETARY) -> None:
        """`plane`: N positioners; `believed_deg` (N, 2): where they are; `basis`: what maps are made of."""
        self.plane, self.basis = plane, basis
        self.believed_deg = believed_deg.copy()
        first = basis.variance()
        self.mean = np.zeros((len(plane), len(first)))
        """(N, unknowns) deg and mm."""
        self.covariance = np.tile(np.diag(first), (len(plane), 1, 1))
        self.surprises = np.zeros(len(plane), dtype=np.int64)
        """(N,) how often a unit was seen where its map cannot have it."""

    def output_deg(self, believed_deg: Floats) -> Floats:
        """(N, 2) angles of the arms in deg at believed ones (N, 2)."""
        waves = self.basis.at(believed_deg)
        return np.asarray(believed_deg + np.einsum("nak,nak->na", waves, self._axis_means()))

    def places_mm(self, output_deg: Floats) -> Floats:
        """(N, 2) mm of fibres at angles of the arms (N, 2) in deg, with what is learnt of the arms."""
        arms = self.mean[:, -ARM_TERMS:]
        known = self.plane.forward(*output_deg.T)
        learnt: Floats = known + np.einsum("nck,nk->nc", self._arm_columns(output_deg), arms)
        return learnt

    def sigma_um(self, believed_deg: Floats) -> Floats:
        """(N,) um, 2-D rms: how far from its place a fibre is expected after a move to (N, 2) deg."""
        return np.asarray(1e3 * np.sqrt(np.einsum("ncc->n", self._spread_mm2(believed_deg))))

    def expected_mm(self) -> Floats:
        """(N, 2) mm of fibres at the believed angles."""
        return self.places_mm(self.output_deg(self.believed_deg))

    def spread_mm2(self) -> Floats:
        """(N, 2, 2) how well that is known: the map, and the scatter of a move."""
        return self._spread_mm2(self.believed_deg)

    def _spread_mm2(self, believed_deg: Floats) -> Floats:
        rows, jacobian = self._rows(believed_deg)
        fresh = self.basis.scatter_deg**2 * jacobian @ jacobian.transpose(0, 2, 1)
        known: Floats = np.einsum("nck,nkl,ndl->ncd", rows, self.covariance, rows, optimize=True)
        return known + fresh

    def way_deg(self, goal_deg: Floats) -> Floats:
        """(N, 2) deg to command so that fibres come where ideal arms at `goal_deg` (N, 2) have them."""
        output = self._output_for(goal_deg)
        believed = output
        for _ in range(8):
            # gears are straight to a tenth: each round leaves a tenth of what is off
            believed = believed + output - self.output_deg(believed)
        return believed - self.believed_deg

    def went(self, way_deg: Floats) -> None:
        """A way (N, 2) in deg was commanded."""
        self.believed_deg = self.believed_deg + way_deg

    def see(self, xy_mm: Floats, sigma_mm: Floats | float, seen: Flags) -> None:
        """Learns from an image: fibres at `xy_mm` (N, 2), those `seen` (N,), `sigma_mm` per coordinate."""
        told = seen & np.isfinite(xy_mm).all(axis=1)
        rows, jacobian = self._rows(self.believed_deg)
        off = np.where(told[:, None], xy_mm - self.expected_mm(), 0.0)
        noise = self.basis.scatter_deg**2 * jacobian @ jacobian.transpose(0, 2, 1)
        noise += np.broadcast_to(np.asarray(sigma_mm) ** 2, (len(off),))[:, None, None] * np.eye(2)
        cross = np.einsum("nkl,ncl->nkc", self.covariance, rows)
        inverse = np.linalg.inv(rows @ cross + noise)
        surprise = np.einsum("nc,ncd,nd->n", off, inverse, off)
        lost = told & (surprise > self.GATE_SIGMA**2)
        gain = np.where((told & ~lost)[:, None, None], cross @ inverse, 0.0)
        self.mean += np.einsum("nkc,nc->nk", gain, off)
        self.covariance -= gain @ cross.transpose(0, 2, 1)
        self._relocate(xy_mm, lost)

    def _relocate(self, xy_mm: Floats, lost: Flags) -> None:
        """Units that stand elsewhere than their map can have them: believed where they are seen."""
        self.surprises += lost
        self.stands(xy_mm, lost)

    def stands(self, xy_mm: Floats, lost: Flags) -> None:
        """Believes those `lost` (N,) to be where they are seen, at `xy_mm` (N, 2): turns are not known."""
        if not lost.any():
            return
        here = self.output_deg(self.believed_deg)
        # a folded or stretched arm does not tell its angles
        lost = lost & (np.abs(np.sin(np.deg2rad(here[:, 1]))) > LEAST_SINE)
        measured = angles_near(self.plane, np.where(lost[:, None], xy_mm, 0.0), here)
        self.believed_deg = np.where(lost[:, None], self.believed_deg + measured - here, self.believed_deg)
        for zero in (0, self.basis.terms):
            self.covariance[lost, zero, zero] += self.basis.offset_deg**2

    def air_in(
        self, xy_mm: Floats, sigma_mm: Floats | float, seen: Flags, standing: StillPoints = NO_STILL_POINTS
    ) -> Air:
        """The air of an image, by all its fibres and what is `standing`: `xy_mm` (N, 2), those `seen` (N,),
        `sigma_mm` of the camera per coordinate, without air.
        """
        expected = self.expected_mm()
        own = 1e-3 * self.sigma_um(self.believed_deg) / np.sqrt(2.0)
        return air_of(expected, xy_mm - expected, np.hypot(own, sigma_mm), seen, standing)

    def homed(self, rows: Ints, output_deg: Floats, sigma_deg: float) -> None:
        """Believes arms of these rows (n,) to be at (n, 2) deg, by their stops; `sigma_deg` of each axis."""
        here = self.output_deg(self.believed_deg)[rows]
        self.believed_deg[rows] += output_deg - here
        for zero in (0, self.basis.terms):
            self.covariance[rows, zero, zero] += sigma_deg**2

    def _axis_means(self) -> Floats:
        terms = self.basis.terms
        return self.mean[:, : 2 * terms].reshape(-1, 2, terms)

    def _rows(self, believed_deg: Floats) -> tuple[Floats, Floats]:
        """(N, 2, unknowns) how places change with the unknowns, mm/deg and mm/mm; (N, 2, 2) mm/deg."""
        output = self.output_deg(believed_deg)
        jacobian = self.plane.jacobian(*output.T)
        waves = self.basis.at(believed_deg)
        axes = [jacobian[:, :, axis, None] * waves[:, None, axis] for axis in (0, 1)]
        return np.concatenate([*axes, self._arm_columns(output)], axis=2), jacobian

    def _arm_columns(self, output_deg: Floats) -> Floats:
        """(N, 2, ARM_TERMS) how places change with centre and lengths; ratios."""
        alpha = np.deg2rad(output_deg[:, 0]) + self.plane.alpha_off_rad
        phi = np.deg2rad(output_deg[:, 1]) + self.plane.beta_off_rad + self.plane.metrology_phi_rad
        out = np.zeros((len(alpha), 2, ARM_TERMS))
        out[:, 0, 0] = out[:, 1, 1] = 1.0
        for column, turn in ((2, alpha), (3, alpha + phi)):
            out[:, 0, column], out[:, 1, column] = np.cos(turn), np.sin(turn)
        return out

    def _output_for(self, goal_deg: Floats) -> Floats:
        """(N, 2) angles in deg at which the learnt arms have their fibres where ideal arms have them."""
        want, output = self.plane.forward(*goal_deg.T), goal_deg
        for _ in range(4):
            off = want - self.places_mm(output)
            jacobian = self.plane.jacobian(*output.T)
            # damped: a stretched arm cannot follow along its length
            normal = jacobian.transpose(0, 2, 1) @ jacobian + (0.003**2) * np.eye(2)
            step = np.linalg.solve(normal, np.einsum("nca,nc->na", jacobian, off)[..., None])
            output = output + step[..., 0]
        return output
