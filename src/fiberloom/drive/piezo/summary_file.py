"""Motor maps of all cobras of PFS, from the summary of its module files: one npz, and a table of pulses."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.drive.piezo.maps import MotorMaps
from fiberloom.errors import InputError, one_line
from fiberloom.tables import read_table
from fiberloom.typing import Array, Floats, Ints
from fiberloom.wholefile import whole

PER_MODULE = 57
"""Cobras of a module."""
PULSE_US = (44.0, 22.0)
"""Slow on-times of theta and phi, medians: where there is no table beside the maps."""
TABLES = ("pfs_2394_cobras_scalars.csv.gz", "pfs_2394_cobras_scalars.csv")
"""Beside the maps: the on-times, ms."""
_MOTORS, _WAYS = ("theta", "phi"), ("fwd", "rev")


def read_summary_maps(path: str | Path, cobra_id: Ints) -> MotorMaps:
    """The slow maps of some cobras.

    Parameters
    ----------
    path : str or Path
        npz with, of each cobra, `module` ("SC03"), `positioner` (1 to 57), and for theta and phi, fwd and
        rev, the deg per step of B bins and the last edge in deg. A table of on-times beside it is read too.
    cobra_id : (N,) int
        57 (module - 1) + positioner of those that are wanted, in this order.

    Returns
    -------
    MotorMaps
        Of 2 N motors: theta and phi of the first cobra, of the second, and so on.

    Raises
    ------
    InputError
        Not such a file, or a cobra that it does not have.
    """
    path = Path(path)
    held = _arrays(path)
    own = PER_MODULE * (np.char.lstrip(held["module"], "SC").astype(np.int64) - 1) + held["positioner"]
    row_of = {int(number): row for row, number in enumerate(own)}
    if missing := [int(number) for number in cobra_id if int(number) not in row_of]:
        raise InputError(f"{path}: no motor map of cobra {missing[0]}; it has {len(own)} others")
    rows = np.array([row_of[int(number)] for number in cobra_id], dtype=np.int64)
    step = np.array([[held[f"{m}_{w}_deg_per_step"][rows] for w in _WAYS] for m in _MOTORS], dtype=np.float64)
    edges = np.concatenate([held[f"{m}_{w}_last_edge_deg"] for m in _MOTORS for w in _WAYS])
    bins = step.shape[3]
    pulse = _pulses_us(path.parent, len(own))[:, :, rows]
    motors = step.transpose(2, 0, 1, 3).reshape(2 * len(rows), 2, bins)
    return MotorMaps(motors, float(np.median(edges)) / bins, pulse.transpose(2, 0, 1).reshape(-1, 2))


def write_summary_maps(path: str | Path, maps: MotorMaps, cobra_id: Ints) -> None:
    """Writes such a file: `maps` of 2 N motors, of cobras `cobra_id` (N,). Pulses are not in it."""
    own = np.asarray(cobra_id) - 1
    step = maps.step_deg.reshape(len(own), 2, 2, -1)
    last = np.full(len(own), maps.bin_deg * step.shape[3])
    arrays: dict[str, Any] = {"module": np.array([f"SC{k:02d}" for k in own // PER_MODULE + 1])}
    arrays["positioner"] = own % PER_MODULE + 1
    for i, motor in enumerate(_MOTORS):
        for j, way in enumerate(_WAYS):
            arrays[f"{motor}_{way}_deg_per_step"] = step[:, i, j]
            arrays[f"{motor}_{way}_last_edge_deg"] = last
    with whole(path) as part, part.open("wb") as file:
        np.savez_compressed(file, **arrays)


def _arrays(path: Path) -> dict[str, Array]:
    names = [f"{m}_{w}_{what}" for m in _MOTORS for w in _WAYS for what in ("deg_per_step", "last_edge_deg")]
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            held = {name: file[name] for name in ("module", "positioner", *names)}
        np.char.lstrip(held["module"], "SC").astype(np.int64)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or one_line(error)}; give a file of motor maps") from None
    except (KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: no summary of motor maps ({one_line(error)})") from None
    n = len(held["module"])
    if {a.shape[0] for a in held.values()} != {n} or len({held[k].shape for k in names[::2]}) != 1:
        raise InputError(f"{path}: its arrays do not have the same {n} cobras and bins")
    return held


def _pulses_us(folder: Path, n: int) -> Floats:
    """(2, 2, n) theta and phi, forward and reverse; a motor without one gets that of others of its kind."""
    usual = np.broadcast_to(np.array(PULSE_US)[:, None, None], (2, 2, n))
    table = next((folder / name for name in TABLES if (folder / name).exists()), None)
    if table is None:
        return usual.copy()
    rows = read_table(table)
    names = [f"link{k}_{way}_ontime_ms_slow" for k in (1, 2) for way in _WAYS]
    rows.require(*names)
    ms = np.array([rows.numbers(name) for name in names])
    if ms.shape[1] != n:
        raise InputError(f"{table}: {ms.shape[1]} cobras, the maps beside it have {n}")
    told = np.rint(1e3 * ms).reshape(2, 2, n)
    return np.where(told > 0.0, told, np.median(told, axis=2, keepdims=True))
