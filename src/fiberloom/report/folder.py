"""Folders and files of results: proven to be writable before anything long is started."""

from __future__ import annotations

import uuid
from pathlib import Path

from fiberloom.errors import InputError


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


def prepare_file(path: Path) -> Path:
    """Make the folder of a file and prove that the file can be written; what is in it stays."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a"):
            pass
    except OSError as error:
        raise InputError(
            f"--out {path}: cannot write there ({error.strerror or error}); choose another place"
        ) from None
    return path
