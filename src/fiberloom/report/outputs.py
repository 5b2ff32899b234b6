"""The marks that every result file carries."""

from __future__ import annotations

import datetime
from typing import Any

from fiberloom.instruments import FocalPlane
from fiberloom.report.folder import prepare_folder as prepare_folder
from fiberloom.version import __version__


def marks(plane: FocalPlane, seed: int) -> dict[str, Any]:
    """Version, seed, instrument, configuration hash and UTC time."""
    return {
        "version": __version__,
        "seed": seed,
        "instrument": plane.instrument.name,
        "config_hash": plane.config_hash(),
        "utc": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }
