"""Focal planes of cobras: the exact lattice of PFS, the elbow on the other side, drawn arms."""

from dataclasses import replace

import numpy as np

from fiberloom.instruments import FocalPlane, load_instrument
from fiberloom.instruments.arms import BETA_OFF, CENTRE

ALPHA_DEG, BETA_DEG = (-5.0, 375.0), (-182.6, 3.4)
"""Hard stops: ranges of 380 and 186 deg."""


def lattice_mm(n=2394):
    """(n, 2) centres of cobras 1 to n (pfs_utils grandfibermap)."""
    field, rest = np.divmod(np.arange(n), 798)
    module, place = np.divmod(rest, 57)
    k, e = np.divmod(place, 2)
    x, y = -6.9282 * (2 * module + 1 + e), 8.0 * (module + 1) - 4.0 - 8.0 * k - 4.0 * e
    at = (x + 1j * y) * np.exp(-2j * np.pi * field / 3)
    return np.column_stack([at.real, at.imag])


def pfs_plane(n=2394, seed=0, fiducials=False):
    """The first n cobras, as they are drawn."""
    instrument = load_instrument("pfs")
    alpha = instrument.alpha.model_copy(
        update={"hard_stop_deg": ALPHA_DEG, "target_range_deg": (ALPHA_DEG[0] + 2, ALPHA_DEG[1] - 2)}
    )
    beta = instrument.beta.model_copy(
        update={"hard_stop_deg": BETA_DEG, "target_range_deg": (BETA_DEG[0] + 2, 0.0)}
    )
    instrument = instrument.model_copy(update={"alpha": alpha, "beta": beta})
    rng = np.random.default_rng(seed)
    plane = FocalPlane.of("pfs", seed=seed)
    arms = plane.arms[:n].copy()
    arms[:, CENTRE] = lattice_mm(n) + 0.05 * rng.standard_normal((n, 2))
    arms[:, BETA_OFF] = 0.0
    return replace(
        plane,
        instrument=instrument,
        positioner_id=np.arange(1, n + 1),
        hole=plane.hole[:n],
        arms=arms,
        points={name: xy[:n] for name, xy in plane.points.items()},
        fiducials=plane.fiducials if fiducials else np.zeros((0, 3)),
        offline=np.zeros(n, dtype=bool),
        offline_position_deg=np.tile([0.0, -180.0], (n, 1)),
    )
