"""A valid file for each reader, as the project writes it (or, where it only reads the kind, by hand)."""

import gzip
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.table import Table

import fiberloom as fl
from fiberloom.calibration.fibres.dithered import DitheredField, hexagon
from fiberloom.calibration.fibres.exposures_file import write_exposures
from fiberloom.calibration.fibres.offsets import FibreOffsets
from fiberloom.calibration.focal_plane.arms_file import save_arms
from fiberloom.calibration.focal_plane.fit import N_GEOMETRY, FocalPlaneFit
from fiberloom.calibration.transmission.maps import Provenance, TransmissionMaps
from fiberloom.instruments import write_layout
from fiberloom.metrology import CameraImage, write_image, write_spots
from fiberloom.planning import write_configuration
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook, ArrayPlaces
from fiberloom.store.learnt import OBSERVE, Learnt, LearntHistory
from fiberloom.tables import write_ecsv
from fiberloom.targets import TargetList, write_targets

PLANE = fl.FocalPlane.of("sdssv", seed=0, n=7)
IDS = PLANE.positioner_id
MARKS = {"version": "0.1.0", "seed": 0, "instrument": "sdssv", "config_hash": "cafe", "utc": "2026-01-01"}


def _targets() -> TargetList:
    rng = np.random.default_rng(0)
    return TargetList(
        target_id=np.array([f"t{k}" for k in range(12)]),
        x_mm=rng.uniform(-30, 30, 12).round(3),
        y_mm=rng.uniform(-30, 30, 12).round(3),
        priority=np.arange(12.0),
        fibre=np.array(["BOSS", "", "APOGEE"] * 4),
        positioner_id=np.array([*IDS, *[-1] * 5]),
    )


def targets_csv(path: Path) -> None:
    write_targets(_targets(), path, comments=("of a test",))


def targets_table(path: Path) -> None:
    made = _targets()
    names = ("target_id", "x_mm", "y_mm", "priority", "fibre", "positioner_id")
    Table({name: getattr(made, name) for name in names}).write(path)


CONFSUMMARY = """# confSummary of a test
configuration_id 12
typedef struct {
    int positionerId;
    char fiberType[10];
    int assigned;
    int valid;
    double xwok;
    double ywok;
    double extra[3];
    char name[20];
    long catalogid;
} FIBERMAP;

FIBERMAP 3 BOSS 1 1 1.5 -2.5 {1.0 nan 3} "two words" 900
FIBERMAP 3 APOGEE 0 1 9 9 {1 2 3} "" -999
FIBERMAP 4 APOGEE 1 1 3.5 4.5 {1 2 3} "" 901
FIBERMAP 6 BOSS 1 1 5 6 { 1 2 3 } x -999
"""


def targets_par(path: Path) -> None:
    text = CONFSUMMARY.encode()
    path.write_bytes(gzip.compress(text) if path.suffix == ".gz" else text)


def configuration(path: Path) -> None:
    write_configuration(path, IDS, PLANE.park_deg)


def layout(path: Path) -> None:
    write_layout(PLANE, path.parent)


def sdssv_layout(path: Path) -> None:
    """As the calibrations of SDSS-V: two positioners, a fiducial, one guide camera less."""
    frame = "1,0,0,0,1,0,0,0,1"
    path.with_name("positionerTable.csv").write_text(
        "holeID,positionerID,alphaArmLen,alphaOffset,betaOffset,dx,dy,metX,metY,bossX,bossY,apX,apY\n"
        "A,4,7.4,1.0,0.1,0.01,0.02,14.3,0.1,14.9,0.2,14.9,-0.3\n"
        "B,9,7.4,-2.0,0.2,0.0,0.03,14.3,0.1,14.9,0.2,14.9,-0.3\n"
    )
    path.with_name("wokCoords.csv").write_text(
        "holeID,holeType,xWok,yWok,ix,iy,iz,jx,jy,jz,kx,ky,kz\n"
        f"A,ApogeeBoss,0.0,0.0,{frame}\nB,Boss,22.4,0.0,{frame}\nF1,Fiducial,11.2,19.4,{frame}\n"
    )
    path.with_name("fiducialCoords.csv").write_text("holeID,xWok,yWok\nF1,11.2,19.4\n")


def instrument(path: Path) -> None:
    presets = Path(fl.__file__).parent / "instruments" / "presets"
    path.write_bytes((presets / "sdssv.toml").read_bytes())


SITE = """bus = "cannet://10.1.10.31,10.1.10.32"
camera = "alpaca://10.1.10.40:11111/0?exposure=5"
layout = "layout"
calibration = "transmission.npz"
store = "arrays.sqlite"
positioners = 37
seed = 4
exclude = [12, 40]

[limits]
disk_mb = 2000
clock_s = 1.5
"""


def site(path: Path) -> None:
    path.write_text(SITE)


def maps(path: Path) -> None:
    output = np.broadcast_to(np.linspace(0.0, 360.0, 20), (len(IDS), 2, 2, 20)).copy()
    TransmissionMaps(IDS, output + 0.1, output, Provenance(seed=0, note="of a test")).save(path)


def trajectories(path: Path) -> None:
    fl.plan(PLANE, PLANE.park_deg, PLANE.park_deg - [20.0, 30.0]).save(path, **MARKS)


