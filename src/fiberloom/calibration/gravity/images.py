"""Images of an array that stands still while the telescope points elsewhere: as arrays, and in a file.

CSV, ECSV or FITS, one row for each image and positioner that was seen:

    image, configuration, zenith_deg, rotator_deg, positioner_id, alpha_deg, beta_deg, x_mm, y_mm

Nothing moves between the images of a configuration but the telescope.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.calibration.focal_plane.arms_file import MOST
from fiberloom.errors import InputError
from fiberloom.instruments.pointing import Pointing
from fiberloom.tables import TableFile, read_table, write_columns
from fiberloom.typing import Floats, Ints

OF_IMAGE = ("configuration", "zenith_deg", "rotator_deg")
_ANGLES, _PLACES = ("alpha_deg", "beta_deg"), ("x_mm", "y_mm")
COLUMNS = ("image", *OF_IMAGE, "positioner_id", *_ANGLES, *_PLACES)
_STILL_DEG = 1e-3
"""By which a positioner's angles may differ between two images of a configuration: it has moved else."""
MOST_IMAGES = 10_000
"""In a file: more is a table of something else."""


@dataclass(frozen=True, eq=False)
class TiltImages:
    """M images of N positioners.

    Raises
    ------
    InputError
        Arrays that do not fit each other.
    """

    positioner_id: Ints
    """(N,) number on the bus."""
    configuration: Ints
    """(M,) in which each image was made."""
    pointing: tuple[Pointing, ...]
    """M of the telescope."""
    angles_deg: Floats
    """(N, M, 2) alpha and beta as reported, by the maps."""
    xy_mm: Floats
    """(N, M, 2) metrology fibres as seen; NaN where not, or where the report is not to be trusted."""

    def __post_init__(self) -> None:
        n, m = len(self.positioner_id), len(self.pointing)
        shapes = {"configuration": (m,), "angles_deg": (n, m, 2), "xy_mm": (n, m, 2)}
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise InputError(f"images: {name} has shape {getattr(self, name).shape}, not {shape}")

    def __repr__(self) -> str:
        n, m, k = len(self.positioner_id), len(self.pointing), len(np.unique(self.configuration))
        return f"TiltImages({m} images of {n} positioners in {k} configurations)"

    def write(self, path: str | Path, marks: Mapping[str, Any]) -> None:
        """Writes them as ECSV; `marks`: version, seed, ... for the head."""
        n, m = np.nonzero(np.isfinite(self.xy_mm).all(axis=2))
        tilts = np.array([(one.zenith_deg, one.rotator_deg) for one in self.pointing]).reshape(-1, 2)
        columns: dict[str, Any] = {"image": m + 1, "configuration": self.configuration[m]}
        columns |= {"zenith_deg": tilts[m, 0], "rotator_deg": tilts[m, 1]}
        columns["positioner_id"] = self.positioner_id[n]
        columns |= {name: self.angles_deg[n, m, k] for k, name in enumerate(_ANGLES)}
        columns |= {name: self.xy_mm[n, m, k] for k, name in enumerate(_PLACES)}
        write_columns(Path(path), columns, dict(marks))


def read_tilts(path: str | Path) -> TiltImages:
    """Reads images; InputError with file, row and column for what cannot be one."""
    table = read_table(path)
    table.require(*COLUMNS)
    images, first_m, m = np.unique(table.integers("image"), return_index=True, return_inverse=True)
    ids, n = np.unique(table.integers("positioner_id"), return_inverse=True)
    if len(images) > MOST_IMAGES:
        raise InputError(f"{path}: {len(images)} images, {MOST_IMAGES} are possible")
    numbers = {name: _sensible(table, name) for name in (*OF_IMAGE[1:], *_ANGLES, *_PLACES)}
    numbers["configuration"] = table.integers("configuration").astype(np.float64)
    for name in OF_IMAGE:
        differs = np.flatnonzero(numbers[name] != numbers[name][first_m][m])
        if len(differs):
            raise table.error(int(differs[0]), name, "is not that of the image's other rows")
    _, first = np.unique(n * len(images) + m, return_index=True)
    if len(first) < len(n):
        again = np.setdiff1d(np.arange(len(n)), first)
        raise table.error(int(again[0]), "image", "holds this positioner a second time")
    angles, xy = np.full((2, len(ids), len(images), 2), np.nan)
    angles[n, m] = np.column_stack([numbers[name] for name in _ANGLES])
    xy[n, m] = np.column_stack([numbers[name] for name in _PLACES])
    configuration = numbers["configuration"][first_m].astype(np.int64)
    _check_still(table, (n, m), configuration, angles)
    tilts = zip(*(numbers[name][first_m].tolist() for name in OF_IMAGE[1:]), strict=True)
    try:
        pointing = tuple(Pointing(*tilt) for tilt in tilts)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return TiltImages(ids, configuration, pointing, angles, xy)


def _sensible(table: TableFile, name: str) -> Floats:
    values = table.numbers(name)
    bad = np.flatnonzero(~(np.abs(values) <= MOST))
    if len(bad):
        raise table.error(int(bad[0]), name, f"= {values[bad[0]]:g} cannot be one")
    return values


def _check_still(table: TableFile, at: tuple[Ints, Ints], configuration: Ints, angles_deg: Floats) -> None:
    """Raises InputError where a positioner turned between two images of a configuration."""
    n, m = at
    for one in np.unique(configuration):
        part = angles_deg[:, configuration == one]
        seen = np.isfinite(part[..., 0])
        low, high = np.where(seen[..., None], part, np.inf), np.where(seen[..., None], part, -np.inf)
        turned = (high.max(axis=1) - low.min(axis=1)).max(axis=1) > _STILL_DEG
        if turned.any():
            row = int(np.flatnonzero(turned[n] & (configuration[m] == one))[0])
            raise table.error(row, "alpha_deg", f"and beta_deg: it has moved in configuration {one}")
