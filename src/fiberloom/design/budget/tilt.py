"""What tilted axes and fibres do: they lead the fibre out of focus, and make its cone faster.

An axis that is tilted by t moves a tip at the lever r along the beam by r t at most; all directions are
alike, and both axes count:

    dz rms = sqrt((t_a^2 (l_a^2 + l_b^2) + t_b^2 l_b^2) / 2)

t_a, t_b: rms magnitude of the tilt of the axes, 95 % within 1.73 of it. On a curved focal surface of radius
R_c a tip that moves in a plane adds r^2/(2 R_c), of which the mean is focused away. The fibre's own tilt adds
to those of its axes in quadrature. A fibre keeps the angle to its axis and mixes the azimuth, so a cone of
F that comes in under t leaves it as

    F_out = 1/(2 tan(atan(1/(2 F)) + t))

and what is beyond the collimator's 1/(2 F_c) is lost: two discs, one shifted by t.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fiberloom.design.budget.places import random_goals_deg
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM, deg_to_rad

RAYLEIGH_95 = math.sqrt(-math.log(0.05))
"""95 % of the magnitudes of a normal tilt in two directions, over their rms."""
NORMAL_95 = 1.959964
RAYS = 400
MOST_TILT_DEG = 20.0


@dataclass(frozen=True)
class Tilts:
    """Rms magnitudes of tilts, and the beam that the fibres see.

    Raises
    ------
    InputError
        A tilt beyond 20 deg, or a focal ratio or radius that is not above 0.
    """

    focal_ratio: float
    """Of the beam."""
    alpha_deg: float = 0.0
    """Of the alpha axis against the beam."""
    beta_deg: float = 0.0
    """Of the beta axis against the alpha axis."""
    fibre_deg: float = 0.0
    """Of the fibre against the beta axis."""
    collimator_ratio: float | None = None
    """Focal ratio that the spectrograph takes; None: that of the beam."""
    curvature_mm: float = math.inf
    """Radius of the focal surface."""

    def __post_init__(self) -> None:
        for name in ("alpha_deg", "beta_deg", "fibre_deg"):
            if not 0.0 <= getattr(self, name) <= MOST_TILT_DEG:
                raise InputError(f"tilt: {name} {getattr(self, name):g}: must be 0 to {MOST_TILT_DEG:g}")
        for name, value in (("focal ratio", self.focal_ratio), ("collimator", self.taken_ratio)):
            if not 0.1 <= value <= 100.0:
                raise InputError(f"tilt: {name} {value:g}: must be 0.1 to 100")
        if self.taken_ratio > self.focal_ratio:
            raise InputError(
                f"tilt: a collimator of f/{self.taken_ratio:g} is slower than the beam of "
                f"f/{self.focal_ratio:g}: straight fibres lose light too; give one at least as fast"
            )
        if not self.curvature_mm > 0.0:
            raise InputError(f"tilt: radius of the focal surface {self.curvature_mm:g} mm: must be above 0")

    @property
    def taken_ratio(self) -> float:
        """Focal ratio that the spectrograph takes."""
        return self.focal_ratio if self.collimator_ratio is None else self.collimator_ratio

    @property
    def whole_deg(self) -> float:
        """Rms tilt of a fibre against the beam."""
        return math.hypot(self.alpha_deg, self.beta_deg, self.fibre_deg)


@dataclass(frozen=True)
class Tilted:
    """What tilts do to fibres; by formula or of a Monte Carlo."""

    defocus_um: float
    """Rms along the beam."""
    defocus_95_um: float
    blur_95_um: float
    """Diameter of the blurred point, at 95 % of the defocus."""
    fibre_deg: float
    """Rms angle of the fibre against the beam."""
    fibre_95_deg: float
    leaves_at: float
    """Focal ratio of the fibre's output at 95 % of the angles."""
    beyond: float
    """Mean share of the light beyond the collimator, 0 to 1."""


def half_angle_deg(focal_ratio: float) -> float:
    """Of a cone of this focal ratio."""
    return math.degrees(math.atan(0.5 / focal_ratio))


def output_ratio(focal_ratio: float, tilt_deg: float) -> float:
    """Focal ratio of the output of a fibre that takes a cone of `focal_ratio` under `tilt_deg`."""
    return 0.5 / math.tan(math.radians(half_angle_deg(focal_ratio) + tilt_deg))


def beyond_collimator(tilts: Tilts, tilt_deg: Floats) -> Floats:
    """Share of the light beyond the collimator, of fibres (n,) tilted by so many deg.

    The cone is a disc in angle, shifted by the tilt; the collimator another about the fibre's axis.
    """
    own, taken = half_angle_deg(tilts.focal_ratio), half_angle_deg(tilts.taken_ratio)
    d = np.clip(np.abs(tilt_deg), 1e-12, own + taken)
    first = np.arccos(np.clip((d**2 + own**2 - taken**2) / (2.0 * d * own), -1.0, 1.0))
    second = np.arccos(np.clip((d**2 + taken**2 - own**2) / (2.0 * d * taken), -1.0, 1.0))
    kite = (own + taken - d) * (d + own - taken) * (d - own + taken) * (d + own + taken)
    both = own**2 * first + taken**2 * second - 0.5 * np.sqrt(np.clip(kite, 0.0, None))
    share: Floats = np.clip(1.0 - both / (math.pi * own**2), 0.0, 1.0)
    return share


