"""Geometry of an array straight from its tables, in numpy alone: nothing of fiberloom's geometry or core.

Tables: a folder as `write_layout` writes it, or calibrations of SDSS-V. What all positioners have in common
comes from the instrument's TOML. Angles in rad, lengths in mm.
"""

from __future__ import annotations

import csv
import shlex
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.typing import Floats, Ints

ROOT = Path(__file__).parents[2]
TOML = ROOT / "src" / "fiberloom" / "instruments" / "presets" / "sdssv.toml"
CHIP_MM = 2.0
"""A guide camera whose chip is so near to its nominal place has its nominal edge."""


@dataclass(frozen=True)
class Bodies:
    """All bodies of an array, seen from above."""

    positioner_id: Ints
    centre: Floats
    """(N,) complex x + iy, mm."""
    l_alpha: Floats
    """(N,) mm."""
    alpha_off: Floats
    """(N,) rad, with the direction of alpha = 0."""
    beta_off: Floats
    """(N,) rad."""
    segment: tuple[float, float]
    """Of the beta arm: where its centre line begins and ends, mm from the beta axis."""
    obstacles: Floats
    """(K, 5): x0, y0, x1, y1, radius in mm; fiducials first."""
    stops_deg: Floats
    """(2, 2) hard stops of alpha and beta."""

    @property
    def far(self) -> float:
        """The end of a centre line from the beta axis, mm."""
        return max(abs(x) for x in self.segment)

    def reach(self, row: int) -> float:
        """How far the centre line of an arm gets from its centre, mm."""
        return float(self.l_alpha[row]) + self.far

    def lines(self, row: int, alpha: Floats, beta: Floats) -> tuple[Floats, Floats]:
        """Both ends (complex, mm) of the centre line of an arm at these angles, rad."""
        first = alpha + self.alpha_off[row]
        second = first + beta + self.beta_off[row]
        elbow = self.centre[row] + self.l_alpha[row] * np.exp(1j * first)
        along = np.exp(1j * second)
        return elbow + self.segment[0] * along, elbow + self.segment[1] * along

    def lines_of(self, rows: Ints, angles_deg: Floats) -> tuple[Floats, Floats]:
        """Both ends of the centre lines of some arms; angles (N, 2) deg of all."""
        ends = [self.lines(int(row), *np.radians(angles_deg[row])) for row in rows]
        return np.array([p for p, _ in ends]), np.array([q for _, q in ends])

    def near_obstacles(self, row: int, radius: float) -> Ints:
        """Which obstacles an arm of this radius can touch."""
        here = np.array([self.centre[row]])
        p, q = (self.obstacles[:, k] + 1j * self.obstacles[:, k + 1] for k in (0, 2))
        return np.flatnonzero(to_segment(here, p, q) < self.reach(row) + radius + self.obstacles[:, 4] + 0.1)

    def neighbours(self, row: int, radius: float) -> Ints:
        """Which other arms it can touch."""
        apart = np.abs(self.centre - self.centre[row])
        near = apart < self.l_alpha + self.far + self.reach(row) + 2.0 * radius + 0.1
        near[row] = False
        return np.flatnonzero(near)

    def row_of(self, positioner_id: int) -> int:
        """Its row."""
        return int(np.flatnonzero(self.positioner_id == positioner_id)[0])


def to_segment(point: Floats, p: Floats, q: Floats) -> Floats:
    """Distance in mm of points from segments p to q, all complex; a segment may be a point."""
    along, off = q - p, point - p
    length2 = np.abs(along) ** 2
    part = np.clip((off * along.conj()).real / np.where(length2 > 0.0, length2, 1.0), 0.0, 1.0)
    return np.abs(off - part * along)


def between(p: Floats, q: Floats, r: Floats, s: Floats) -> Floats:
    """Distance in mm of segments p to q from segments r to s, all complex; 0 where they cross."""
    ends = [to_segment(p, r, s), to_segment(q, r, s), to_segment(r, p, q), to_segment(s, p, q)]
    apart = np.minimum.reduce(np.broadcast_arrays(*ends))
    one, other = q - p, s - r
    sides = [_cross(one, r - p) * _cross(one, s - p) < 0.0, _cross(other, p - r) * _cross(other, q - r) < 0.0]
    return np.where(sides[0] & sides[1], 0.0, apart)


def _cross(a: Floats, b: Floats) -> Floats:
    return a.real * b.imag - a.imag * b.real


# tables


