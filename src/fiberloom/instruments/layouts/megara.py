"""The tables of MEGARA: one row for each robot, with its arms, ranges and place.

guaix-ucm/megara-fmpt: theta_1 counts from the robot's own direction thetaO1, and theta_3 from the folded arm.
Both grow with the steps. Here alpha = -theta_1 from thetaO1, and beta = theta_3 - 180 deg: the other elbow.
"""

from pathlib import Path

import numpy as np

from fiberloom.instruments.axis import Ranges
from fiberloom.instruments.focal_plane import FocalPlane
from fiberloom.instruments.layouts.folder import check_arms, lengths, points_of, required, table_of, truths
from fiberloom.instruments.model import Instrument
from fiberloom.tables import TableFile
from fiberloom.typing import Floats
from fiberloom.units import rad_to_deg

TABLES = ("*megara*rps.csv", "*megara*rps.csv.gz")
STOP_ROOM_DEG = 0.5
"""From the range of targets to the stops: assumed."""
FOLDED_DEG = -180.0


def read_megara(folder: Path, instrument: Instrument) -> FocalPlane:
    """derived_megara_100_rps.csv: 100 robots. The eight that are disabled are offline, folded."""
    table = table_of(required(folder, *TABLES), *_COLUMNS)
    table.unique("Id", number=True)
    l_alpha, l_beta = (lengths(table, name) for name in ("L01", "L12"))
    check_arms(table.path, instrument, l_alpha, "MEGARA")
    place = [table.numbers(name) for name in ("x0", "y0")]
    number = table.integers("Id")
    n = len(table)
    return FocalPlane(
        instrument=instrument,
        positioner_id=number,
        hole=np.array([f"RP{k}" for k in number.tolist()]),
        arms=np.column_stack([*place, l_alpha, table.numbers("thetaO1"), np.zeros(n)]),
        points=points_of(instrument, l_beta),
        fiducials=np.empty((0, 3)),
        guide_cameras=np.empty((0, 5)),
        offline=truths(table, "Disabled"),
        offline_position_deg=np.tile(instrument.positioner.park_deg, (n, 1)),
        ranges=_ranges(table),
    )


_ENDS = ("theta_1min", "theta_1max", "theta___3min", "theta___3max")
_COLUMNS = ("Id", "L01", "L12", "x0", "y0", "thetaO1", "Disabled", *_ENDS)


def _ranges(table: TableFile) -> Ranges:
    low, high, folded, open_ = (rad_to_deg(table.numbers(name)) for name in _ENDS)
    for name, least, most in ((_ENDS[1], low, high), (_ENDS[3], folded, open_)):
        for row in np.flatnonzero(~(least < most))[:1]:
            raise table.error(int(row), name, f"= {most[row]:g} deg must be above {least[row]:g} deg")
    targets: Floats = np.stack([-high, -low, FOLDED_DEG + folded, FOLDED_DEG + open_], axis=1).reshape(
        -1, 2, 2
    )
    return Ranges(targets, targets + np.array([-STOP_ROOM_DEG, STOP_ROOM_DEG]))
