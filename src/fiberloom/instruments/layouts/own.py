"""Focal planes as files of our own: layout.toml and tables in ECSV."""

from pathlib import Path

import numpy as np

from fiberloom.errors import InputError
from fiberloom.files import parse_toml, read_text, shown
from fiberloom.instruments.axis import Ranges
from fiberloom.instruments.focal_plane import FocalPlane
from fiberloom.instruments.handicaps import Handicaps
from fiberloom.instruments.model import AXES, Instrument
from fiberloom.tables import TableFile, read_table
from fiberloom.typing import Array, Floats
from fiberloom.units import deg_to_rad, rad_to_deg
from fiberloom.version import __version__
from fiberloom.wholefile import whole, write_whole

FORMAT = 1
INDEX, POSITIONERS = "layout.toml", "positioners.ecsv"
FIDUCIALS, GUIDE_CAMERAS = "fiducials.ecsv", "guide_cameras.ecsv"


def write_layout(plane: FocalPlane, directory: str | Path) -> None:
    """Write a focal plane as layout.toml and three ECSV tables, to be read by `read_layout`."""
    folder = Path(directory)
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(
        folder / INDEX,
        f"format = {FORMAT}\n"
        f'instrument = "{plane.instrument.name}"\n'
        f'version = "{__version__}"\n'
        f'config_hash = "{plane.config_hash()}"\n',
    )
    _write(folder / POSITIONERS, _positioner_columns(plane))
    _write(folder / FIDUCIALS, dict(zip(_FIDUCIAL, plane.fiducials.T, strict=True)))
    _write(folder / GUIDE_CAMERAS, dict(zip(_CAMERA, plane.guide_cameras.T, strict=True)))


_FIDUCIAL = ("x_mm", "y_mm", "radius_mm")
_CAMERA = ("x0_mm", "y0_mm", "x1_mm", "y1_mm", "radius_mm")


_HANDICAPS = ("wider_mm", "doubt_alpha_deg", "doubt_beta_deg", "speed_share", "acceleration_share")
"""Columns of `Handicaps`, all of them or none."""


_DOTS = ("dot_x_mm", "dot_y_mm", "dot_radius_mm")
"""Columns of `FocalPlane.dots_mm`, all of them or none."""

_RANGES = tuple(
    f"{axis}_{what}_{end}_deg" for what in ("target", "stop") for axis in AXES for end in ("min", "max")
)
"""Columns of `Ranges`, all of them or none."""


def _flat_ranges(ranges: Ranges) -> Floats:
    """(N, 8) in the order of the columns."""
    return np.hstack([part.reshape(-1, 4) for part in ranges.arrays.values()])


def _flat(handicaps: Handicaps) -> Floats:
    """(N, 5) in the order of the columns."""
    return np.column_stack(list(handicaps.arrays.values()))


def _positioner_columns(plane: FocalPlane) -> dict[str, Array]:
    columns: dict[str, Array] = {
        "positioner_id": plane.positioner_id,
        "hole": plane.hole,
        "centre_x_mm": plane.centres_mm[:, 0],
        "centre_y_mm": plane.centres_mm[:, 1],
        "l_alpha_mm": plane.l_alpha_mm,
        "alpha_off_deg": rad_to_deg(plane.alpha_off_rad),
        "beta_off_deg": rad_to_deg(plane.beta_off_rad),
        "offline": plane.offline.astype(np.int64),
        "offline_alpha_deg": plane.offline_position_deg[:, 0],
        "offline_beta_deg": plane.offline_position_deg[:, 1],
    }
    if plane.handicaps is not None:
        columns |= dict(zip(_HANDICAPS, _flat(plane.handicaps).T, strict=True))
    if plane.dots_mm is not None:
        columns |= dict(zip(_DOTS, plane.dots_mm.T, strict=True))
    if plane.ranges is not None:
        columns |= dict(zip(_RANGES, _flat_ranges(plane.ranges).T, strict=True))
    for name, xy in plane.points.items():
        columns[f"has_{name}"] = plane.carries(name).astype(np.int64)
        columns |= {f"{name}_{c}_mm": np.nan_to_num(xy[:, i]) for i, c in enumerate("xy")}
    return columns


