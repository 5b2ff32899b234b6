"""The tables of DESI: calibrations of positioners, alignment of the petals, surveyed fiducials.

desihub/desimeter: `offset_x`, `offset_y` and the arms are given in a petal's "flat" frame, where the distance
from the axis is the length of the arc along the focal surface. A petal's frame has the distance from the axis
instead; turned and shifted by its alignment it is the focal plane (CS5).
"""

from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from fiberloom.errors import InputError
from fiberloom.files import MB, read_text
from fiberloom.instruments.axis import Ranges
from fiberloom.instruments.focal_plane import FocalPlane
from fiberloom.instruments.handicaps import Handicaps
from fiberloom.instruments.layouts.folder import (
    check_arms,
    lengths,
    points_of,
    required,
    table_of,
    truths,
)
from fiberloom.instruments.model import Instrument
from fiberloom.instruments.outlines import KeepOut
from fiberloom.tables import TableFile
from fiberloom.typing import Array, Floats, Ints
from fiberloom.units import deg_to_rad

CALIBRATIONS = ("calib-*.csv.gz", "calib-*.csv")
PETAL_IDS = np.array([4, 5, 6, 3, 8, 10, 11, 2, 7, 9])
"""By their place in the focal plane, `petal_loc`."""
PHI_STOP_DEG = 185.0
"""Where phi's range ends (posmodel)."""
CLEARANCE_DEG = 3.0
"""That targets keep to the stops (positioner constants), beside the room for the overshoot."""
NOMINAL_R2_MM = 3.0
"""Length for which the outline of a phi arm is drawn (keepout.py)."""
LEAST_LINEAR_DEG = 5.0
"""Angular expansion of the outline of a phi arm on a linear motor, at least."""
PETAL_MIDDLE_DEG = 18.0
"""Direction of the middle of a petal in its own frame. In the preset rows of positioners lie along x: 0."""
ALIGNMENT_BYTES = MB


def read_desi(folder: Path, instrument: Instrument) -> FocalPlane:
    """calib-*.csv[.gz], petal-alignments.yaml, focal_surface_lookup.csv, fp-metrology.csv[.gz].

    Of a location that is there twice the row with the later `time_recorded` counts. Units that are classified
    as not functional are offline; the tables do not say where they stand: folded is assumed.
    """
    table = table_of(required(folder, *CALIBRATIONS), *_COLUMNS)
    rows = _latest(table)
    petal = _petals(table)[rows]
    own = _desimeter(folder)
    l_alpha, l_beta = (lengths(table, f"length_r{k}")[rows] for k in (1, 2))
    check_arms(table.path, instrument, l_alpha, "DESI")
    surface, aligned = _surface(own), _alignments(own / "petal-alignments.yaml")
    xy, turn = _centres(table, rows, surface, aligned[petal])
    location = table.integers("location")[rows]
    alpha_off, beta_off = (deg_to_rad(table.numbers(f"offset_{c}")[rows]) for c in "tp")
    n = len(rows)
    return FocalPlane(
        instrument=_with_keep_outs(instrument, surface, aligned),
        positioner_id=location,
        hole=np.array([f"P{where // 1000}D{where % 1000:03d}" for where in location.tolist()]),
        arms=np.column_stack([xy, l_alpha, alpha_off + turn, beta_off]),
        points=points_of(instrument, l_beta),
        fiducials=_fiducials(own, instrument),
        guide_cameras=np.empty((0, 5)),
        offline=truths(table, "device_classified_nonfunctional")[rows],
        offline_position_deg=np.tile(instrument.positioner.park_deg, (n, 1)),
        handicaps=_wider(table, rows, instrument),
        ranges=_ranges(table, rows, instrument),
    )


_EXPANSIONS = tuple(
    f"keepout_expansion_{arm}_{way}" for arm in ("theta", "phi") for way in ("radial", "angular")
)
_COLUMNS = (
    "petal_id", "location", "time_recorded", "length_r1", "length_r2", "offset_x", "offset_y", "offset_t",
    "offset_p", "physical_range_t", "physical_range_p", "device_classified_nonfunctional", "zeno_motor_p",
    *_EXPANSIONS,
)  # fmt: skip


def _with_keep_outs(instrument: Instrument, surface: TableFile, aligned: Floats) -> Instrument:
    """The instrument with edges of petals where real petals have them, and guide cameras on each petal.

    Corners of a guide camera are given in a petal's flat frame, as centres are; `aligned`: (10, 3).
    """
    kept: list[KeepOut] = []
    for part in instrument.bodies.keep_outs:
        turned = part.turned(float(deg_to_rad(PETAL_MIDDLE_DEG)))
        kept += [turned] if part.polygon_mm is None else _on_petals(turned, surface, aligned)
    bodies = instrument.bodies.model_copy(update={"keep_outs": tuple(kept)})
    return instrument.model_copy(update={"bodies": bodies})


