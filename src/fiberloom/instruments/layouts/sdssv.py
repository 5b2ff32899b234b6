"""The calibration folder of SDSS-V (sdss/fps_calibrations, wok_calibs/*): one row per positioner,
hole, fiducial and guide camera, in the wok frame, which is our focal-plane frame."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fiberloom.errors import InputError
from fiberloom.instruments.focal_plane import FocalPlane
from fiberloom.instruments.generated import guide_camera_capsules
from fiberloom.instruments.model import METROLOGY, Instrument
from fiberloom.tables import TableFile, read_table
from fiberloom.typing import Floats, Ints
from fiberloom.units import deg_to_rad

POINTS = {METROLOGY: "met", "BOSS": "boss", "APOGEE": "ap"}
"""Our names of the points, and the prefix of their columns X and Y."""
FRAME = tuple(f"{axis}{c}" for axis in "ijk" for c in "xyz")
FRAME_TOLERANCE = 1e-6
CAMERA_TOLERANCE_MM = 2.0


def read_sdssv(folder: Path, instrument: Instrument) -> FocalPlane:
    """positionerTable.csv, wokCoords.csv, fiducialCoords.csv and, if there, gfaCoords.csv."""
    _check_instrument(folder, instrument)
    table = read_table(folder / "positionerTable.csv")
    table.require(
        "holeID",
        "positionerID",
        "alphaArmLen",
        "alphaOffset",
        "betaOffset",
        "dx",
        "dy",
        *(f"{p}{c}" for p in POINTS.values() for c in "XY"),
    )
    table.unique("positionerID", number=True)
    table.unique("holeID")
    holes = read_table(folder / "wokCoords.csv")
    place = _join(table, holes)
    n = len(table)
    return FocalPlane(
        instrument=instrument,
        positioner_id=table.integers("positionerID"),
        hole=table.strings("holeID"),
        arms=_arms(table, holes, place),
        points=_points(table, holes.strings("holeType")[place]),
        fiducials=_fiducials(folder / "fiducialCoords.csv", instrument),
        guide_cameras=_guide_cameras(folder / "gfaCoords.csv", instrument),
        offline=np.zeros(n, dtype=bool),
        offline_position_deg=np.tile(instrument.positioner.park_deg, (n, 1)),
    )


def _check_instrument(folder: Path, instrument: Instrument) -> None:
    missing = [name for name in POINTS if name not in instrument.positioner.points]
    if missing:
        raise InputError(
            f"{folder}: a layout of SDSS-V positioners, but instrument '{instrument.name}' has no "
            f"point {', '.join(missing)}; use --instrument sdssv"
        )


def _join(table: TableFile, holes: TableFile) -> Ints:
    """Row of wokCoords for each positioner."""
    holes.require("holeID", "holeType", "xWok", "yWok", *FRAME)
    holes.unique("holeID")
    where = {name: row for row, name in enumerate(holes.strings("holeID"))}
    kinds = holes.strings("holeType")
    rows = []
    for row, hole in enumerate(table.strings("holeID")):
        if hole not in where:
            raise table.error(row, "holeID", f"= {hole} is not in {holes.path.name}")
        if kinds[where[hole]] == "Fiducial":
            raise table.error(row, "holeID", f"= {hole} is the hole of a fiducial")
        rows.append(where[hole])
    return np.array(rows, dtype=np.int64)


def _arms(table: TableFile, holes: TableFile, place: Ints) -> Floats:
    frame = _frames(holes)[place]
    # the offset of the base is given in the positioner's own frame (i, j)
    shift = table.numbers("dx")[:, None] * frame[:, 0] + table.numbers("dy")[:, None] * frame[:, 1]
    centre = np.column_stack([holes.numbers("xWok"), holes.numbers("yWok")])[place]
    orientation = np.arctan2(frame[:, 0, 1], frame[:, 0, 0])
    length = table.numbers("alphaArmLen")
    if np.any(length <= 0):
        row = int(np.flatnonzero(length <= 0)[0])
        raise table.error(row, "alphaArmLen", f"= {length[row]} must be positive")
    return np.column_stack(
        [
            centre + shift[:, :2],
            length,
            orientation + deg_to_rad(table.numbers("alphaOffset")),
            deg_to_rad(table.numbers("betaOffset")),
        ]
    )


def _frames(holes: TableFile) -> Floats:
    """(n, 3, 3) unit vectors i, j, k of each hole: right-handed, flat."""
    frame = np.stack([holes.numbers(name) for name in FRAME], axis=1).reshape(-1, 3, 3)
    unit = np.abs(frame @ frame.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) > FRAME_TOLERANCE
    mirrored = np.linalg.det(frame) < 0
    tilted = np.abs(frame[:, 2] - [0.0, 0.0, 1.0]).max(axis=1) > FRAME_TOLERANCE
    for wrong, problem in (
        (unit, "are not three orthogonal unit vectors"),
        (mirrored, "form a left-handed frame; k must be i x j"),
        (tilted, "are tilted; only flat woks are supported: k must be (0, 0, 1)"),
    ):
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            hole = holes.strings("holeID")[row]
            raise holes.error(row, "ix..kz", f"of hole {hole} {problem}")
    return frame


def _points(table: TableFile, hole_type: NDArray[np.str_]) -> dict[str, Floats]:
    points = {
        name: np.column_stack([table.numbers(f"{prefix}{c}") for c in "XY"])
        for name, prefix in POINTS.items()
    }
    # the table has nominal numbers for fibres that are not there: the hole decides
    points["APOGEE"][np.char.find(hole_type, "Apogee") < 0] = np.nan
    return points


def _fiducials(path: Path, instrument: Instrument) -> Floats:
    table = read_table(path)
    table.require("xWok", "yWok")
    radius = np.full(len(table), instrument.bodies.fiducial_radius_mm)
    return np.column_stack([table.numbers("xWok"), table.numbers("yWok"), radius])


def _guide_cameras(path: Path, instrument: Instrument) -> Floats:
    """The edges of the cameras that face the field.

    The table locates chips, not housings. A chip within 2 mm of its nominal place leaves the
    nominal edge as it is, as the SDSS-V planner does; one elsewhere takes its edge with it. Without
    the table, the cameras are at their nominal places.
    """
    nominal = guide_camera_capsules(instrument, instrument.layout)
    if not path.is_file():
        return nominal
    table = read_table(path)
    cameras = instrument.layout.guide_cameras
    if cameras is None:
        raise InputError(f"{path}: instrument '{instrument.name}' has no layout.guide_cameras")
    table.require("xWok", "yWok", "ix", "iy", "jx", "jy")
    chip = np.column_stack([table.numbers("xWok"), table.numbers("yWok")])
    along = np.column_stack([table.numbers("ix"), table.numbers("iy")]) * cameras.half_width_mm
    outwards = np.column_stack([table.numbers("jx"), table.numbers("jy")])
    edge = chip - (cameras.centre_distance_mm - cameras.face_distance_mm) * outwards
    radius = np.full((len(table), 1), instrument.bodies.guide_camera_radius_mm)
    return _snapped(np.hstack([edge - along, edge + along, radius]), nominal)


def _snapped(found: Floats, nominal: Floats) -> Floats:
    """Each capsule, or the nominal one where their middles agree."""
    middle = (found[:, None, :2] + found[:, None, 2:4]) / 2
    distance = np.linalg.norm(middle - (nominal[:, :2] + nominal[:, 2:4]) / 2, axis=2)
    nearest = distance.argmin(axis=1)
    near = distance[np.arange(len(found)), nearest] < CAMERA_TOLERANCE_MM
    return np.where(near[:, None], nominal[nearest], found)