def arms(path: Path) -> None:
    n = len(IDS)
    fit = FocalPlaneFit(
        positioner_id=IDS,
        parameters=np.column_stack([PLANE.arms[:, :3], np.full(n, 15.0), PLANE.arms[:, 3:]]),
        covariance=np.tile(np.eye(N_GEOMETRY) * 1e-6, (n, 1, 1)),
        rank=np.full(n, 6),
        reason=[""] * (n - 1) + ["seen only 3 times"],
        used=np.ones((n, 8), dtype=bool),
        n_outliers=np.zeros(n, dtype=np.int64),
        rms_um=np.full(n, 1.5),
        chi2_dof=np.ones(n),
        angles_deg=(0.01, 0.01),
    )
    save_arms(path, fit, MARKS)


def fibres(path: Path) -> None:
    rows = [
        {"positioner_id": int(p), "fibre": "BOSS", "move": 1, "error_um": 1.25, "status": "on_target"}
        for p in IDS
    ]
    write_ecsv(path, rows, MARKS)


def offsets(path: Path) -> None:
    n = len(IDS)
    FibreOffsets(
        positioner_id=IDS,
        fibre=np.full(n, "BOSS"),
        offset_mm=np.full((n, 2), 0.0125),
        covariance_mm2=np.tile(1e-6 * np.eye(2), (n, 1, 1)),
        lever_mm=PLANE.points["BOSS"] - PLANE.points["metrology"],
    ).write(path, MARKS)


def exposures(path: Path) -> None:
    rng, n = np.random.default_rng(2), len(IDS)
    xy = PLANE.centres_mm.round(3)
    fluxes = rng.integers(100, 1000, (5, n)).astype(float)
    arm = rng.uniform(0.0, 360.0, n).round(2)
    field = DitheredField(
        "a", IDS, np.full(n, "BOSS"), xy, xy, arm, hexagon(n=5).round(3), fluxes, np.sqrt(fluxes)
    )
    write_exposures(path, field, MARKS)


def picture() -> np.ndarray:
    y, x = np.mgrid[:40, :60]
    noise = np.random.default_rng(3).normal(200.0, 3.0, (40, 60))
    return noise + sum(
        4000.0 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 4.0) for u, v in [(20.2, 11.3), (44.1, 27.9)]
    )


def image(path: Path) -> None:
    kind = np.float32 if path.name.startswith("float") else np.uint16
    write_image(CameraImage(picture().astype(kind), gain_e_adu=2.0, saturation_adu=6e4, exposure_s=1.5), path)


def tiles(path: Path) -> None:
    fits.CompImageHDU(picture().astype(np.uint16)).writeto(path, overwrite=True)


def spots(path: Path) -> None:
    write_spots(fl.centroid(picture()), path, {"version": "x"})


def store(path: Path) -> None:
    path.unlink(missing_ok=True)
    with Store.open(path) as made:
        with made.start_run(
            command_line="fiberloom observe", instrument="sdssv", config_hash="cafe", seed=1
        ) as run:
            for move in range(4):
                measured = {
                    "positioner_id": np.arange(1, 60),
                    "x_mm": np.linspace(-3.0, 3.0, 59),
                    "y_mm": np.linspace(0.0, 1.0, 59),
                    "alpha_deg": 12.5,
                    "target_id": np.array([f"t{k}" for k in range(59)]),
                    "status": np.array(["on_target"] * 59),
                    "error_um": np.linspace(0.0, 9.0, 59),
                }
                run.record_move(move, "blind", measured, time_s=float(move))
            run.record_event("flag", "positioner 3 is late", positioner_id=3)
            run.record_calibration(range(1, 20), "alpha", "transmission", "maps.npz", "12ab")
        history = LearntHistory(made, "cafe")
        data = np.random.default_rng(0).bytes(400)
        history.put(history.begin(OBSERVE, "sdssv", "cafe"), {p: Learnt(3, 0.5, data) for p in range(1, 12)})
        book = ArrayBook(made, "bus")
        book.exclude([4], "ann", "beta slips")
        book.note_places(
            IDS, ArrayPlaces(PLANE.park_deg, PLANE.park_deg, ["seen"] * 7, np.ones(7, dtype=bool), [None] * 7)
        )
    for beside in ("-wal", "-shm"):
        path.with_name(path.name + beside).unlink(missing_ok=True)


WRITERS = {
    "targets.csv": targets_csv,
    "targets.ecsv": targets_table,
    "targets.fits": targets_table,
    "targets.par": targets_par,
    "targets.par.gz": targets_par,
    "configuration.csv": configuration,
    "layout/layout.toml": layout,
    "layout/positioners.ecsv": layout,
    "layout/fiducials.ecsv": layout,
    "sdssv/positionerTable.csv": sdssv_layout,
    "sdssv/wokCoords.csv": sdssv_layout,
    "instrument.toml": instrument,
    "site.toml": site,
    "maps.npz": maps,
    "trajectories.json": trajectories,
    "arms.ecsv": arms,
    "fibres.ecsv": fibres,
    "offsets.ecsv": offsets,
    "exposures.ecsv": exposures,
    "spots.csv": spots,
    "image.fits": image,
    "float.fits": image,
    "tiles.fits": tiles,
    "image.fits.gz": image,
    "store.sqlite": store,
}
"""By the name of the reader, which is that of the file."""