def _on_petals(part: KeepOut, surface: TableFile, aligned: Floats) -> list[KeepOut]:
    """One of each petal, of a part in the flat frame of a petal."""
    arc, radius = surface.numbers("S"), surface.numbers("R")

    def placed(flat: Array, petal: Floats) -> Array:
        along = np.abs(flat)
        shift = complex(petal[0], petal[1])
        return np.asarray(flat * np.interp(along, arc, radius) / along * np.exp(1j * petal[2]) + shift)

    single = part.model_copy(update={"copies": 1})
    return [single.moved(partial(placed, petal=petal)) for petal in aligned]


def _desimeter(folder: Path) -> Path:
    """Where desimeter's own tables are: in a folder of its name, or beside the calibrations."""
    return folder / "desimeter" if (folder / "desimeter").is_dir() else folder


def _latest(table: TableFile) -> Ints:
    """Rows of the latest calibration of each location, in the order of the locations."""
    location, time = table.integers("location"), table.strings("time_recorded")
    order = np.lexsort((time, location))
    last = np.append(location[order][1:] != location[order][:-1], True)
    rows: Ints = order[last]
    return rows


def _petals(table: TableFile) -> Ints:
    """Place in the focal plane of each row's petal, checked against the location."""
    petal_id, place = table.integers("petal_id"), table.integers("location") // 1000
    known = (place >= 0) & (place < len(PETAL_IDS))
    same = known & (PETAL_IDS[np.where(known, place, 0)] == petal_id)
    for row in np.flatnonzero(~same)[:1]:
        told = f"= {petal_id[row]} is not at place {place[row]} of the focal plane, as the location says"
        raise table.error(int(row), "petal_id", told)
    return place


def _surface(folder: Path) -> TableFile:
    """R and S mm of the focal surface, both rising."""
    table = table_of(required(folder, "focal_surface_lookup.csv"), "R", "S")
    for name in ("R", "S"):
        for row in np.flatnonzero(np.diff(table.numbers(name)) <= 0.0)[:1]:
            raise table.error(int(row) + 1, name, "does not rise from row to row")
    return table


def _centres(table: TableFile, rows: Ints, surface: TableFile, aligned: Floats) -> tuple[Floats, Floats]:
    """(n, 2) mm in the focal plane, and (n,) rad by which the petal of each is turned."""
    flat = np.column_stack([table.numbers(f"offset_{c}")[rows] for c in "xy"])
    along = np.hypot(*flat.T)
    arc = surface.numbers("S")
    for k in np.flatnonzero((along <= 0.0) | (along > arc[-1]))[:1]:
        told = f"= {flat[k, 0]:g}: its distance from the axis, {along[k]:g} mm, is beyond the focal surface"
        raise table.error(int(rows[k]), "offset_x", told)
    xy = flat * (np.interp(along, arc, surface.numbers("R")) / along)[:, None]
    shift, turn = aligned[:, :2], aligned[:, 2]
    c, s = np.cos(turn), np.sin(turn)
    return shift + np.column_stack([c * xy[:, 0] - s * xy[:, 1], s * xy[:, 0] + c * xy[:, 1]]), turn


