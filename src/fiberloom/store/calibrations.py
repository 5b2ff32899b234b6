"""Which calibration was made, from which file, by which run: the row that every calibration leaves."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fiberloom.instruments.model import AXES
from fiberloom.store.database import Store
from fiberloom.store.place import STORE as STORE
from fiberloom.store.run import Run


def digest_of(file: Path) -> str:
    """The first 16 hex digits of the file's SHA-256."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16]


def note_calibration(run: Run, kind: str, file: Path, positioner_id: Iterable[int], digest: str = "") -> None:
    """Both axes of these positioners were calibrated by `file`, or used it, in this `run`.

    `kind`: transmission, arms, ...; `positioner_id`: their numbers; `digest`: of the content that was
    used, where the file holds more (a store); default: of the file.
    """
    ids, digest = list(positioner_id), digest or digest_of(file)
    for axis in AXES:
        run.record_calibration(ids, axis, kind, str(file), digest)


def record_calibration(
    file: Path,
    kind: str,
    positioner_id: Iterable[int],
    stamp: Mapping[str, Any],
    command_line: str,
    *,
    same_run: bool = False,
) -> None:
    """Writes the result of a calibration command into the store beside its `file`.

    `kind`: transmission, arms, ...; `positioner_id`: of the positioners; `stamp`: the marks of the
    result file (`report.outputs.marks`); `command_line`: what the operator typed. With `same_run` the
    rows go to the last run of that store, which has measured it; else to a run of their own.
    """
    with Store.open(file.parent / STORE) as store:
        if same_run:
            note_calibration(store.last_run(), kind, file, positioner_id)
            return
        with store.start_run(
            command_line=command_line,
            instrument=stamp["instrument"],
            config_hash=stamp["config_hash"],
            seed=stamp["seed"],
        ) as run:
            note_calibration(run, kind, file, positioner_id)
