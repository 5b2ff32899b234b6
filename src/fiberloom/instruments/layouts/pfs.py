"""The tables of PFS: cobras by module, black dots, fiducials.

Subaru-PFS/pfs_instdata. Centres are the exact lattice of pfs_utils. The module files were made on test
benches: lengths in them are pixels, and the direction of theta = 0 is that of the bench. So that direction is
drawn here, and by how much cobras stand beside the lattice.
"""

from pathlib import Path

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments.axis import Ranges
from fiberloom.instruments.focal_plane import FocalPlane
from fiberloom.instruments.generated import generate
from fiberloom.instruments.layouts.folder import check_arms, newest, points_of, required, table_of
from fiberloom.instruments.model import Instrument
from fiberloom.tables import TableFile
from fiberloom.typing import Flags, Floats, Ints

SCALARS = ("pfs_*_cobras_scalars.csv.gz", "pfs_*_cobras_scalars.csv")
DRAWN_SEED = 0
"""Of what the tables do not tell."""
SHARE_OF_ARM = 0.2
"""Arms that differ from their module's median by more are failed fits; single ones have 3 %."""
THETA_RANGE_DEG = (360.0, 420.0)
"""From stop to stop; others are failed fits. 98 % have 365 to 386 deg."""
PHI_RANGE_DEG = (170.0, 200.0)
"""The same; 98 % have 181 to 190 deg."""
FOLDED_DEG, STRETCHED_DEG = -180.0, 0.0


def read_pfs(folder: Path, instrument: Instrument) -> FocalPlane:
    """pfs_2394_cobras_scalars.csv[.gz] and, if there, black_dots_mm-*.csv and fiducial_positions_*.csv.

    Cobras whose fit failed have nominal arms and ranges and are offline, folded. Theta counts from its
    counter-clockwise stop, as alpha here; beta is 0 for a stretched arm, and folded near -180 deg.
    """
    own = folder / "derived" if (folder / "derived").is_dir() else folder
    table = table_of(required(own, *SCALARS), *_COLUMNS)
    drawn = generate(instrument, DRAWN_SEED)
    rows = _rows_by_cobra(table, drawn)
    l_alpha, l_beta = (_lengths_mm(table, instrument, link)[rows] for link in (1, 2))
    check_arms(table.path, instrument, l_alpha, "PFS")
    stops, failed = _stops(table)
    failed = failed[rows] | _odd(l_alpha, instrument) | _odd(l_beta, instrument)
    l_alpha, l_beta = (np.where(failed, instrument.positioner.l_alpha_mm, arm) for arm in (l_alpha, l_beta))
    arms = drawn.arms.copy()
    arms[:, 2] = l_alpha
    return FocalPlane(
        instrument=instrument,
        positioner_id=drawn.positioner_id,
        hole=drawn.hole,
        arms=arms,
        points=points_of(instrument, l_beta),
        fiducials=_fiducials(folder, instrument, drawn.fiducials),
        guide_cameras=np.empty((0, 5)),
        offline=failed,
        offline_position_deg=drawn.offline_position_deg,
        ranges=_ranges(np.where(failed[:, None, None], drawn.hard_stops_deg, stops[rows])),
        dots_mm=_dots(folder, drawn),
    )


_STOPS = ("theta_ccw_home_deg", "theta_cw_home_deg", "phi_cw_limit_deg", "phi_ccw_limit_deg")
_COLUMNS = ("module", "positioner", "link1_px", "link2_px", *_STOPS)


def _rows_by_cobra(table: TableFile, drawn: FocalPlane) -> Ints:
    """Row of the table of each cobra of the lattice, by module and place."""
    if drawn.instrument.layout.modules is None:
        raise InputError(f"{table.path}: instrument '{drawn.instrument.name}' has no layout.modules; use pfs")
    modules, places = table.strings("module"), table.integers("positioner")
    pairs = zip(modules.tolist(), places.tolist(), strict=True)
    names = [f"{module}P{place:02d}" for module, place in pairs]
    where: dict[str, int] = {}
    known = set(drawn.hole.tolist())
    for row, name in enumerate(names):
        if name not in known or name in where:
            told = "appears twice" if name in where else "is in no module of the lattice"
            raise table.error(row, "module, positioner", f"= {name} {told}")
        where[name] = row
    for missing in [name for name in drawn.hole.tolist() if name not in where][:1]:
        raise InputError(f"{table.path}: no row for cobra {missing} ({len(drawn) - len(where)} missing)")
    return np.array([where[name] for name in drawn.hole.tolist()])