def read_bodies(folder: Path, toml: Path = TOML) -> Bodies:
    """The bodies of the array in a folder of tables."""
    instrument = tomllib.loads(toml.read_text())
    own = (folder / "positioners.ecsv").is_file()
    robots, obstacles = _own(folder) if own else _sdssv(folder, instrument)
    return Bodies(
        positioner_id=robots[:, 0].astype(np.int64),
        centre=robots[:, 1] + 1j * robots[:, 2],
        l_alpha=robots[:, 3],
        alpha_off=np.radians(robots[:, 4]),
        beta_off=np.radians(robots[:, 5]),
        segment=tuple(instrument["bodies"]["beta_segment_mm"]),
        obstacles=obstacles,
        stops_deg=np.array(
            [instrument[axis]["hard_stop_deg"] for axis in ("alpha", "beta")], dtype=np.float64
        ),
    )


def _columns(path: Path, *names: str) -> Floats:
    """(n, len(names)) of a CSV or ECSV table."""
    lines = [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
    rows = list(csv.reader(lines)) if path.suffix == ".csv" else [shlex.split(line) for line in lines]
    if len(rows) < 2:
        return np.zeros((0, len(names)))
    where = [rows[0].index(name) for name in names]
    return np.array([[float(row[k]) for k in where] for row in rows[1:]], dtype=np.float64)


def _own(folder: Path) -> tuple[Floats, Floats]:
    robots = _columns(
        folder / "positioners.ecsv",
        "positioner_id", "centre_x_mm", "centre_y_mm", "l_alpha_mm", "alpha_off_deg", "beta_off_deg",
        "offline",
    )  # fmt: skip
    if robots[:, 6].any():
        raise ValueError(f"{folder}: positioners that are offline are no bodies here")
    discs = _columns(folder / "fiducials.ecsv", "x_mm", "y_mm", "x_mm", "y_mm", "radius_mm")
    cameras = _columns(folder / "guide_cameras.ecsv", "x0_mm", "y0_mm", "x1_mm", "y1_mm", "radius_mm")
    return robots, np.vstack([discs, cameras])


def _sdssv(folder: Path, instrument: dict[str, Any]) -> tuple[Floats, Floats]:
    with (folder / "wokCoords.csv").open() as file:
        holes = {row["holeID"]: row for row in csv.DictReader(file)}
    robots = []
    with (folder / "positionerTable.csv").open() as file:
        for row in csv.DictReader(file):
            hole = {key: float(holes[row["holeID"]][key]) for key in ("xWok", "yWok", "ix", "iy", "jx", "jy")}
            i, j = hole["ix"] + 1j * hole["iy"], hole["jx"] + 1j * hole["jy"]
            centre = hole["xWok"] + 1j * hole["yWok"] + float(row["dx"]) * i + float(row["dy"]) * j
            off_deg = np.degrees(np.angle(i)) + float(row["alphaOffset"])
            arm = (float(row["alphaArmLen"]), off_deg, float(row["betaOffset"]))
            robots.append((int(row["positionerID"]), centre.real, centre.imag, *arm))
    bodies = instrument["bodies"]
    discs = _columns(folder / "fiducialCoords.csv", "xWok", "yWok", "xWok", "yWok")
    discs = np.column_stack([discs, np.full(len(discs), bodies["fiducial_radius_mm"])])
    return np.array(robots), np.vstack([discs, _cameras(folder / "gfaCoords.csv", instrument)])


def _cameras(path: Path, instrument: dict[str, Any]) -> Floats:
    """(G, 5): the edges that face the field."""
    layout = instrument["layout"]["guide_cameras"]
    turns = np.radians(layout["first_direction_deg"] + 360.0 / layout["number"] * np.arange(layout["number"]))
    out, across = np.exp(1j * turns), 1j * np.exp(1j * turns)
    nominal = out * layout["face_distance_mm"]
    if not path.is_file():
        middle = nominal
    else:
        table = _columns(path, "xWok", "yWok", "ix", "iy", "jx", "jy")
        chip, i, j = (table[:, k] + 1j * table[:, k + 1] for k in (0, 2, 4))
        middle = chip - (layout["centre_distance_mm"] - layout["face_distance_mm"]) * j
        nearest = np.abs(middle[:, None] - nominal).argmin(axis=1)
        near = np.abs(middle - nominal[nearest]) < CHIP_MM
        middle, across = np.where(near, nominal[nearest], middle), np.where(near, across[nearest], i)
    ends = [middle - layout["half_width_mm"] * across, middle + layout["half_width_mm"] * across]
    radius = np.full(len(middle), instrument["bodies"]["guide_camera_radius_mm"])
    return np.column_stack([ends[0].real, ends[0].imag, ends[1].real, ends[1].imag, radius])
