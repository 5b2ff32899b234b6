"""Files that are there whole or not at all: written under another name beside, then renamed."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from fiberloom.errors import InputError


@contextlib.contextmanager
def whole(path: str | Path, *, folders: bool = False) -> Iterator[Path]:
    """A place to write to, which becomes `path` at the end of the block.

    The old file stays until then, and stays where the block raises. Two processes may write the same file:
    the last one counts. The place ends as `path` does, for writers that look at it.

    Parameters
    ----------
    path : str or Path
        The file.
    folders : bool
        Make the folders above it where they are missing.

    Yields
    ------
    Path
        In the same folder.

    Raises
    ------
    InputError
        The disk is full, the folder cannot be written, or the name is that of a folder, a device or a pipe,
        whose place no file may take; names the file.

    Examples
    --------
    >>> from fiberloom.wholefile import whole
    >>> with whole("result.txt") as part:
    ...     _ = part.write_text("all of it")
    >>> Path("result.txt").read_text()
    'all of it'
    """
    path = Path(path)
    require_replaceable(path)
    part = path.with_name(f".{os.getpid()}-{path.name}")
    try:
        if folders:
            path.parent.mkdir(parents=True, exist_ok=True)
        yield part
        part.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


def require_replaceable(path: Path) -> None:
    """Raises InputError where a folder, a device or a pipe has the name of a file that is to be written."""
    if path.is_dir():
        raise InputError(f"{path}: cannot be written (it is a folder); give the name of a file")
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: cannot be written (it is a device or a pipe); give the name of a file")


def write_whole(path: str | Path, text: str) -> None:
    """Writes a text file as a whole; `path`, errors as for `whole`; `text`: as UTF-8."""
    with whole(path) as part:
        part.write_text(text, encoding="utf-8")