def _lengths_mm(table: TableFile, instrument: Instrument, link: int) -> Floats:
    """Of all rows: pixels over the median of the module, which has the nominal length."""
    pixels, module = table.numbers(f"link{link}_px"), table.strings("module")
    names, which = np.unique(module, return_inverse=True)
    median = np.array([np.median(pixels[which == k]) for k in range(len(names))])
    for k in np.flatnonzero(~(median > 0.0))[:1]:
        raise InputError(f"{table.path}: link{link}_px: half of module {names[k]} is not above 0")
    scaled: Floats = instrument.positioner.l_alpha_mm * pixels / median[which]
    return scaled


def _odd(length_mm: Floats, instrument: Instrument) -> Flags:
    nominal = instrument.positioner.l_alpha_mm
    odd: Flags = np.abs(length_mm - nominal) > SHARE_OF_ARM * nominal
    return odd


def _stops(table: TableFile) -> tuple[Floats, Flags]:
    """(n, 2, 2) deg stops of alpha and beta, and (n,) where they cannot be those of a cobra."""
    ccw, cw, phi_cw, phi_ccw = (table.numbers(name) for name in _STOPS)
    # the second home lies more than a turn beyond the first
    theta = 360.0 + (cw - ccw) % 360.0
    phi = np.stack([phi_ccw + FOLDED_DEG, phi_cw + FOLDED_DEG], axis=-1)
    stops = np.stack([np.stack([np.zeros(len(theta)), theta], axis=-1), phi], axis=1)
    failed = np.zeros(len(theta), dtype=bool)
    for width, (low, high) in ((theta, THETA_RANGE_DEG), (np.ptp(phi, axis=1), PHI_RANGE_DEG)):
        failed |= ~((low <= width) & (width <= high))
    failed |= ~((phi[:, 0] < STRETCHED_DEG) & (phi[:, 1] > FOLDED_DEG) & (phi[:, 0] < phi[:, 1]))
    return stops, failed


def _ranges(stops: Floats) -> Ranges:
    """Targets up to the stops, with the one elbow: from folded to stretched."""
    targets = stops.copy()
    targets[:, 1] = np.clip(stops[:, 1], FOLDED_DEG, STRETCHED_DEG)
    return Ranges(targets, stops)


def _dots(folder: Path, drawn: FocalPlane) -> Floats | None:
    """(N, 3) mm, by spotId = cobra id; as drawn where there is no table."""
    path = newest(folder, "black_dots_mm-*.csv")
    if path is None:
        return drawn.dots_mm
    table = table_of(path, "spotId", "x", "y", "r")
    table.unique("spotId", number=True)
    place = {number: row for row, number in enumerate(table.integers("spotId").tolist())}
    for missing in [number for number in drawn.positioner_id.tolist() if number not in place][:1]:
        raise InputError(f"{path}: no dot with spotId {missing}; every cobra has one")
    rows = [place[number] for number in drawn.positioner_id.tolist()]
    return np.column_stack([table.numbers(name) for name in ("x", "y", "r")])[rows]


def _fiducials(folder: Path, instrument: Instrument, nominal: Floats) -> Floats:
    """(M, 3) mm, broken lights included: their bodies stand all the same."""
    path = newest(folder, "fiducial_positions_*.csv")
    if path is None:
        return nominal
    table = table_of(path, "x_mm", "y_mm")
    # those that were never measured have empty cells
    measured = np.flatnonzero((table.strings("x_mm") != "") & (table.strings("y_mm") != ""))
    some = table.select(measured)
    radius = np.full(len(measured), instrument.bodies.fiducial_radius_mm)
    return np.column_stack([some.numbers("x_mm"), some.numbers("y_mm"), radius])