def tilted(plane: FocalPlane, tilts: Tilts) -> Tilted:
    """By formula, for targets spread evenly over the annuli of a `plane`; `tilts`: rms and beam."""
    l_alpha2, l_beta2, spread2 = _levers(plane)
    alpha, beta = deg_to_rad(tilts.alpha_deg), deg_to_rad(tilts.beta_deg)
    leant_mm2 = 0.5 * (alpha**2 * (l_alpha2 + l_beta2) + beta**2 * l_beta2)
    curved_mm2 = spread2 / (4.0 * tilts.curvature_mm**2)
    defocus_um = UM_PER_MM * math.sqrt(leant_mm2 + curved_mm2)
    fibre_95_deg = RAYLEIGH_95 * tilts.whole_deg
    probability = (np.arange(RAYS) + 0.5) / RAYS
    angles = tilts.whole_deg * np.sqrt(-np.log1p(-probability))
    return Tilted(
        defocus_um=defocus_um,
        defocus_95_um=NORMAL_95 * defocus_um,
        blur_95_um=NORMAL_95 * defocus_um / tilts.focal_ratio,
        fibre_deg=tilts.whole_deg,
        fibre_95_deg=fibre_95_deg,
        leaves_at=output_ratio(tilts.focal_ratio, fibre_95_deg),
        beyond=float(beyond_collimator(tilts, angles).mean()),
    )


def _levers(plane: FocalPlane) -> tuple[float, float, float]:
    """Mean l_alpha^2 and l_beta^2 of the science fibre in mm^2, and the variance of its r^2 in mm^4."""
    low_mm, high_mm = (abs(x) for x in plane.instrument.reach_mm)
    fibre_mm = plane.points[plane.instrument.science_fibres[0]]
    l_beta2 = float(np.nanmean((fibre_mm**2).sum(axis=1)))
    return float(np.mean(plane.l_alpha_mm**2)), l_beta2, (high_mm**2 - low_mm**2) ** 2 / 12.0


# the same in three dimensions


def simulated_tilts(plane: FocalPlane, tilts: Tilts, seed: int, configurations: int) -> Tilted:
    """By turning arms and fibres in three dimensions, and rays into every fibre, one by one.

    `plane`: N positioners, each with tilts of its own; `tilts`: rms and beam; `seed` of all of it; random
    `configurations` of all.
    """
    rng = np.random.default_rng([seed, 0x711D])
    leant = [_leaning(rng, plane.n, deg) for deg in (tilts.alpha_deg, tilts.beta_deg, tilts.fibre_deg)]
    along_mm, angle_deg = [], []
    for _ in range(configurations):
        tip_mm, direction = _turned(plane, random_goals_deg(plane, rng), leant)
        along_mm.append(tip_mm[:, 2] + (tip_mm[:, :2] ** 2).sum(axis=1) / (2.0 * tilts.curvature_mm))
        angle_deg.append(np.degrees(np.arccos(np.clip(direction[:, 2], -1.0, 1.0))))
    away_um = UM_PER_MM * (np.concatenate(along_mm) - np.mean(along_mm))
    angles = np.concatenate(angle_deg)
    away_95_um, angle_95 = np.quantile(np.abs(away_um), 0.95), np.quantile(angles, 0.95)
    return Tilted(
        defocus_um=float(np.sqrt(np.mean(away_um**2))),
        defocus_95_um=float(away_95_um),
        blur_95_um=float(away_95_um) / tilts.focal_ratio,
        fibre_deg=float(np.sqrt(np.mean(angles**2))),
        fibre_95_deg=float(angle_95),
        leaves_at=output_ratio(tilts.focal_ratio, float(angle_95)),
        beyond=_rays_beyond(tilts, angles, rng),
    )


def _leaning(rng: np.random.Generator, n: int, rms_deg: float) -> Floats:
    """(n, 3, 3) rotations about horizontal axes, of this rms."""
    about = deg_to_rad(rms_deg) / math.sqrt(2.0) * rng.standard_normal((n, 2))
    return _rotations(np.column_stack([about, np.zeros(n)]))


def _rotations(vector: Floats) -> Floats:
    """(n, 3, 3) of rotation vectors (n, 3) in rad: Rodrigues."""
    angle = np.linalg.norm(vector, axis=1)[:, None, None]
    unit = vector / np.maximum(angle[:, 0], 1e-30)
    k = np.zeros((len(vector), 3, 3))
    k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -unit[:, 2], unit[:, 1], -unit[:, 0]
    k -= k.swapaxes(1, 2)
    found: Floats = np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k)
    return found


def _turned(plane: FocalPlane, goal_deg: Floats, leant: list[Floats]) -> tuple[Floats, Floats]:
    """(N, 3) tips in mm about their centres, and (N, 3) directions of the fibres."""
    n = plane.n
    about_z = np.zeros((2, n, 3))
    about_z[:, :, 2] = deg_to_rad(goal_deg).T
    alpha, beta = (_rotations(vector) for vector in about_z)
    fibre_mm = np.column_stack([plane.points[plane.instrument.science_fibres[0]], np.zeros(n)])
    elbow_mm = np.column_stack([plane.l_alpha_mm, np.zeros((n, 2))])
    to_alpha = leant[0] @ alpha
    to_beta = to_alpha @ leant[1] @ beta
    tip_mm = np.einsum("nij,nj->ni", to_alpha, elbow_mm) + np.einsum("nij,nj->ni", to_beta, fibre_mm)
    return tip_mm, (to_beta @ leant[2])[:, :, 2]


def _rays_beyond(tilts: Tilts, angle_deg: Floats, rng: np.random.Generator) -> float:
    """Share of rays, even over the cone, that come in farther from a fibre's axis than is taken."""
    own, taken = half_angle_deg(tilts.focal_ratio), half_angle_deg(tilts.taken_ratio)
    far = own * np.sqrt(rng.random((len(angle_deg), RAYS)))
    turn = rng.uniform(0.0, 2.0 * math.pi, far.shape)
    x, y = far * np.cos(turn) + angle_deg[:, None], far * np.sin(turn)
    return float((np.hypot(x, y) > taken).mean())
