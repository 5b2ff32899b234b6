"""Learnt maps from one night to the next: a file of all units, which another layout refuses."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from fiberloom.calibration.transmission.cache import default_directory
from fiberloom.drive.desi.maps.learned import LearnedMaps, MapBasis
from fiberloom.errors import InputError, one_line
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Array
from fiberloom.wholefile import whole

_ARRAYS = ("positioner_id", "orders", "believed_deg", "mean", "covariance", "surprises")


def kept_file(plane: FocalPlane, seed: int) -> Path:
    """Where what a twin of this `plane` and `seed` has taught is kept, unless a file is named."""
    return default_directory() / f"learnt-{plane.config_hash()[:16]}-{seed}.npz"


def save_maps(maps: LearnedMaps, path: str | Path) -> None:
    """Writes what was learnt to an npz file; InputError where it cannot be written.

    Angles of the counts in deg, means and covariances in deg and mm.
    """
    arrays = {name: getattr(maps, name) for name in _ARRAYS[2:]}
    with whole(path, folders=True) as part, part.open("wb") as file:
        # not compressed: it is written after each image, and noise does not shrink
        np.savez(
            file,
            allow_pickle=False,
            positioner_id=maps.plane.positioner_id,
            orders=maps.basis.orders,
            **arrays,
        )


def read_maps(path: str | Path, plane: FocalPlane, basis: MapBasis) -> LearnedMaps:
    """What was learnt of a `plane`, from a file of `save_maps`, with this `basis`.

    Units are found by their numbers: one that is new has learnt nothing, one that is gone is left out.
    InputError where there is no such file, or it is not one of maps with these orders.
    """
    found = _arrays(Path(path), basis)
    maps = LearnedMaps(plane, plane.park_deg, basis)
    row_of = {int(number): row for row, number in enumerate(found["positioner_id"])}
    here = np.array(
        [row for row, number in enumerate(plane.positioner_id) if int(number) in row_of], dtype=int
    )
    there = np.array([row_of[int(plane.positioner_id[row])] for row in here], dtype=int)
    for name in _ARRAYS[2:]:
        getattr(maps, name)[here] = found[name][there]
    return maps


def _arrays(path: Path, basis: MapBasis) -> dict[str, Array]:
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            found = {name: file[name] for name in _ARRAYS}
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or one_line(error)}; give a file of learnt maps") from None
    except (KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: no file of learnt maps ({one_line(error)})") from None
    n, unknowns = len(found["positioner_id"]), len(basis.variance())
    shapes = {"believed_deg": (n, 2), "mean": (n, unknowns), "surprises": (n,)}
    shapes["covariance"] = (n, unknowns, unknowns)
    if not np.array_equal(found["orders"], basis.orders) or any(
        found[k].shape != v for k, v in shapes.items()
    ):
        raise InputError(f"{path}: its maps are made of other waves; learn them anew")
    if not all(np.isfinite(found[name]).all() for name in _ARRAYS[2:]):
        raise InputError(f"{path}: holds numbers that are not finite; learn the maps anew")
    return found
