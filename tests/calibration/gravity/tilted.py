"""Images of arms that sag: where masses on springs come to rest, by energy and not by the fitted model."""

from dataclasses import dataclass, field

import numpy as np

from fiberloom.calibration.gravity.images import TiltImages
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.instruments.pointing import Pointing

STIFFNESS_NM_RAD = np.array([0.337, 0.025]) * 180.0 / np.pi
MOMENT_KG_M = np.array([148e-6, 12e-6])
PLANE = FocalPlane.of("sdssv", n=37)
TURNS = [Pointing(60.0, float(turn)) for turn in range(0, 360, 60)]


@dataclass(frozen=True)
class Array:
    """Moments (N, 2), complex in the frame of each arm, kg m; noise and shifts of images, um a coordinate."""

    plane: FocalPlane = PLANE
    moment: np.ndarray = field(default_factory=lambda: drawn_moments(0))
    noise_um: float = 0.5
    shift_um: float = 0.0
    seed: int = 0

    def energy_J(self, angles_rad, pointing):
        zenith, rotator = np.deg2rad([pointing.zenith_deg, pointing.rotator_deg])
        down = -1j * np.exp(-1j * rotator) * 9.80665 * np.sin(zenith)
        alpha = np.exp(1j * (angles_rad[:, 0] + self.plane.arms[:, 3]))
        beta = alpha * np.exp(1j * (angles_rad[:, 1] + self.plane.arms[:, 4]))
        return -((self.moment[:, 0] * alpha + self.moment[:, 1] * beta) * np.conj(down)).real

    def turned_rad(self, angles_deg, pointing):
        """(N, 2) by which each arm gives way to the slope of the energy."""
        at, step = np.deg2rad(angles_deg), 1e-4
        slopes = [
            (self.energy_J(at + there, pointing) - self.energy_J(at - there, pointing)) / (2.0 * step)
            for there in step * np.eye(2)
        ]
        return -np.column_stack(slopes) / STIFFNESS_NM_RAD

    def place_mm(self, angles_deg, pointing, fibre=METROLOGY):
        """(N, 2) of a fibre, with arms as `pointing` bends them. Kronig 2020, Eq. 1."""
        alpha, beta = (np.deg2rad(angles_deg) + self.turned_rad(angles_deg, pointing)).T
        arms, point = self.plane.arms, self.plane.points[fibre]
        along = np.exp(1j * (alpha + arms[:, 3]))
        z = arms[:, 0] + 1j * arms[:, 1] + arms[:, 2] * along
        z = z + (point[:, 0] + 1j * point[:, 1]) * along * np.exp(1j * (beta + arms[:, 4]))
        return np.column_stack([z.real, z.imag])

    def images(self, configurations=6, turns=TURNS):
        """TiltImages of random configurations."""
        rng = np.random.default_rng([self.seed, 7])
        n, angles, xy, every = len(self.plane), [], [], []
        for _ in range(configurations):
            here = rng.uniform([5.0, 10.0], [355.0, 170.0], (n, 2))
            for pointing in turns:
                noise = rng.normal(0.0, 1e-3 * self.noise_um, (n, 2))
                shift = rng.normal(0.0, 1e-3 * self.shift_um, 2)
                angles.append(here)
                xy.append(self.place_mm(here, pointing) + noise + shift)
                every.append(pointing)
        number = np.repeat(np.arange(configurations), len(turns))
        ids = self.plane.positioner_id.astype(np.int64)
        return TiltImages(ids, number, tuple(every), np.stack(angles, axis=1), np.stack(xy, axis=1))


def drawn_moments(seed, n=37, scatter=0.1):
    """(N, 2) complex: those of the arms, with a scatter along and across."""
    rng = np.random.default_rng([seed, 3])
    off = rng.normal(size=(n, 2)) + 1j * rng.normal(size=(n, 2))
    return MOMENT_KG_M * (1.0 + scatter * off)


def true_sag_rad(moment):
    """(N, 4) turns at 1 g."""
    at_1_g = moment * 9.80665 / STIFFNESS_NM_RAD
    return np.column_stack([at_1_g[:, 0].real, at_1_g[:, 0].imag, at_1_g[:, 1].real, at_1_g[:, 1].imag])