def _alignments(path: Path) -> Floats:
    """(10, 3) Tx, Ty in mm and gamma in rad of each place of a petal; the petals lie flat."""
    found: dict[int, dict[str, float]] = {}
    for number, line in enumerate(read_text(path, ALIGNMENT_BYTES).splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        key, colon, value = line.partition(":")
        try:
            if not colon:
                raise ValueError
            if not line[0].isspace():
                entry = found[int(key)] = {}
            else:
                entry[key.strip()] = float(value)
        except (ValueError, UnboundLocalError):
            raise InputError(f"{path}, line {number}: neither 'petal:' nor '  key: number'") from None
    return np.array([_aligned(path, place, found.get(place, {})) for place in range(len(PETAL_IDS))])


def _aligned(path: Path, place: int, entry: dict[str, float]) -> tuple[float, float, float]:
    needed = ("Tx", "Ty", "alpha", "beta", "gamma")
    for key in needed:
        if not np.isfinite(entry.get(key, np.nan)):
            raise InputError(f"{path}: petal {place}: {key} is missing, or is no finite number")
    if entry["alpha"] != 0.0 or entry["beta"] != 0.0:
        raise InputError(f"{path}: petal {place} is tilted (alpha, beta); only flat petals are supported")
    return entry["Tx"], entry["Ty"], entry["gamma"]


def _ranges(table: TableFile, rows: Ints, instrument: Instrument) -> Ranges:
    """Theta to both sides of 0, phi up to its stop; targets keep clearance, and room for the overshoot."""
    theta, phi = (table.numbers(f"physical_range_{c}")[rows] for c in "tp")
    ends = [[-0.5 * theta, 0.5 * theta], [PHI_STOP_DEG - phi, np.full(len(phi), PHI_STOP_DEG)]]
    stops = np.moveaxis(np.array(ends), -1, 0)
    over = np.array([axis.approach_deg for axis in instrument.axes])
    low = stops[..., 0] + CLEARANCE_DEG + np.maximum(-over, 0.0)
    high = stops[..., 1] - CLEARANCE_DEG - np.maximum(over, 0.0)
    for k, axis in np.argwhere(~(low < high))[:1]:
        name = f"physical_range_{'tp'[axis]}"
        told = f"= {(theta, phi)[axis][k]:g} deg leaves nothing beside {CLEARANCE_DEG:g} deg to each stop"
        raise table.error(int(rows[k]), name, told)
    return Ranges(np.stack([low, high], axis=-1), stops)


def _wider(table: TableFile, rows: Ints, instrument: Instrument) -> Handicaps:
    """Room for arms that are longer than the outline, and for its expansions: all parts as wide as needed."""
    grown = {name: table.numbers(name)[rows] for name in _EXPANSIONS}
    linear = np.char.lower(table.strings("zeno_motor_p")[rows]) == "true"
    angle = {arm: grown[f"keepout_expansion_{arm}_angular"] for arm in ("theta", "phi")}
    angle["phi"] = np.where(linear, np.maximum(angle["phi"], LEAST_LINEAR_DEG), angle["phi"])
    longer = np.maximum(table.numbers("length_r2")[rows] - NOMINAL_R2_MM, 0.0)
    room = []
    for arm, name, more in (("theta", "alpha", 0.0), ("phi", "beta", longer)):
        turned = _turned_mm(instrument, name, np.clip(angle[arm], 0.0, 90.0))
        room.append(turned + np.maximum(grown[f"keepout_expansion_{arm}_radial"], 0.0) + more)
    none = Handicaps.none(len(rows))
    return Handicaps(np.maximum(*room), none.doubt_deg, none.speed_share, none.acceleration_share)


def _turned_mm(instrument: Instrument, arm: str, angle_deg: Floats) -> Floats:
    """(n,) mm by which corners of an arm stick out of its outline that are turned away by (n,) deg."""
    polygons = [
        np.array(part.polygon_mm) for part in instrument.bodies.parts if part.arm == arm and part.polygon_mm
    ]
    angles, which = np.unique(angle_deg, return_inverse=True)
    out = np.zeros(len(angles))
    for corners in polygons:
        turn = deg_to_rad(np.sign(corners[:, 1]) * angles[:, None])
        z = (corners[:, 0] + 1j * corners[:, 1]) * np.exp(1j * turn)
        out = np.maximum(out, _outside_mm(z, corners[ConvexHull(corners).vertices]).max(axis=1))
    return np.asarray(out[which])


def _outside_mm(points: Array, hull: Floats) -> Floats:
    """Distances of complex points (..., ) in mm from a convex polygon (k, 2), 0 inside of it."""
    corners = hull @ [1.0, 1.0j]
    edges = np.roll(corners, -1) - corners
    off = points[..., None] - corners
    along = np.clip(np.real(off * np.conj(edges)) / np.abs(edges) ** 2, 0.0, 1.0)
    beyond = np.imag(off * np.conj(edges)) < -1e-12
    nearest = np.abs(off - along * edges).min(axis=-1)
    return np.asarray(np.where(beyond.any(axis=-1), nearest, 0.0))


def _fiducials(folder: Path, instrument: Instrument) -> Floats:
    """(M, 3): every pinhole of those in the field (FIF) and of the guide cameras (GIF)."""
    path = required(folder, "fp-metrology.csv.gz", "fp-metrology.csv")
    table = table_of(path, "DEVICE_TYPE", "X_FP", "Y_FP")
    lit = np.flatnonzero(np.isin(table.strings("DEVICE_TYPE"), ("FIF", "GIF")))
    xy = np.column_stack([table.numbers("X_FP"), table.numbers("Y_FP")])[lit]
    return np.column_stack([xy, np.full(len(lit), instrument.bodies.fiducial_radius_mm)])