def _write(path: Path, columns: dict[str, Array]) -> None:
    from astropy.table import Table

    with whole(path) as part:
        Table(columns).write(part, format="ascii.ecsv", overwrite=True)


def read_own(folder: Path, instrument: Instrument) -> FocalPlane:
    """The focal plane that `write_layout` wrote into a folder."""
    _check_format(folder / INDEX)
    table = read_table(folder / POSITIONERS)
    names = tuple(instrument.positioner.points)
    table.require(
        "positioner_id",
        "hole",
        "centre_x_mm",
        "centre_y_mm",
        "l_alpha_mm",
        "alpha_off_deg",
        "beta_off_deg",
        "offline",
        "offline_alpha_deg",
        "offline_beta_deg",
        *(f"{n}_x_mm" for n in names),
    )
    table.unique("positioner_id", number=True)
    arms = [table.numbers(c) for c in ("centre_x_mm", "centre_y_mm", "l_alpha_mm")]
    angles = [deg_to_rad(table.numbers(f"{axis}_off_deg")) for axis in AXES]
    stand = [table.numbers(f"offline_{axis}_deg") for axis in AXES]
    return FocalPlane(
        instrument=instrument,
        positioner_id=table.integers("positioner_id"),
        hole=table.strings("hole"),
        arms=np.column_stack([*arms, *angles]),
        points={name: _read_point(table, name) for name in names},
        fiducials=_read_bodies(folder / FIDUCIALS, _FIDUCIAL),
        guide_cameras=_read_bodies(folder / GUIDE_CAMERAS, _CAMERA),
        offline=table.integers("offline") != 0,
        offline_position_deg=np.column_stack(stand),
        handicaps=_read_handicaps(table),
        ranges=_read_ranges(table),
        dots_mm=_read_dots(table),
    )


def _read_handicaps(table: TableFile) -> Handicaps | None:
    if not any(name in table.columns for name in _HANDICAPS):
        return None
    table.require(*_HANDICAPS)
    wider, alpha, beta, speed, acceleration = (table.numbers(name) for name in _HANDICAPS)
    return Handicaps(wider, np.column_stack([alpha, beta]), speed, acceleration)


def _read_ranges(table: TableFile) -> Ranges | None:
    if not any(name in table.columns for name in _RANGES):
        return None
    table.require(*_RANGES)
    flat = np.column_stack([table.numbers(name) for name in _RANGES])
    return Ranges(flat[:, :4].reshape(-1, 2, 2), flat[:, 4:].reshape(-1, 2, 2))


def _read_dots(table: TableFile) -> Floats | None:
    if not any(name in table.columns for name in _DOTS):
        return None
    table.require(*_DOTS)
    return np.column_stack([table.numbers(name) for name in _DOTS])


def _check_format(path: Path) -> None:
    found = parse_toml(read_text(path), str(path)).get("format")
    if found != FORMAT:
        raise InputError(f"{path}: format = {shown(found)}, this version reads format = {FORMAT}")


def _read_point(table: TableFile, name: str) -> Floats:
    table.require(f"has_{name}", f"{name}_x_mm", f"{name}_y_mm")
    xy = np.column_stack([table.numbers(f"{name}_{c}_mm") for c in "xy"])
    xy[table.integers(f"has_{name}") == 0] = np.nan
    return xy


def _read_bodies(path: Path, names: tuple[str, ...]) -> Floats:
    table = read_table(path)
    if not len(table):
        return np.empty((0, len(names)))
    table.require(*names)
    return np.column_stack([table.numbers(name) for name in names])
