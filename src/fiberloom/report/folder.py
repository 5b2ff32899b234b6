"""Folders and files of results: proven to be writable before anything long is started."""

from __future__ import annotations

import contextlib
import json
import uuid
from collections.abc import Sequence
from pathlib import Path

from fiberloom.errors import InputError
from fiberloom.wholefile import require_replaceable, write_whole


def prepare_folder(out: Path, option: str = "--out") -> Path:
    """Make the folder and prove that it can be written, before anything long is started.

    `option`: what named it, for the message of the InputError.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / f".write-test-{uuid.uuid4().hex}"
        probe.touch()
        probe.unlink()
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{option} {out}: cannot write there ({reason}); choose another folder") from None
    return out


def prepare_file(path: Path, option: str = "--out", inputs: Sequence[Path | None] = ()) -> Path:
    """Make the folder of a file and prove that the file can be written; what is in it stays.

    `option`: what named it, for the message of the InputError; `inputs`: what the command reads, of which it
    may be none.
    """
    try:
        require_replaceable(path)
    except InputError as error:
        raise InputError(f"{option} {error}") from None
    for read in inputs:
        if read is not None and path.exists() and read.exists() and path.samefile(read):
            raise InputError(f"{option} {path}: is read by this command; give another name")
    there = path.exists() or path.is_symlink()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a"):
            pass
        if not there:
            path.unlink()
    except OSError as error:
        raise InputError(
            f"{option} {path}: cannot write there ({error.strerror or error}); choose another place"
        ) from None
    return path


RESULTS = (
    *("summary.json", "fibres.ecsv", "trajectories.json"),
    *("focal_plane.png", "errors.png", "exposures"),
)
"""What an observation leaves in its folder, beside the store."""


def set_aside(folder: Path, last_run: int) -> Path | None:
    """Moves what an earlier observation left in a folder into `run-N` below it.

    Parameters
    ----------
    folder : Path
        Of the observation that is about to begin.
    last_run : int
        Number of the last run on record there, for results that tell no number: it did not come to its end.

    Returns
    -------
    Path or None
        Where they are now; None where there was nothing.

    Raises
    ------
    InputError
        They cannot be moved.
    """
    there = [folder / name for name in RESULTS if (folder / name).exists()]
    if not there:
        return None
    number = _run_of(folder / "summary.json", last_run)
    aside, again = folder / f"run-{number}", 1
    while aside.exists():
        aside, again = folder / f"run-{number}-{again}", again + 1
    try:
        aside.mkdir()
        for path in there:
            path.rename(aside / path.name)
    except OSError as error:
        raise InputError(
            f"--out {folder}: the results of run {number} cannot be moved aside ({error.strerror or error}); "
            "choose another folder"
        ) from None
    return aside


LATEST = "latest"
"""The newest of the folders beside it, where a run has its own."""


def point_latest(folder: Path) -> None:
    """Makes `latest`, beside a folder, a link to it; where links cannot be made, or a folder has that name,
    `latest.txt` holds its name. What fails here fails no run.
    """
    text, part = folder.with_name(f"{LATEST}.txt"), folder.with_name(f".{LATEST}-{uuid.uuid4().hex}")
    with contextlib.suppress(OSError, InputError):
        try:
            part.symlink_to(folder.name, target_is_directory=True)
            part.replace(folder.with_name(LATEST))
            text.unlink(missing_ok=True)
        except (OSError, NotImplementedError):
            write_whole(text, f"{folder.name}\n")
        finally:
            part.unlink(missing_ok=True)


def _run_of(summary: Path, last_run: int) -> int:
    try:
        return int(json.loads(summary.read_text(encoding="utf-8"))["run"])
    except (OSError, ValueError, KeyError, TypeError):
        return last_run
