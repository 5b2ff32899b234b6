"""Result folders, and the marks that every result file carries."""

from __future__ import annotations

import datetime
import uuid
from pathlib import Path
from typing import Any

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.version import __version__


def prepare_folder(out: Path) -> Path:
    """Make the folder and prove that it can be written, before anything long is started."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / f".write-test-{uuid.uuid4().hex}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"--out {out}: cannot write there ({reason}); choose another folder") from None
    return out


def marks(plane: FocalPlane, seed: int) -> dict[str, Any]:
    """Version, seed, instrument, configuration hash and UTC time."""
    return {
        "version": __version__,
        "seed": seed,
        "instrument": plane.instrument.name,
        "config_hash": plane.config_hash(),
        "utc": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }
