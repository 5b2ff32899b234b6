"""Which files a film can be; decided before anything long is started, without a slow import."""

from __future__ import annotations

import shutil
from pathlib import Path

from fiberloom.errors import InputError

GIF, MP4 = ".gif", ".mp4"
SUFFIXES = (GIF, MP4)


def require_film(option: str, path: Path) -> None:
    """Raises InputError where a film cannot be made under this name; `option`: names it in the message."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{option} {path}: a film is a {' or a '.join(SUFFIXES)} file")
    if path.is_dir():
        raise InputError(f"{option} {path}: is a folder; give the name of a file")
    if suffix == MP4 and shutil.which("ffmpeg") is None:
        raise InputError(
            f"{option} {path}: {MP4} needs ffmpeg, which is not on the PATH; install it, or write a {GIF}"
        )
