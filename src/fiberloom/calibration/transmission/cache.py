"""Calibrations are slow and repeatable: the same inputs find the file of the last time."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import platformdirs

from fiberloom.calibration.transmission.maps import TransmissionMaps, load
from fiberloom.instruments import FocalPlane
from fiberloom.version import __version__

VARIABLE = "FIBERLOOM_CACHE"
"""Names the cache folder, in place of the user's."""


def default_directory() -> Path:
    """`calibration` in the folder that FIBERLOOM_CACHE names, else in the user's cache folder."""
    folder = os.environ.get(VARIABLE) or platformdirs.user_cache_dir("fiberloom")
    return Path(folder) / "calibration"


def cache_path(config_hash: str, seed: int, settings: Any, directory: str | Path | None = None) -> Path:
    """The file for this layout (`config_hash`), `seed` and (dataclass of) `settings` in `directory`,
    there or not yet.
    """
    inputs = {
        "layout": config_hash,
        "seed": seed,
        "settings": asdict(settings),
        "version": __version__,
    }
    key = hashlib.sha256(json.dumps(inputs, sort_keys=True, default=str).encode()).hexdigest()
    folder = Path(directory) if directory is not None else default_directory()
    return folder / f"transmission-{key[:16]}.npz"


def load_for(plane: FocalPlane, path: str | Path) -> TransmissionMaps:
    """The maps of a file, in the rows of this focal plane."""
    maps = load(path)
    return maps.select(maps.rows_of(plane.positioner_id))
