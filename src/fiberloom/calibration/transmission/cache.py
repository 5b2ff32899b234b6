"""Calibrations are slow and repeatable: the same inputs find the file of the last time."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fiberloom.version import __version__


def default_directory() -> Path:
    """`.cache` of the checkout that this package runs from, else of the current directory."""
    for parent in Path(__file__).resolve().parents:
        if (parent / "pyproject.toml").is_file():
            return parent / ".cache" / "calibration"
    return Path.cwd() / ".cache" / "calibration"


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
